"""Films of a box: how it is packed, item by item, and a turn around it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.poses import Pose
from packit_sim.placement import Contents, ItemInBox, PlacedItem
from packit_sim.render.cameras import turntable
from packit_sim.render.image_files import RGBImage
from packit_sim.render.layouts import GAP, Floats, Layout
from packit_sim.render.looks import DEFAULT_LOOK, Look
from packit_sim.scene import Scene

Frame = tuple[Look, Layout | None]
"""How a box is shown at a moment of a film."""

_SIDES = ((2, 1), (1, 1), (0, 1), (0, -1), (1, -1))
"""From where an item may come, the first preferred: axis, and the side of the box on it."""

_POINTS = 200
"""Along a path."""

_RISE = 0.3
"""How far items rise at least, in box units."""

_BEND = 0.2
"""From how far off a path goes around a corner, in box units."""


@dataclass(frozen=True)
class Pace:
    """How fast a film goes.

    fps: frames a second. flight: seconds from an item's start to its place. gap: seconds from the
    start of an item to that of the next. rest: seconds before the first start and after the last
    item is in its place. Raises ValueError where one is out of range.
    """

    fps: int = 25
    flight: float = 1.6
    gap: float = 0.9
    rest: float = 1.0

    def __post_init__(self) -> None:
        if not 1 <= self.fps <= 100:
            raise ArgumentError(f"fps {self.fps!r} are not possible: 1 to 100")
        for name in ("flight", "gap", "rest"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ArgumentError(f"{name} {value!r} is not possible: it must be above 0 seconds")

    @classmethod
    def lasting(cls, seconds: float, items: int, fps: int = 25) -> Pace:
        """The pace at which so many items are packed in so many seconds, rests included."""
        usual = cls(fps)
        share = seconds / usual.seconds(items)
        return cls(fps, usual.flight * share, usual.gap * share, usual.rest * share)

    def seconds(self, items: int) -> float:
        """How long it takes to pack so many."""
        return 2 * self.rest + (self.flight + self.gap * (items - 1) if items else 0.0)


def packing(
    box: Contents[PlacedItem], look: Look = DEFAULT_LOOK, pace: Pace | None = None
) -> Iterator[Frame]:
    """Frames in which the items of a box, which stand beside it, come in one after the other.

    Each rises, turns on the way, and comes in from above, or from the side on which least of what
    is there already is in its way: not every packing can be made by hand. Raises ValueError where
    the look cuts the box open or moves its items apart, which `turning` shows.
    """
    if look.cut is not None or look.explode:
        raise ArgumentError(
            "a box that is cut open or moved apart can't be packed: film a turn of it"
        )
    return _packing(box, look, pace or Pace())


def _packing(box: Contents[PlacedItem], look: Look, pace: Pace) -> Iterator[Frame]:
    """Frames of `packing`."""
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
    """Frames of one turn around a box, so many, which can be shown again without a jump."""
    size = np.array(box.cells) * CELL
    layout = Layout.packed(box.placed, size, look.explode).all_round(size)
    for camera in turntable(views, look.camera):
        yield replace(look, camera=camera), layout


def shot(
    box: Contents[ItemInBox], frames: Iterable[Frame], width: int = 512, height: int = 512
) -> Iterator[RGBImage]:
    """The pictures (H, W, 3) of frames, one at a time."""
    with Scene(box) as scene:
        for look, layout in frames:
            yield scene.snapshot(width, height, look, layout).image


def sides(box: Contents[PlacedItem]) -> list[tuple[int, int]]:
    """For each item, from where it comes in: axis, and 1 for the side where that is large, or -1.

    The one from which the fewest of its cells pass through cells of items before it.
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
    """How many of an item's cells have a filled one between them and a side of the box."""
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
    """An item's way into the box.

    path: (n, 3) of its centre, at equal distances. entry: the share of it where the box begins.
    reach: (n, 3) how high it comes.
    """

    start: Pose
    end: Pose
    path: Floats
    entry: float
    reach: Floats

    @classmethod
    def of(
        cls, placed: PlacedItem, start: Pose, end: Pose, side: tuple[int, int], size: Floats
    ) -> _Flight:
        """Up, over the box unless it comes in where it stands, and straight in from its side."""
        axis, sign = side
        half = placed.item.extents / 2
        turn = end.position.copy()
        turn[axis] = (size[axis] if sign > 0 else 0.0) + sign * (half[axis] + GAP + _BEND)
        over = max(size[2] + half[2] + GAP, turn[2], start.position[2] + _RISE)
        if axis == 0 and sign > 0:
            over = max(turn[2], start.position[2] + _RISE)
        ways = [np.array((*way[:2], over)) for way in (start.position, turn)]
        points, corner = _rounded([start.position, *ways, turn, end.position])
        way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
        even = np.linspace(0, way[-1], _POINTS)
        path = np.stack([np.interp(even, way, channel) for channel in points.T], axis=1)
        reach = path + np.array((0.0, 0.0, half[2]))
        return cls(start, end, path, float(way[corner] / way[-1]), reach)

    def at(self, share: float) -> Pose:
        """Where the item is when it has gone that share of its way; turned before it comes in."""
        if share <= 0:
            return self.start
        if share >= 1:
            return self.end
        places = np.linspace(0, 1, len(self.path))
        center = np.array([np.interp(share, places, channel) for channel in self.path.T])
        return replace(
            self.start.interpolate(self.end, _eased(share / self.entry)), position=center
        )


def _rounded(ways: Sequence[Floats]) -> tuple[Floats, int]:
    """A line (n, 3) through points, whose corners are rounded; and where the last corner ends."""
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
    """0 to 1 as share goes from 0 to 1, at rest at both ends."""
    u = min(1.0, max(0.0, share))
    return u**3 * (10 - 15 * u + 6 * u**2)
