"""Atomic writes of files, by one process at a time."""

from __future__ import annotations

import ctypes
import errno
import glob
import hashlib
import json
import os
import re
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from packit_sim.core.errors import ArgumentError, BusyError
from packit_sim.core.locks import HAS_LOCKS, lock

_HERE, _EXCHANGE = -100, 2
"""Linux's AT_FDCWD and RENAME_EXCHANGE."""

_SUFFIX = ".tmp"

_BEGINNINGS = {
    ".3mf": (b"PK",),
    ".gif": (b"GIF8",),
    ".glb": (b"glTF",),
    ".html": (b"<!",),
    ".json": (b"{", b"["),
    ".jsonl": (b"{",),
    ".mp4": (b"\0\0\0",),
    ".npz": (b"PK",),
    ".png": (b"\x89PNG",),
    ".zip": (b"PK",),
}
"""How files begin, by their suffixes."""

_LOCK = re.compile(rb"[0-9]{0,20}")
"""The content of a lock file."""

_LOCK_SECONDS = 0.1
"""Timeout for a lock file: time for a second attempt if its holder has just removed it."""


def exists(path: Path) -> bool:
    """Return whether there is something at a path; False if no file can have such a name."""
    try:
        return path.exists()
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            return False
        raise


def read_whole(path: Path) -> bytes:
    """Read a file that may come from a stranger.

    Parameters
    ----------
    path : Path
        The file. Pipes are read as well.

    Returns
    -------
    bytes
        Its content.

    Raises
    ------
    OSError
        If the file can't be read, or is a device, such as a link to `/dev/zero`, which never ends.
    """
    with open(path, "rb") as file:
        kind = os.fstat(file.fileno()).st_mode
        if not (stat.S_ISREG(kind) or stat.S_ISFIFO(kind)):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        return file.read()


def digest_of(path: Path) -> str:
    """Return SHA-256 of a file's content, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def same_file(one: Path, other: Path) -> bool:
    """Return whether two paths lead to the same file; False if one leads nowhere."""
    try:
        return one.samefile(other)
    except OSError:
        return False


@contextmanager
def naming(path: Path | str) -> Iterator[None]:
    """Give errors of the disk that have no path, such as that of a file-size limit, a path."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def require_replaceable(path: Path, inputs: Iterable[Path] = (), field: str | None = None) -> None:
    """Refuse to write a file that a user has named, if it would take another one away.

    Parameters
    ----------
    path : Path
        The file to write. One that is there has the format of its suffix, or is empty.
    inputs : iterable of Path
        Files that are read: it is none of them.
    field : str, optional
        A field that a JSON file must have to be replaced.

    Raises
    ------
    ArgumentError
        If it is an input, or of another kind.
    """
    if any(same_file(path, each) for each in inputs):
        raise ArgumentError(f"{path} is an input, and would be replaced: choose another name")
    if not path.is_file():
        return
    content = path.read_bytes() if field else b""
    with path.open("rb") as file:
        start = file.read(64).lstrip()
    expected = _BEGINNINGS.get(path.suffix.lower(), ())
    known = not expected or start.startswith(expected)
    if start and not (known and (field is None or json.dumps(field).encode() in content)):
        raise ArgumentError(
            f"{path} exists, and is not a file that this command writes: choose another name, or "
            "remove it"
        )


def require_free(folder: Path, names: Iterable[str]) -> None:
    """Refuse to begin work in a folder in which it would replace files of others.

    Parameters
    ----------
    names : iterable of str
        The names of the files and folders that will be written.

    Raises
    ------
    ArgumentError
        If there is something of such a name.
    """
    for name in names:
        if os.path.lexists(path := folder / name):
            raise ArgumentError(
                f"{path} exists, and this command did not write it: choose another folder, or "
                "remove it"
            )


def require_same(path: Path, content: bytes) -> None:
    """Refuse to replace a file by another content, where a user has not named it.

    Raises
    ------
    ArgumentError
        If it exists with other content.
    """
    if os.path.lexists(path) and not (path.is_file() and path.read_bytes() == content):
        raise ArgumentError(
            f"{path} exists with other content, and would be replaced: choose another name, or "
            "remove it"
        )


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces `path` when the block ends.

    If the block raises, nothing has changed. Otherwise the content is on the disk before the file
    is renamed. Temporary files that killed processes left are removed.

    Parameters
    ----------
    path : Path
        The file to write; of a symbolic link, its target is written.

    Yields
    ------
    BinaryIO
        The temporary file, in the same folder.

    Raises
    ------
    OSError
        If the disk is full, or the folder can't be written; the error has the path.
    """
    target = followed(path)
    name = None
    try:
        remove_unfinished(path)
        handle, name = _temporary(target)
        with os.fdopen(handle, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            os.chmod(name, 0o644)
            if HAS_LOCKS:  # while it is locked, so that nobody takes it for unfinished
                os.replace(name, target)
        if not HAS_LOCKS:
            os.replace(name, target)
    except BaseException as error:
        if name is not None:
            Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError) and _concerns(error, target):
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise


def replace_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    with replacing(path) as file:
        file.write(text.encode())


def exchange(one: Path, other: Path) -> None:
    """Exchange two files or folders in one step.

    Parameters
    ----------
    one : Path
        A file or folder.
    other : Path
        Another on the same file system.

    Raises
    ------
    OSError
        If the file system, or the system's library, has no such step; nothing has changed.
    """
    libc = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None
    rename = getattr(libc, "renameat2", None)
    names = os.fsencode(one), os.fsencode(other)
    if rename is None or rename(_HERE, names[0], _HERE, names[1], _EXCHANGE) != 0:
        raise OSError(ctypes.get_errno(), "can't be exchanged in one step", str(other))


def remove_unfinished(path: Path) -> None:
    """Remove temporary files of `replacing` whose processes were killed: nobody locks them."""
    target = followed(path)
    for left in target.parent.glob(f"{glob.escape(_prefix(target))}{'[a-z0-9_]' * 8}{_SUFFIX}"):
        with suppress(OSError), open(left, "rb") as file:
            lock(file.fileno(), wait=False)
            if HAS_LOCKS:
                left.unlink()
        if not HAS_LOCKS:
            with suppress(OSError):  # of an open file
                left.unlink()


def followed(path: Path) -> Path:
    """Return the file behind a path: the target of a symbolic link, or else the path itself."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def lock_path(path: Path) -> Path:
    """Return the lock file of a file or folder, the same for every path that leads there."""
    target = followed(path)
    return target.with_name(f".{target.name}.lock")


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
        If another process, or another part of this one, holds the lock, or a file with other
        content has its name.
    """
    from filelock import FileLock, Timeout  # slow to import, and only writers need it

    if os.path.lexists(lock) and not (lock.is_file() and _LOCK.fullmatch(lock.read_bytes())):
        raise BusyError(f"{lock} is in the way: it is no lock file of `packit`, move it")
    file_lock = FileLock(lock, timeout=_LOCK_SECONDS)
    try:
        file_lock.acquire()
    except Timeout:
        raise BusyError(
            f"{target}: process {_holder(lock)} is at work there: wait until it ends, "
            "or stop it and repeat the command"
        ) from None
    try:
        try:
            lock.write_text(str(os.getpid()))
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(lock)) from None
        yield
    finally:
        lock.unlink(missing_ok=True)  # before the release: another process may then hold the path
        file_lock.release()


def _temporary(target: Path) -> tuple[int, str]:
    """Create a temporary file that is locked while it is open."""
    while True:
        handle, name = tempfile.mkstemp(_SUFFIX, _prefix(target), target.parent)
        with suppress(OSError):  # some file systems have no locks
            lock(handle)
        if os.path.exists(name):  # nobody has removed it before it was locked
            return handle, name
        os.close(handle)


def _prefix(target: Path) -> str:
    """Return the prefix of the names of temporary files for a path."""
    return f".{target.name}."


def _concerns(error: OSError, target: Path) -> bool:
    """Return whether an error concerns the write: it names no file, or a temporary one."""
    if error.errno is None:
        return False
    named = error.filename
    return named is None or os.path.basename(os.fsdecode(named)).startswith(_prefix(target))


def _holder(lock: Path) -> str:
    """Return the id of the process that holds a lock file, or "?"."""
    try:
        return lock.read_text().strip() or "?"
    except FileNotFoundError:
        return "?"
