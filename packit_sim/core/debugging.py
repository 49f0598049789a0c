"""A switch for tests: state that is updated in steps is compared with state built from scratch.

The comparisons are assertions in the code that updates the state, after each change. They are off
by default; then each costs one function call.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

CHECK_VARIABLE = "PACKIT_CHECK_STATE"
"""The environment variable that switches the comparisons on in a new process: "1"."""

_checking = os.environ.get(CHECK_VARIABLE) == "1"


def is_checking() -> bool:
    """Return whether incremental state is compared with state built from scratch."""
    return _checking


@contextmanager
def checking(on: bool = True) -> Iterator[None]:
    """Switch the comparisons on or off in a block, for all threads of this process.

    Parameters
    ----------
    on : bool, default: True
        Whether to compare.
    """
    global _checking
    before, _checking = _checking, on
    try:
        yield
    finally:
        _checking = before
