"""Silence for libraries that print to the terminal."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
from collections.abc import Iterator

_lock = threading.RLock()


def _renew_lock() -> None:
    """Replace the lock in a forked child: the thread that may have held it does not exist there."""
    global _lock
    _lock = threading.RLock()


if sys.platform != "win32":
    os.register_at_fork(after_in_child=_renew_lock)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Discard what is written to file descriptors 1 and 2, by C code as well.

    Notes
    -----
    The descriptors belong to the whole process: what other threads print in that time is lost too.
    """
    libc = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    with _lock, contextlib.ExitStack() as stack:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(AttributeError, OSError, ValueError):
                stream.flush()
        libc.fflush(None)
        null = os.open(os.devnull, os.O_WRONLY)
        stack.callback(os.close, null)
        for descriptor in (1, 2):
            with contextlib.suppress(OSError):  # a daemon may have closed it
                saved = os.dup(descriptor)
                stack.callback(os.close, saved)
                stack.callback(os.dup2, saved, descriptor)
                os.dup2(null, descriptor)
        stack.callback(libc.fflush, None)
        yield


@contextlib.contextmanager
def quiet_threads(error: type[Exception]) -> Iterator[None]:
    """Print no traceback of a thread that ends with an error of this type.

    Parameters
    ----------
    error : type of Exception
        An error that the thread's owner raises again in the main thread.
    """
    shown = threading.excepthook

    def hook(ended: threading.ExceptHookArgs) -> None:
        if not issubclass(ended.exc_type, error):
            shown(ended)

    threading.excepthook = hook
    before = threading.enumerate()
    try:
        yield
    except error:
        for thread in threading.enumerate():
            if thread not in before:
                thread.join(1.0)  # it may be about to end with the same error
        raise
    finally:
        threading.excepthook = shown
