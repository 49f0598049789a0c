"""Files that are written whole or not at all, by one process at a time."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from packit_sim.core.errors import BusyError

_LOCK_SECONDS = 0.1
"""Timeout for a lock file: time for a second attempt if its holder has just removed it."""


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces `path` when the block ends.

    If the block raises, nothing has changed. Otherwise the content is on the disk before the file
    is renamed.

    Parameters
    ----------
    path : Path
        The file to write.

    Yields
    ------
    BinaryIO
        The temporary file, in the same folder.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def replace_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all."""
    with replacing(path) as file:
        file.write(text.encode())


@contextmanager
def claimed(lock: Path, target: Path) -> Iterator[None]:
    """Hold a lock file while the block runs, and remove it afterwards.

    The operating system releases the lock when the process ends, however it ends.

    Parameters
    ----------
    lock : Path
        The lock file; it contains the id of the process that holds it.
    target : Path
        The file or folder that the lock protects, for the error message.

    Yields
    ------
    None
        While the lock is held.

    Raises
    ------
    BusyError
        If another process, or another part of this one, holds the lock.
    """
    from filelock import FileLock, Timeout  # slow to import, and only writers need it

    held = FileLock(lock, timeout=_LOCK_SECONDS)
    try:
        held.acquire()
    except Timeout:
        raise BusyError(
            f"{target}: process {_holder(lock)} is at work there: wait until it ends, "
            "or stop it and repeat the command"
        ) from None
    try:
        lock.write_text(str(os.getpid()))
        yield
    finally:
        lock.unlink(missing_ok=True)  # before the release: another process may then hold the path
        held.release()


def _holder(lock: Path) -> str:
    """Return the id of the process that holds a lock file, or "?"."""
    try:
        return lock.read_text().strip() or "?"
    except FileNotFoundError:
        return "?"
