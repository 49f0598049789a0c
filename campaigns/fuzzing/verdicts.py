"""What is wrong with how a reader treats a file: the bounds that hold for each, and their check."""

from __future__ import annotations

import logging
import re
import resource
import signal
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from campaigns.fuzzing.reader import Reader
from packit_sim.core.errors import PackItError

MAX_MEMORY = 256 * 2**20
"""Most memory, in bytes, that the process may take in addition while it reads one file."""

MAX_ADDRESSES = 2 * 2**30
"""Most addresses, in bytes, that a process may take in addition for all the files it reads."""

MAX_MESSAGE = 2000
"""Most characters of a message."""

_UNFIT = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Characters that command a terminal, end a line, turn the direction, or can't be printed."""

KINDS = ("untyped error", "memory", "time", "warning", "message", "crash")
"""Everything that may be wrong."""


class _TooSlow(BaseException):
    """Raised by the alarm; no reader catches it."""


@dataclass(frozen=True)
class Finding:
    """What is wrong with how a reader treats a file.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    what : str
        The error or the message, in one line.
    where : str
        The function of ours in which it came up.
    """

    kind: str
    what: str
    where: str = ""

    @property
    def key(self) -> tuple[str, str]:
        """The same for findings that have one reason, as far as one can tell."""
        return self.kind, self.where or self.what


class _Records(logging.Handler):
    """Keeps the messages of our loggers."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


@contextmanager
def _recorded() -> Iterator[list[str]]:
    """Let our loggers keep all their messages, and print none."""
    records = _Records()
    loggers = [logging.getLogger(name) for name in ("packit_sim", "packit_agents")]
    before = [(logger.handlers, logger.level, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.handlers, logger.propagate = [records], False
        logger.setLevel(logging.DEBUG)
    try:
        yield records.messages
    finally:
        for logger, (handlers, level, propagate) in zip(loggers, before, strict=True):
            logger.handlers, logger.propagate = handlers, propagate
            logger.setLevel(level)


def judge(reader: Reader, data: bytes) -> Finding | None:
    """Let a reader read a file, and say what is wrong with how it does.

    Parameters
    ----------
    reader : Reader
        The reader.
    data : bytes
        The content of the file.

    Returns
    -------
    Finding or None
        What is wrong: an error that is not a `PackItError`, more memory or CPU time than the
        bounds, a warning, or a message with control characters, without end, or of several lines.
    """
    error: BaseException | None = None
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.signal(signal.SIGPROF, _stop)
    with _recorded() as logged, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        started = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, reader.seconds)
        try:
            reader.read(data)
        except (Exception, _TooSlow) as caught:
            error = caught
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        seconds = time.process_time() - started
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    if isinstance(error, _TooSlow) or seconds > reader.seconds:
        return Finding("time", f"more than {reader.seconds:g} s of CPU time", _place(error))
    if memory > MAX_MEMORY or isinstance(_root(error), MemoryError):
        return Finding("memory", f"more than {MAX_MEMORY >> 20} MiB", _place(error))
    if error is not None and not isinstance(error, PackItError):
        return Finding("untyped error", f"{type(error).__name__}: {error!r:.300}", _place(error))
    if warned:
        one = warned[0]
        return Finding("warning", f"{one.category.__name__}: {one.message}"[:300], _ours(one))
    messages = [*logged, *([str(error)] if error is not None else [])]
    for message in messages:
        fault = _fault(message)
        if fault:
            return Finding("message", f"{fault}: {message!r:.300}", _place(error))
    return None


def _stop(*_: object) -> None:
    raise _TooSlow


def _root(error: BaseException | None) -> BaseException | None:
    """Return the first error of a chain."""
    while error is not None and (error.__cause__ or error.__context__) is not None:
        error = error.__cause__ or error.__context__
    return error


def _place(error: BaseException | None) -> str:
    """Return the innermost function of ours in which an error came up."""
    ours = [
        f"{frame.filename.rpartition('/')[2]}:{frame.name}"
        for frame in traceback.extract_tb(error.__traceback__ if error is not None else None)
        if "/packit_sim/" in frame.filename or "/packit_agents/" in frame.filename
    ]
    inner = "" if not isinstance(error, Exception) else type(error).__name__
    return f"{ours[-1] if ours else ''} {inner}".strip()


def _ours(warned: Any) -> str:
    return f"{warned.filename.rpartition('/')[2]}:{warned.lineno}"


def _fault(message: str) -> str | None:
    if len(message) > MAX_MESSAGE:
        return f"{len(message):,} characters"
    for character in message:
        if _UNFIT.match(character):
            return f"character {ord(character):#x}"
    return None if message.strip() else "no text"
