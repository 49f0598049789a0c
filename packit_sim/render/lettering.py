"""Text in pictures, in the font that comes with Pillow, in lines that fit."""

from __future__ import annotations

import functools
import math
import unicodedata
from bisect import bisect_right
from collections.abc import Iterator

from PIL import ImageFont
from PIL.ImageFont import FreeTypeFont

ELLIPSIS = "\N{HORIZONTAL ELLIPSIS}"


@functools.cache
def font_of(size: int) -> FreeTypeFont:
    """Return the font, `size` pixels high."""
    font = ImageFont.load_default(size)
    assert isinstance(font, FreeTypeFont)
    return font


def line_height(font: FreeTypeFont) -> int:
    """Return the distance between lines, in pixels."""
    return math.ceil(1.2 * font.size)


def plain(text: str) -> str:
    """Reduce text to one line of ASCII, which the font has: no accents, "?" for other letters."""
    bare = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    line = " ".join(bare.encode("ascii", "replace").decode().split())
    return "".join(c if c.isprintable() else "?" for c in line)


def shortened(text: str, font: FreeTypeFont, width: float) -> str:
    """Replace the middle of a text that is too wide by an ellipsis."""

    def cut(kept: int) -> str:
        tail = kept // 2
        return text[: kept - tail] + ELLIPSIS + text[len(text) - tail :]

    if font.getlength(text) <= width:
        return text
    fitting = bisect_right(range(len(text)), width, key=lambda kept: font.getlength(cut(kept)))
    return cut(max(0, fitting - 1))


def lines_of(text: str, font: FreeTypeFont, width: float) -> Iterator[str]:
    """Break text at spaces, and within words that are wider than a line; at least one line."""
    while True:
        sizes = range(1, min(len(text), math.ceil(width)) + 1)
        end = max(1, bisect_right(sizes, width, key=lambda n: font.getlength(text[:n])))
        space = text.rfind(" ", 0, end + 1)
        if end < len(text) and space > 0:
            end = space
        yield text[:end]
        text = text[end:].lstrip()
        if not text:
            return
