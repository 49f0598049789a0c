"""A repetition in a file: what is repeated, how often, and the file around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

LONGEST = 16_384
"""Bytes of the largest file, in addition to those of the file around the repetition."""

MOST = 8192
"""Largest number of repetitions: more make no shorter file that is worth reading."""


@dataclass(frozen=True)
class Repetition:
    """A kind of repetition in a file.

    Attributes
    ----------
    name : str
        What is repeated, and where.
    write : callable
        Returns the file with so many repetitions.
    """

    name: str
    write: Callable[[int], bytes]

    @property
    def most(self) -> int:
        """The number of repetitions of the largest file, a multiple of 4."""
        count = 4
        around = len(self.write(0))
        while count < MOST and len(self.write(2 * count)) - around <= LONGEST:
            count *= 2
        return count


def repeated(
    name: str, head: bytes, unit: bytes, tail: bytes, close: bytes = b"", middle: bytes = b""
) -> Repetition:
    """Return the repetition of some bytes, such as that of an opening and its closing bracket."""
    return Repetition(name, lambda n: head + unit * n + middle + close * n + tail)


def wrapped(prefix: str, one: Repetition, wrap: Callable[[bytes], bytes]) -> Repetition:
    """Return a repetition in a part of a file, given what puts the part into the file."""
    return Repetition(f"{prefix}{one.name}", lambda n: wrap(one.write(n)))
