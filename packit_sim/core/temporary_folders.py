"""Temporary folders that end with their process, or with the next one if it was killed."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path

from packit_sim.core.locks import HAS_LOCKS, lock

_OPEN = ".open"
"""The file that stays open as long as the process lives, on Windows: it can't be removed."""


class TemporaryFolder:
    """A new temporary folder, locked as long as its process lives.

    Folders of the same name that killed processes left are removed: nobody locks them.

    Parameters
    ----------
    name : str
        The beginning of its name.

    Attributes
    ----------
    path : Path
        The folder.
    remove : callable
        Removes it; calling it again does nothing. It is also called when the process ends.
    """

    def __init__(self, name: str) -> None:
        parent = Path(tempfile.gettempdir())
        for left in parent.glob(f"{name}{'[a-z0-9_]' * 8}"):
            with suppress(OSError):
                _remove(left, _locked(left, wait=False), os.getpid())
        while True:
            self.path = Path(tempfile.mkdtemp(prefix=name, dir=parent))
            with suppress(FileNotFoundError):  # another process removed it before it was locked
                descriptor = _locked(self.path)
                if self.path.exists():
                    break
                os.close(descriptor)
        self.remove = weakref.finalize(self, _remove, self.path, descriptor, os.getpid())


def _locked(folder: Path, wait: bool = True) -> int:
    """Lock a folder of this user, and return a descriptor; raise OSError if that fails."""
    if sys.platform != "win32":
        if HAS_LOCKS:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                if os.fstat(descriptor).st_uid != os.getuid():
                    raise PermissionError(str(folder))
                lock(descriptor, wait=wait)
            except BaseException:
                os.close(descriptor)
                raise
            return descriptor
    (folder / _OPEN).unlink(missing_ok=True)
    return os.open(folder / _OPEN, os.O_CREAT | os.O_RDWR)


def _remove(folder: Path, descriptor: int, owner: int) -> None:
    if os.getpid() == owner:  # a forked child leaves it to its parent
        if not HAS_LOCKS:
            os.close(descriptor)
        shutil.rmtree(folder, ignore_errors=True)
        if HAS_LOCKS:
            os.close(descriptor)
