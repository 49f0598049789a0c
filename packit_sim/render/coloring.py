"""What colours tell: which item has which, by a rule, and what it means.

Every set of colours here can be told apart by the colour-blind.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.geometry.shapes import Item, Shape

Color = tuple[float, float, float]
"""Red, green and blue, 0 to 1."""

PALETTE = (
    *((0.00, 0.45, 0.70), (0.90, 0.62, 0.00), (0.00, 0.62, 0.45), (0.80, 0.47, 0.65)),
    *((0.34, 0.71, 0.91), (0.84, 0.37, 0.00), (0.87, 0.80, 0.47), (0.53, 0.13, 0.33)),
    *((0.59, 0.90, 0.80), (0.60, 0.60, 0.20), (0.45, 0.45, 0.75), (0.20, 0.20, 0.55)),
)
"""Most after Okabe and Ito and Paul Tol; the colour-blind can tell them apart."""

_SHADES = (0.0, 0.25, 0.45)
"""Shares of white in the colours of the palette, where there are more things than colours."""

_RAMP = ((0.24, 0.22, 0.52), (0.13, 0.46, 0.58), (0.36, 0.70, 0.46), (0.99, 0.90, 0.42))
"""From little to much: ever lighter, so that it can be read without telling colours at all."""

UNKNOWN: Color = (0.72, 0.72, 0.72)
"""Of items that have no number."""


@dataclass(frozen=True)
class ColorKey:
    """A legend of names, each with its colour."""

    title: str
    entries: tuple[tuple[str, Color], ...]


@dataclass(frozen=True)
class ColorScale:
    """A legend of numbers: what the ends of the ramp of colours stand for."""

    title: str
    low: str
    high: str


Legend = ColorKey | ColorScale


@dataclass(frozen=True)
class Colors:
    """The colour of each item, in their order, and what the colours mean if they mean anything."""

    of: tuple[Color, ...]
    legend: Legend | None = None


Coloring = Callable[[Sequence[Item]], Colors]
"""A rule that gives colours to the items of a box, which come in the order of placing."""


def color_of(shape: Shape) -> Color:
    """The shape's own colour, whatever box it is in: one of the palette in one of three shades."""
    return _tinted(int(shape.digest[:8], 16) % (len(_SHADES) * len(PALETTE)))


def hexadecimal(color: Color) -> str:
    """Its six digits."""
    return bytes(round(255 * channel) for channel in color).hex()


def ramp(share: float) -> Color:
    """The colour of a share, 0 for little and 1 for much."""
    at = np.clip(share, 0, 1) * (len(_RAMP) - 1)
    channels = np.transpose(_RAMP)
    red, green, blue = (float(np.interp(at, range(len(_RAMP)), c)) for c in channels)
    return red, green, blue


def by_item(items: Sequence[Item]) -> Colors:
    """Each shape in its own colour, the same in every picture."""
    return Colors(tuple(color_of(item.shape) for item in items))


def by_category(items: Sequence[Item]) -> Colors:
    """A colour for each category, those first in the palette that are most frequent."""
    counts = Counter(item.shape.category for item in items)
    names = sorted(counts, key=lambda name: (-counts[name], name))
    shades = len(PALETTE) * len(_SHADES)
    colors = {name: _tinted(n % shades) for n, name in enumerate(names)}
    return Colors(
        tuple(colors[item.shape.category] for item in items),
        ColorKey("category", tuple((name or "none", colors[name]) for name in names)),
    )


def by_order(items: Sequence[Item]) -> Colors:
    """The order of placing, from the first to the last."""
    last = max(1, len(items) - 1)
    shares = tuple(ramp(n / last) for n in range(len(items)))
    return Colors(shares, ColorScale("order of placing", "first", "last"))


@dataclass(frozen=True)
class ByShare:
    """The reward that each item brings: its volume's share of the volume of a task's items.

    total: that volume, in box units cubed; by default all items of the task are in the picture.
    """

    total: float | None = None

    def __call__(self, items: Sequence[Item]) -> Colors:
        volumes = [item.volume for item in items]
        total = self.total or sum(volumes)
        shares = {n: volume / total for n, volume in enumerate(volumes)}
        return ByNumber("share of the reward", shares, low=0.0, spec=".1%")(items)


@dataclass(frozen=True)
class ByNumber:
    """A number of each item, such as a score: light where it is large.

    title: what the number is. numbers: by the items' places in their order; items without one are
    grey. low, high: ends of the scale, by default of the numbers. spec: how the ends are written.
    """

    title: str
    numbers: Mapping[int, float]
    low: float | None = None
    high: float | None = None
    spec: str = ".3g"

    def __call__(self, items: Sequence[Item]) -> Colors:
        low = min(self.numbers.values(), default=0.0) if self.low is None else self.low
        high = max(self.numbers.values(), default=1.0) if self.high is None else self.high
        width = high - low or 1.0
        colors = tuple(
            ramp((self.numbers[n] - low) / width) if n in self.numbers else UNKNOWN
            for n in range(len(items))
        )
        return Colors(
            colors, ColorScale(self.title, format(low, self.spec), format(high, self.spec))
        )


COLORINGS: Mapping[str, Coloring] = {
    "item": by_item,
    "category": by_category,
    "order": by_order,
    "share": ByShare(),
}
"""The rules that need to know nothing but the items."""


def _tinted(number: int) -> Color:
    shade, hue = divmod(number, len(PALETTE))
    red, green, blue = (c + (1 - c) * _SHADES[shade] for c in PALETTE[hue])
    return red, green, blue
