"""The memory of a process: a limit, and what it no longer needs."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

_STATM = Path("/proc/self/statm")
"""The file in which Linux reports the memory of a process, in pages."""


def limit_memory(more: int) -> None:
    """Limit the address space of this process, on Linux: other systems have no such limit.

    Parameters
    ----------
    more : int
        The bytes that it may have in addition to those that it has now. A limit that it has
        already stays, if it is lower.
    """
    if sys.platform != "win32":
        try:
            import resource
        except ImportError:
            return
        if not _STATM.exists():  # macOS
            return
        has = int(_STATM.read_text().split()[0]) * resource.getpagesize()
        _, maximum = resource.getrlimit(resource.RLIMIT_AS)
        limit = has + more if maximum == resource.RLIM_INFINITY else min(has + more, maximum)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def release_memory() -> None:
    """Give freed memory back to the system, where the C library keeps it: that of Linux.

    After millions of small arrays it keeps as much as is in use.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc alone
        if trim is not None:
            trim(0)
