"""Locks of open files, where the system has them: Windows instead keeps open files from removal."""

from __future__ import annotations

try:
    from fcntl import LOCK_EX, LOCK_NB, flock  # type: ignore[attr-defined,unused-ignore]
except ImportError:
    HAS_LOCKS = False
else:
    HAS_LOCKS = True


def lock(descriptor: int, *, wait: bool = True) -> None:
    """Lock an open file or folder until its descriptor is closed.

    Parameters
    ----------
    descriptor : int
        Its descriptor.
    wait : bool
        Whether to wait for another process that has locked it.

    Raises
    ------
    OSError
        If another process has locked it, or its file system has no locks.
    """
    if HAS_LOCKS:
        flock(descriptor, LOCK_EX | (0 if wait else LOCK_NB))
