"""Copies of files as they were read: nothing that happens to the files later matters."""

from __future__ import annotations

import hashlib
import tempfile
import threading
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

_IN_MEMORY = 8 * 2**20
"""Bytes up to which copies are in memory; more are in a temporary file."""


class FileCopies:
    """The content of files, in memory or in one temporary file that has no name.

    It is gone when the last copy is, or when the process ends, however it ends.
    """

    def __init__(self) -> None:
        self._file = tempfile.SpooledTemporaryFile(_IN_MEMORY)  # noqa: SIM115
        weakref.finalize(self, self._file.close)
        self._alone = threading.Lock()
        self._size = 0

    def add(self, contents: Mapping[str, bytes]) -> FileCopy:
        """Copy a file, the first, and those that it refers to, by their names.

        Returns
        -------
        FileCopy
            The copy of the first.

        Raises
        ------
        OSError
            If the disk of temporary files is full; the error has their folder.
        """
        main, *others = contents.items()
        return self._copy(main[1], {name: self._copy(content) for name, content in others})

    def _copy(self, content: bytes, others: Mapping[str, FileCopy] | None = None) -> FileCopy:
        with self._alone:
            start = self._size
            try:
                self._file.seek(start)
                self._file.write(content)
            except OSError as error:
                raise OSError(error.errno, error.strerror, tempfile.gettempdir()) from None
            self._size += len(content)
        digest = hashlib.sha256(content).hexdigest()
        return FileCopy(digest, len(content), others or {}, self, start)

    def read(self, start: int, size: int) -> bytes:
        """Return bytes of all that was added."""
        with self._alone:
            self._file.seek(start)
            return self._file.read(size)


@dataclass(frozen=True, eq=False)
class FileCopy:
    """The content of a file as it was read.

    Attributes
    ----------
    digest : str
        SHA-256 of the content, in hex.
    others : mapping of str to FileCopy
        The files that it refers to, by their names in it.
    """

    digest: str
    size: int
    others: Mapping[str, FileCopy]
    _copies: FileCopies = field(repr=False)
    _start: int = field(repr=False)

    @property
    def content(self) -> bytes:
        """The content."""
        return self._copies.read(self._start, self.size)

    def __reduce__(self) -> tuple[Any, ...]:
        others = {name: each.content for name, each in self.others.items()}
        return _copied, ({"": self.content, **others},)


def _copied(contents: Mapping[str, bytes]) -> FileCopy:
    """Rebuild a copy in another process, or of another object."""
    return FileCopies().add(contents)
