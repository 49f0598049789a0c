"""How kernels are compiled: once an installation, kept on disk, and not without saying so."""

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
    """Compiles a function of numbers and arrays at its first call, without Python in it.

    The machine code is kept beside the module, or where that can't be written in the user's cache
    folder (or in `NUMBA_CACHE_DIR`); where neither can, it is compiled anew in each process.
    """
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # numba's answer where it finds no folder to write to
        return numba.njit(nogil=True)(function)


class _Announcement(event.Listener):  # type: ignore[misc] # numba's own hints are not read
    """Says once a process that kernels are being compiled; those on disk are loaded in silence."""

    def __init__(self) -> None:
        self._made = False

    def on_start(self, event: Any) -> None:
        if not self._made and event.data["dispatcher"].py_func.__module__.startswith("packit_sim"):
            self._made = True
            _log.warning(
                "compiling the placement engine: takes about 20 s, and only the first time"
            )

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Announcement())

os.register_at_fork(  # a child would wait for ever for a thread that was compiling
    before=global_compiler_lock.acquire,
    after_in_parent=global_compiler_lock.release,
    after_in_child=global_compiler_lock.release,
)
