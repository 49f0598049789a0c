"""A screening outside Valgrind: only what may grow too fast, by its CPU time, is counted there.

Files that are larger than those that are counted are read, so that work that grows as a square
stands out from times, which differ by some tenths from run to run.
"""

from __future__ import annotations

import gc
import math
import os
import resource
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from campaigns.growth.repetition import LONGEST, MOST, Repetition

SUSPICIOUS = 1.3
"""Largest exponent of times that is not counted."""

SURELY_FINE = 1.0
"""Largest exponent of times that are not measured again."""

TIMES = 8
"""How many times as long as the longest file that is counted the longest file is."""

FEW_SECONDS = 4e-3
"""CPU time by which two files must differ: less is no growth that one could measure."""

NOISE_SECONDS = 5e-4
"""CPU time by which two readings of one file differ."""

ENOUGH_SECONDS = 0.2
"""CPU time of a read after which no longer file is read."""

SECONDS = 20
"""Limit of the CPU time of all reads of a repetition."""

ROUNDS = 6
"""Most repetitions of the measurement of what is suspicious."""

_NUMBER = struct.Struct("d")


def screened(read: Callable[[bytes], object], one: Repetition) -> float:
    """Return the largest exponent of the CPU times with which a reader's work grows.

    It is the largest for all files up to the longest one, of times in a new process, or of the
    smallest in several ones if it may be large.

    Parameters
    ----------
    read : callable
        The reader.
    one : Repetition
        What is repeated.

    Returns
    -------
    float
        The exponent; 0 if the time hardly grows, infinite if a file is not read within the limit.
    """
    best: list[float] = []
    found = 0.0
    for number in range(ROUNDS):
        times = _times(read, one)
        if times is None:
            return math.inf
        known = min(len(best), len(times)) if best else len(times)
        best = [min(each) for each in zip(best[:known] or times, times[:known], strict=True)]
        found = exponent(best)
        if found <= (SUSPICIOUS if number else SURELY_FINE):
            break
    return found


def exponent(times: Sequence[float]) -> float:
    """Return the largest exponent of the times of files that double, 0 where these hardly differ.

    It is the mean of two doublings, which has less noise than that of one, of what a file takes
    more than the one that takes least. The first time is that of a file without a repetition.
    """
    found, least = 0.0, min(times, default=0.0)
    for small, large in zip(times[1:], times[3:], strict=False):
        if large - least >= FEW_SECONDS:
            added = max(small - least, 0.0) + NOISE_SECONDS
            found = max(found, math.log2((large - least) / added) / 2)
    return found


def _times(read: Callable[[bytes], object], one: Repetition) -> list[float] | None:
    """Return the times of files with 0, 32, 64, 128 ... repetitions; None above the limit."""
    reading, writing = os.pipe()
    gc.collect()
    gc.freeze()  # the child does not visit the objects of this process
    child = os.fork()
    if child == 0:
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            _read_all(read, one, writing)
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        data = pipe.read()
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return None
    return [value for (value,) in _NUMBER.iter_unpack(data)]


def _read_all(read: Callable[[bytes], object], one: Repetition, pipe: int) -> None:
    with suppress(Exception):  # the first file loads what the others need
        read(one.write(16))
    around, count, seconds = len(one.write(0)), 0, 0.0
    while count <= TIMES * MOST and seconds < ENOUGH_SECONDS:
        data = one.write(count)
        if len(data) - around > TIMES * LONGEST:
            return
        start = time.thread_time()  # with a limit, the clock of the process is a coarse one
        with suppress(Exception):  # a refusal takes time as well
            read(data)
        seconds = time.thread_time() - start
        os.write(pipe, _NUMBER.pack(seconds))
        count = 2 * count or 32
