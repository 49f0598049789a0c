"""Rules that give each item of a box a colour, and legends that explain them.

Colour-blind readers can distinguish the colours of every rule.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.core.sums import plain_sum
from packit_sim.geometry.shapes import Item, Shape

Color = tuple[float, float, float]
"""Red, green and blue, 0 to 1."""

PALETTE = (
    *((0.00, 0.45, 0.70), (0.90, 0.62, 0.00), (0.00, 0.62, 0.45), (0.80, 0.47, 0.65)),
    *((0.34, 0.71, 0.91), (0.84, 0.37, 0.00), (0.87, 0.80, 0.47), (0.53, 0.13, 0.33)),
    *((0.59, 0.90, 0.80), (0.60, 0.60, 0.20), (0.45, 0.45, 0.75), (0.20, 0.20, 0.55)),
)
"""Colours that colour-blind readers can distinguish, mostly by Okabe and Ito and by Paul Tol."""

_SHADES = (0.0, 0.25, 0.45)
"""Shares of white in the palette's colours, for more categories than it has colours."""

_RAMP = ((0.24, 0.22, 0.52), (0.13, 0.46, 0.58), (0.36, 0.70, 0.46), (0.99, 0.90, 0.42))
"""Colours from low to high, lighter at each step, so that brightness alone distinguishes them."""

UNKNOWN_COLOR: Color = (0.72, 0.72, 0.72)
"""The colour of items without a number."""


@dataclass(frozen=True)
class ColorKey:
    """A legend that gives each name a colour.

    Attributes
    ----------
    title : str
        The quantity that the colours show.
    entries : tuple of (str, Color)
        Names and their colours, in the order of the legend.
    """

    title: str
    entries: tuple[tuple[str, Color], ...]


@dataclass(frozen=True)
class ColorScale:
    """A legend of numbers.

    Attributes
    ----------
    title : str
        The quantity that the colours show.
    low : str
        The value at the lower end of the colour ramp.
    high : str
        The value at the upper end.
    """

    title: str
    low: str
    high: str


Legend = ColorKey | ColorScale


@dataclass(frozen=True)
class Colors:
    """The colours of a box's items.

    Attributes
    ----------
    of : tuple of Color
        The colour of each item, in the order of placing.
    legend : Legend or None
        The legend, if the colours have a meaning.
    """

    of: tuple[Color, ...]
    legend: Legend | None = None


Coloring = Callable[[Sequence[Item]], Colors]
"""A rule that gives colours to the items of a box, in the order of placing."""


def color_of(shape: Shape) -> Color:
    """Return the shape's colour, the same in every box: a palette colour in one of three shades."""
    return _tinted(int(shape.digest[:8], 16) % (len(_SHADES) * len(PALETTE)))


def hexadecimal(color: Color) -> str:
    """Return the six hexadecimal digits of a colour."""
    return bytes(round(255 * channel) for channel in color).hex()


def ramp(share: float) -> Color:
    """Return the colour of a share, 0 for low and 1 for high."""
    at = np.clip(share, 0, 1) * (len(_RAMP) - 1)
    channels = np.transpose(_RAMP)
    red, green, blue = (float(np.interp(at, range(len(_RAMP)), c)) for c in channels)
    return red, green, blue


def by_item(items: Sequence[Item]) -> Colors:
    """Give each shape its own colour, the same in every picture."""
    return Colors(tuple(color_of(item.shape) for item in items))


def by_category(items: Sequence[Item]) -> Colors:
    """Give each category a colour, in the palette's order from the most frequent one on."""
    counts = Counter(item.shape.category for item in items)
    names = sorted(counts, key=lambda name: (-counts[name], name))
    shades = len(PALETTE) * len(_SHADES)
    colors = {name: _tinted(n % shades) for n, name in enumerate(names)}
    return Colors(
        tuple(colors[item.shape.category] for item in items),
        ColorKey("category", tuple((name or "none", colors[name]) for name in names)),
    )


def by_order(items: Sequence[Item]) -> Colors:
    """Colour items by the order of placing, from the first to the last.

    Parameters
    ----------
    items : Sequence[Item]
        The items of a box, in the order of placing.

    Returns
    -------
    Colors
        Their colours, darkest first, and the legend.

    Examples
    --------
    >>> from packit_sim import Look, by_order, load_tasks
    >>> items = load_tasks("starter")[0].items
    >>> by_order(items).legend
    ColorScale(title='order of placing', low='first', high='last')
    >>> look = Look(coloring=by_order)
    """
    last = max(1, len(items) - 1)
    shares = tuple(ramp(n / last) for n in range(len(items)))
    return Colors(shares, ColorScale("order of placing", "first", "last"))


@dataclass(frozen=True)
class ByShare:
    """A rule that shows each item's reward: its share of the volume of a task's items.

    Parameters
    ----------
    total : float | None
        The volume of the task's items, in box units cubed; by default that of the coloured items.
    """

    total: float | None = None

    def __call__(self, items: Sequence[Item]) -> Colors:
        volumes = [item.volume for item in items]
        total = self.total or plain_sum(volumes)
        shares = {n: volume / total for n, volume in enumerate(volumes)}
        return ByNumber("share of the reward", shares, low=0.0, spec=".1%")(items)


@dataclass(frozen=True)
class ByNumber:
    """A rule that shows a number of each item, such as a score: light where it is large.

    Parameters
    ----------
    title : str
        The name of the number.
    numbers : Mapping[int, float]
        The number by the item's index; items without one are grey.
    low : float | None
        The low end of the scale, by default the smallest number.
    high : float | None
        The high end of the scale, by default the largest number.
    spec : str
        The format of the ends.

    Examples
    --------
    >>> from packit_sim import ByNumber, Look, load_tasks
    >>> items = load_tasks("starter")[0].items
    >>> masses = ByNumber("mass in g", {0: 120.0, 2: 40.0})
    >>> masses(items[:3]).legend
    ColorScale(title='mass in g', low='40', high='120')
    >>> look = Look(coloring=masses)
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
            ramp((self.numbers[n] - low) / width) if n in self.numbers else UNKNOWN_COLOR
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
"""Rules by name that depend only on the items."""


def lighter(color: Color, white: float) -> Color:
    """Return a colour with a share of white."""
    red, green, blue = (c + (1 - c) * white for c in color)
    return red, green, blue


def _tinted(number: int) -> Color:
    shade, hue = divmod(number, len(PALETTE))
    return lighter(PALETTE[hue], _SHADES[shade])
