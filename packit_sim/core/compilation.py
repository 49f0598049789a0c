"""The compilation of kernels: once per installation, cached on disk, and announced."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

_log = logging.getLogger("packit_sim")


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of numbers and arrays at its first call, without Python objects.

    Parameters
    ----------
    function : callable
        The function.

    Returns
    -------
    callable
        The compiled function.

    Notes
    -----
    The machine code is cached next to the module, or else in the user's cache folder (or
    `NUMBA_CACHE_DIR`). If neither is writable, each process compiles again.
    """
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # numba found no folder that is writable
        return numba.njit(nogil=True)(function)


class _Announcement(event.Listener):  # type: ignore[misc] # numba's own hints are not read
    """Announces once per process that kernels are compiled; loading cached ones is silent."""

    def __init__(self) -> None:
        self._announced = False

    def on_start(self, event: Any) -> None:
        if not self._announced and event.data["dispatcher"].py_func.__module__.startswith(
            "packit_sim"
        ):
            self._announced = True
            _log.warning(
                "compiling the placement engine: takes about 20 s, and only the first time"
            )

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Announcement())

os.register_at_fork(  # a child would wait forever for a thread that was compiling
    before=global_compiler_lock.acquire,
    after_in_parent=global_compiler_lock.release,
    after_in_child=global_compiler_lock.release,
)
