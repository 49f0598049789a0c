"""Plain text for messages: names from files may contain control characters."""

from __future__ import annotations

import logging
from collections.abc import Iterable

MAX_CHARACTERS = 2000
"""Maximum number of characters of a message; the middle of a longer one is omitted."""

_CONTROL = {code: 0x2400 + code for code in range(0x20) if chr(code) != "\n"}
_OTHERS = (
    *(0x61C, 0x200B, 0x200E, 0x200F, 0x2028, 0x2029, 0xFEFF),
    *range(0x202A, 0x202F),
    *range(0x2060, 0x206A),
    *range(0xD800, 0xE000),
)

_VISIBLE: dict[int, int | str] = {
    **_CONTROL,
    **dict.fromkeys([*range(0x7F, 0xA0), *_OTHERS], "\ufffd"),
}
"""Replacements of characters that control a terminal, end a line, change the direction of writing,
are invisible, or can't be encoded: pictures of the first 32, else the replacement character."""


def plain(text: str) -> str:
    """Replace all characters that are not printable, except newlines."""
    return text.translate(_VISIBLE)


def plain_line(text: str) -> str:
    """Return a text as one plain line of at most `MAX_CHARACTERS`."""
    line = plain(text.replace("\n", " ").strip())
    if len(line) <= MAX_CHARACTERS:
        return line
    kept = MAX_CHARACTERS // 2 - 20
    return f"{line[:kept]} [{len(line) - 2 * kept:,} more] {line[-kept:]}"


def plain_logger(name: str) -> logging.Logger:
    """Return the logger of a module, whose records are plain lines for every handler."""
    logger = logging.getLogger(name)
    logger.addFilter(_make_plain)
    return logger


def _make_plain(record: logging.LogRecord) -> bool:
    record.msg, record.args = plain_line(record.getMessage()), None
    return True


def listed(values: Iterable[object]) -> str:
    """List values for a message, eight at most."""
    texts = [str(value) for value in values]
    more = len(texts) - 8
    return ", ".join(texts[:8]) + (f" and {more} more" if more > 0 else "")
