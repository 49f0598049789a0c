"""How Ctrl-C, SIGTERM and SIGHUP end a command: with one line, at every moment.

This module imports little, because it is the first that a command imports.
"""

import os
import signal
import sys
import threading
from _thread import interrupt_main
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_OTHERS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))

SIGNALS = (signal.SIGINT, *_OTHERS)
"""The signals that end a command; Windows has no SIGHUP."""

_AGAIN = 0.02
"""Seconds after which an interrupt that C code ignored comes again; by then it has returned."""

_arrived: list[int] = []


def end_at_once() -> None:
    """Let these signals end the process with a line and exit status 128 + n, as nothing is begun.

    KeyboardInterrupt would show as another error in the middle of an import. Signals that are
    ignored, such as SIGHUP by `nohup`, stay ignored.
    """
    for number in SIGNALS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler, _interrupt):
            signal.signal(number, end_process)


@contextmanager
def as_interrupts() -> Iterator[list[int]]:
    """Let SIGTERM and SIGHUP do what Ctrl-C does, which is KeyboardInterrupt, within the block.

    Python prints and ignores one in a finalizer, or in a callback of C code such as LLVM's: it is
    raised again soon after.

    Yields
    ------
    list of int
        The numbers of those that arrived.
    """
    _arrived.clear()
    if threading.current_thread() is not threading.main_thread():
        yield _arrived
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    print_ignored = sys.unraisablehook

    def interrupt_again() -> None:
        if sys.unraisablehook is not hook:
            return
        if sys.platform == "win32":
            interrupt_main()
        else:  # also out of a system call
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    def hook(ignored: Any) -> None:
        if not issubclass(ignored.exc_type, KeyboardInterrupt):
            print_ignored(ignored)
            return
        timer = threading.Timer(_AGAIN, interrupt_again)
        timer.daemon = True
        timer.start()

    try:
        sys.unraisablehook = hook
        for number, handler in before.items():
            if handler in (signal.SIG_DFL, end_process):
                is_other = number in _OTHERS
                signal.signal(number, _interrupt if is_other else signal.default_int_handler)
        yield _arrived
    finally:
        sys.unraisablehook = print_ignored
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: object) -> None:
    """Do what Ctrl-C does now: a search replaces its handler, and others may ignore it."""
    _arrived.append(number)
    handler = signal.getsignal(signal.SIGINT)
    (handler if callable(handler) else signal.default_int_handler)(number, None)


def end_process(number: int, frame: object) -> None:
    """End the process with a line, as a handler of signals."""
    try:
        os.write(1, b"stopped\n")
    finally:
        os._exit(128 + number)


def _leave_to_parent() -> None:
    """Let a forked child end by these signals at once, also within compiled code."""
    for number in _OTHERS:
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, signal.SIG_DFL)


if sys.platform != "win32":
    os.register_at_fork(after_in_child=_leave_to_parent)
