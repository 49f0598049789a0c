"""A reader of files that may come from strangers, with small real files of each to start from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from campaigns.fuzzing import file_changes
from campaigns.fuzzing.hostile_values import Mutator


@dataclass(frozen=True)
class Reader:
    """A reader of files.

    Attributes
    ----------
    name : str
        Its name, also that of the folder of files that were found with it.
    what : str
        What it reads, for the table.
    seeds : callable
        Returns the contents of small files to start from.
    read : callable
        Reads the content of a file.
    mutator : callable
        Changes a file in its structure.
    seconds : float
        The limit of one file, in seconds of CPU time.
    """

    name: str
    what: str
    seeds: Callable[[], list[bytes]]
    read: Callable[[bytes], object]
    mutator: Mutator = file_changes.unstructured
    seconds: float = 2.0
