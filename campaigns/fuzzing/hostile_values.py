"""Values and encodings that readers do not expect."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

Change = Callable[[bytes], bytes]
Mutator = Callable[[bytes, Random, Change], bytes]

NUMBERS = (
    *("0", "-0", "-1", "1", "2", "3", "7", "0.5", "-0.0", "1e-400", "1e400", "1e308", "-1e308"),
    *("1e-308", "5e-324", "1e16", "NaN", "Infinity", "-Infinity", "nan", "inf", "-inf", "0x10"),
    *("1_000", "01", ".5", "1.", "+1", "1e", "255", "256", "512", "516", "65535", "65536"),
    *("1000000", "2147483647", "2147483648", "4294967295", "4294967296", "9223372036854775807"),
    *("9223372036854775808", "-9223372036854775809", "18446744073709551616", "true", "null"),
    *("1" * 39, "1" * 40, "1" * 401, "1" * 5000, "0." + "3" * 500, "[]", "{}", '""'),
)
"""Numbers, and what stands in their place, as text."""

TEXTS = (
    *("", " ", "\0", "\x1b[2J", "\x1b]0;owned\x07", "\x9b2J", "\x7f", "\u202e", "\u2028", "\ufeff"),
    *("\ud800", "\udcff", "\n", "\r\n", "a\nb", "\t", "é", "杯", "😀", "a" * 3000, "%s%n", "{}"),
    *("[red]", "[/]", "nan", "none", "null", "../../etc/passwd", "/", ".", "..", "/dev/zero"),
    *("C:\\x", "\\", '"', "'", "__class__", "file:///etc/passwd", "data:;base64,AAAA", "-1"),
)
"""Strings for the place of others."""

_ENCODINGS = ("utf-16", "utf-8-sig", "utf-32", "latin-1", "utf-16-be")


def encoded(data: bytes, rng: Random) -> bytes:
    """Write a text in another encoding."""
    return data.decode("utf-8", "replace").encode(rng.choice(_ENCODINGS), "replace")
