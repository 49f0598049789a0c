"""Worker processes that end when the process that started them ends, not earlier."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker

CHECK_SECONDS = 0.5
"""Time between two checks of the parent."""


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Let processes and threads that start within the block ignore Ctrl-C, from their first line.

    A terminal sends Ctrl-C to all processes of a command: the one that started the others ends
    them, while they would print tracebacks. Here it takes effect after the block, also if another
    thread of this process gets it.

    Yields
    ------
    None
        While Ctrl-C has to wait.
    """
    if sys.platform != "win32":
        resource_tracker.ensure_running()  # which lets Ctrl-C through when it starts
    is_main = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGINT)
    arrived: list[int] = []
    if is_main and callable(handler):
        signal.signal(signal.SIGINT, lambda number, frame: arrived.append(number))
    if sys.platform != "win32":
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if sys.platform != "win32":
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if is_main and callable(handler):
            signal.signal(signal.SIGINT, handler)
            if arrived:
                handler(arrived[0], None)


def end_with(parent: int) -> None:
    """Let this process end soon after its parent; for the initializer of a worker.

    Parameters
    ----------
    parent : int
        The id of the process that started this one.
    """
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:  # that of an orphan is another process
        time.sleep(CHECK_SECONDS)
    os._exit(1)
