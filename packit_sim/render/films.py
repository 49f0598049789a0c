"""Films of a box: items fly in one after the other, or the camera circles the box."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from packit_sim.core.checks import POSITIVE, Range, check_settings
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import Contents, ItemInBox, PlacedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.render.cameras import turntable
from packit_sim.render.image_files import RGBImage
from packit_sim.render.layouts import ITEM_GAP, Layout
from packit_sim.render.looks import DEFAULT_LOOK, Look
from packit_sim.render.scene import Scene

Frame = tuple[Look, Layout | None]
"""The look and the layout of one frame of a film."""

_SIDES = ((2, 1), (1, 1), (0, 1), (0, -1), (1, -1))
"""Directions from which items enter, in order of preference: axis, and 1 or -1 for the side."""

_POINTS = 200
"""Points along a path."""

_RISE = 0.3
"""The least height by which items rise, in box units."""

_BEND = 0.2
"""Distance from a corner at which a path begins to bend, in box units."""


@dataclass(frozen=True)
class Pace:
    """The speed of a film.

    Parameters
    ----------
    fps : int
        Frames per second, 1 to 100.
    flight : float
        Seconds from an item's start to its place.
    gap : float
        Seconds from the start of an item to that of the next.
    rest : float
        Seconds before the first start, and after the last item is in its place.

    Raises
    ------
    ArgumentError
        If a parameter is out of range.
    """

    fps: int = 25
    flight: float = 1.6
    gap: float = 0.9
    rest: float = 1.0

    def __post_init__(self) -> None:
        check_settings(self, fps=Range(1, 100), flight=POSITIVE, gap=POSITIVE, rest=POSITIVE)

    @classmethod
    def lasting(cls, seconds: float, items: int, fps: int = 25) -> Pace:
        """Return the pace at which a film of `items` items takes `seconds`, rests included."""
        usual = cls(fps)
        share = seconds / usual.seconds(items)
        return cls(fps, usual.flight * share, usual.gap * share, usual.rest * share)

    def seconds(self, items: int) -> float:
        """Return the duration of a film of a number of items."""
        return 2 * self.rest + (self.flight + self.gap * (items - 1) if items else 0.0)


def packing(
    box: Contents[PlacedItem], look: Look = DEFAULT_LOOK, pace: Pace | None = None
) -> Iterator[Frame]:
    """Yield frames in which the items, which stand next to the box, enter it one after the other.

    Each rises, rotates on the way, and enters from above, or from the side on which the fewest
    items are in its way: not every packing can be assembled without collision.

    Parameters
    ----------
    look : Look
        The look of the box.
    pace : Pace | None
        The speed.

    Returns
    -------
    Iterator[Frame]
        The frames.

    Raises
    ------
    ArgumentError
        If the look cuts the box open or moves its items apart; `turning` can show that.
    """
    if look.cut is not None or look.explode:
        raise ArgumentError(
            "a box that is cut open or moved apart can't be packed: film a turn of it"
        )
    return _packing(box, look, pace or Pace())


def _packing(box: Contents[PlacedItem], look: Look, pace: Pace) -> Iterator[Frame]:
    """Yield the frames of `packing`."""
    size = np.array(box.cells) * CELL
    outside = Layout.standing([placed.item for placed in box.placed], size)
    inside = Layout.packed(box.placed, size)
    flights = [
        _Flight.of(placed, start, end, side, size)
        for placed, start, end, side in zip(
            box.placed, outside.poses, inside.poses, sides(box), strict=True
        )
        if start is not None and end is not None
    ]
    points = np.concatenate((outside.points, *(flight.reach for flight in flights)))
    for n in range(round(pace.seconds(len(flights)) * pace.fps) + 1):
        now = n / pace.fps - pace.rest
        poses = [
            flight.at(_eased((now - k * pace.gap) / pace.flight))
            for k, flight in enumerate(flights)
        ]
        yield look, Layout(tuple(poses), points)


def turning(box: Contents[ItemInBox], views: int, look: Look = DEFAULT_LOOK) -> Iterator[Frame]:
    """Yield `views` frames of one turn around a box, which can be repeated without a jump."""
    size = np.array(box.cells) * CELL
    layout = Layout.packed(box.placed, size, look.explode).all_round(size)
    for camera in turntable(views, look.camera):
        yield replace(look, camera=camera), layout


def shot(
    box: Contents[ItemInBox], frames: Iterable[Frame], width: int = 512, height: int = 512
) -> Iterator[RGBImage]:
    """Yield the pictures (H, W, 3) of frames."""
    with Scene(box) as scene:
        for look, layout in frames:
            yield scene.snapshot(width, height, look, layout).image


def sides(box: Contents[PlacedItem]) -> list[tuple[int, int]]:
    """Choose the side from which each item enters, on which the fewest earlier cells block it.

    Returns
    -------
    list[tuple[int, int]]
        For each item the axis, and 1 for its high side or -1 for its low side.
    """
    filled = np.zeros(box.cells, dtype=bool)
    chosen = []
    for placed in box.placed:
        outer = placed.item.outer
        blocked = [_blocked(filled, placed, outer, axis, side) for axis, side in _SIDES]
        chosen.append(_SIDES[int(np.argmin(blocked))])
        filled[tuple(map(slice, placed.start, placed.stop))] |= outer
    return chosen


def _blocked(
    filled: npt.NDArray[np.bool_],
    placed: PlacedItem,
    outer: npt.NDArray[np.bool_],
    axis: int,
    side: int,
) -> int:
    """Count the cells of an item with a filled cell between them and a side of the box."""
    window = list(map(slice, placed.start, placed.stop))
    window[axis] = slice(placed.start[axis], None) if side > 0 else slice(None, placed.stop[axis])
    column = np.moveaxis(filled[tuple(window)], axis, 0)
    own = np.moveaxis(outer, axis, 0)
    if side > 0:
        column, own = column[::-1], own[::-1]
    ahead = np.logical_or.accumulate(column, axis=0)
    return int(np.count_nonzero(ahead[-len(own) :] & own))


@dataclass(frozen=True, eq=False)
class _Flight:
    """The path of an item into the box.

    Attributes
    ----------
    start, end : Motion
        The item's poses at both ends.
    path : ndarray of float64, shape (n, 3)
        Positions of its centre, at equal distances.
    entry : float
        The share of the path after which the item enters the box.
    reach : ndarray of float64, shape (n, 3)
        Positions of its top.
    """

    start: Motion
    end: Motion
    path: Floats
    entry: float
    reach: Floats

    @classmethod
    def of(
        cls, placed: PlacedItem, start: Motion, end: Motion, side: tuple[int, int], size: Floats
    ) -> _Flight:
        """Plan a path: up, over the box unless the item is at its side, and straight in."""
        axis, sign = side
        half = placed.item.extents / 2
        turn = end.translation.copy()
        turn[axis] = (size[axis] if sign > 0 else 0.0) + sign * (half[axis] + ITEM_GAP + _BEND)
        over = max(size[2] + half[2] + ITEM_GAP, turn[2], start.translation[2] + _RISE)
        if axis == 0 and sign > 0:
            over = max(turn[2], start.translation[2] + _RISE)
        ways = [np.array((*way[:2], over)) for way in (start.translation, turn)]
        points, corner = _rounded([start.translation, *ways, turn, end.translation])
        way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
        even = np.linspace(0, way[-1], _POINTS)
        path = np.stack([np.interp(even, way, channel) for channel in points.T], axis=1)
        reach = path + np.array((0.0, 0.0, half[2]))
        return cls(start, end, path, float(way[corner] / way[-1]), reach)

    def at(self, share: float) -> Motion:
        """Compute the item's pose at a share of its path; it has its rotation before it enters."""
        if share <= 0:
            return self.start
        if share >= 1:
            return self.end
        places = np.linspace(0, 1, len(self.path))
        center = np.array([np.interp(share, places, channel) for channel in self.path.T])
        return self.start.interpolate(self.end, _eased(share / self.entry)).at(center)


def _rounded(ways: Sequence[Floats]) -> tuple[Floats, int]:
    """Connect points by a line (n, 3) with rounded corners; return where the last corner ends."""
    kept = [ways[0]] + [way for last, way in pairwise(ways) if np.linalg.norm(way - last) > 1e-9]
    points = [kept[0]]
    for before, corner, after in zip(kept, kept[1:], kept[2:], strict=False):
        legs = [way - corner for way in (before, after)]
        lengths = [float(np.linalg.norm(leg)) for leg in legs]
        near = min(_BEND, *(0.5 * length for length in lengths))
        first, last = (corner + leg * near / n for leg, n in zip(legs, lengths, strict=True))
        t = np.linspace(0, 1, 24)[:, None]
        points += list((1 - t) ** 2 * first + 2 * t * (1 - t) * corner + t**2 * last)
    return np.array([*points, kept[-1]]), len(points) - 1


def _eased(share: float) -> float:
    """Map a share of 0 to 1 to another, with speed 0 at both ends."""
    u = min(1.0, max(0.0, share))
    return u**3 * (10 - 15 * u + 6 * u**2)
