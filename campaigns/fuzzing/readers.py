"""All readers of files that may come from strangers.

A reader reads what a user would read with it, and uses the result as far as that is cheap.
"""

from __future__ import annotations

from campaigns.fuzzing import (
    container_readers,
    dataset_readers,
    learning_readers,
    option_readers,
    part_readers,
    shape_readers,
)
from campaigns.fuzzing.reader import Reader

READERS: dict[str, Reader] = {
    reader.name: reader
    for reader in (
        *dataset_readers.READERS,
        *part_readers.READERS,
        *container_readers.READERS,
        *option_readers.READERS,
        *shape_readers.READERS,
        *learning_readers.READERS,
    )
}
"""The readers by name."""
