"""A limit of the memory of a process."""

from __future__ import annotations

import resource
from pathlib import Path


def limit_memory(more: int) -> None:
    """Limit the address space of this process.

    Parameters
    ----------
    more : int
        The bytes that it may have in addition to those that it has now. A limit that it has
        already stays, if it is lower.
    """
    has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    _, maximum = resource.getrlimit(resource.RLIMIT_AS)
    limit = has + more if maximum == resource.RLIM_INFINITY else min(has + more, maximum)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
