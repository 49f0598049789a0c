"""Temporary folders that end with their process, or with the next one if it was killed."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path


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
                _remove(left, _locked(left, fcntl.LOCK_NB), os.getpid())
        while True:
            self.path = Path(tempfile.mkdtemp(prefix=name, dir=parent))
            lock = _locked(self.path)
            if self.path.exists():  # nobody has removed it before it was locked
                break
            os.close(lock)
        self.remove = weakref.finalize(self, _remove, self.path, lock, os.getpid())


def _locked(folder: Path, wait: int = 0) -> int:
    """Lock a folder of this user, and return its descriptor; raise OSError if that fails."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        if os.fstat(descriptor).st_uid != os.getuid():
            raise PermissionError(str(folder))
        fcntl.flock(descriptor, fcntl.LOCK_EX | wait)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _remove(folder: Path, lock: int, owner: int) -> None:
    if os.getpid() == owner:  # a forked child leaves it to its parent
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)
