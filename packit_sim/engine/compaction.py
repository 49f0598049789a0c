"""Packed items pushed together: down until they meet something, then left, then back.

Items of a pack stand on nodes of the grid, so that each may hang by up to a step of it above what
it stands on. Here they leave the grid: every move is straight, and goes exactly to where the meshes
meet (see `sweeping`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.engine.items import Contents, PlacedItem
from packit_sim.engine.sweeping import Axis, room
from packit_sim.geometry.lattice import CELL, CONTACT_TOLERANCE

Floats = npt.NDArray[np.float64]

GAP = CONTACT_TOLERANCE / 10
"""Box units that are left between collision meshes, which are drawn in: they stay clear of what
rounding makes of surfaces that touch, and meshes interpenetrate by less than the tolerance."""

LEAST = 1e-4
"""Box units: a round in which nothing moves farther is the last."""

ROUNDS = 50

DOWN: Axis = 2

_ORDER: tuple[Axis, ...] = (2, 0, 1)
"""Down, left, back: as locations of the bottom-left-back fill are ranked."""


@dataclass(frozen=True, eq=False)
class Compacted:
    """Items pushed together.

    placed: where they were. shifts: (n, 3) how far each has moved, in box units. rounds: in which
    all were pushed down, left and back, and settled: whether in the last hardly anything moved.
    """

    placed: tuple[PlacedItem, ...]
    shifts: Floats
    rounds: int
    settled: bool

    @property
    def centers(self) -> Floats:
        """(n, 3) of the items' bounding boxes."""
        return _centers(self.placed) + self.shifts

    @property
    def filled(self) -> tuple[float, float]:
        """How full the corner of the box is that holds all items, before and after: their volume
        over that of the smallest box around them at the origin. 0 where there are none.
        """
        return self._filled(_centers(self.placed)), self._filled(self.centers)

    @property
    def height(self) -> tuple[float, float]:
        """How high the highest item reaches, before and after, in box units."""
        before, after = (_reach(self.placed, c)[2] for c in (_centers(self.placed), self.centers))
        return float(before), float(after)

    def _filled(self, centers: Floats) -> float:
        volume = sum(placed.item.volume for placed in self.placed)
        return volume / float(_reach(self.placed, centers).prod()) if self.placed else 0.0


def compact(box: Contents[PlacedItem], rounds: int = ROUNDS) -> Compacted:
    """Pushes all items down, the lowest first, then left, then back, and again until all stay.

    rounds: after which it ends in any case.
    """
    placed = box.placed
    centers = _centers(placed)
    start, made, farthest = centers.copy(), 0, np.inf if placed else 0.0
    while farthest > LEAST and made < rounds:
        before = centers.copy()
        for axis in _ORDER:
            lows = centers[:, axis] - [p.item.extents[axis] / 2 for p in placed]
            for n in np.argsort(lows, kind="stable").tolist():
                centers[n, axis] -= _way(placed, centers, n, axis)
        farthest = float(np.abs(centers - before).max())
        made += 1
    return Compacted(tuple(placed), centers - start, made, farthest <= LEAST)


def drops(box: Contents[PlacedItem]) -> Floats:
    """(n,) how far each item hangs above what is below it, or the floor, all others as they are."""
    centers = _centers(box.placed)
    return np.array([_way(box.placed, centers, n, DOWN) for n in range(len(box.placed))])


def _way(placed: Sequence[PlacedItem], centers: Floats, n: int, axis: Axis) -> float:
    """How far an item can go back along an axis, from where items are to what it meets."""
    item = placed[n].item
    apart = centers - centers[n]
    sizes = np.array([p.item.extents for p in placed])
    gaps = -apart[:, axis] - (sizes[:, axis] + item.extents[axis]) / 2  # of bounding boxes
    way = max(float(centers[n, axis] - item.extents[axis] / 2), 0.0)
    for m in np.argsort(gaps, kind="stable").tolist():
        if gaps[m] >= way:
            break
        if m != n and _in_the_way(item.extents, sizes[m], apart[m], axis):
            met = room(item, placed[m].item, apart[m], axis, forward=False)
            way = min(way, max(met - GAP, 0.0))
    return way


def _in_the_way(own: Floats, its: Floats, apart: Floats, axis: Axis) -> bool:
    """Whether two bounding boxes overlap seen along an axis, and the other is not all beyond."""
    near = np.abs(apart) < (own + its) / 2
    near[axis] = apart[axis] - its[axis] / 2 < own[axis] / 2
    return bool(near.all())


def _centers(placed: Sequence[PlacedItem]) -> Floats:
    return np.array([p.center for p in placed]).reshape(-1, 3)


def _reach(placed: Sequence[PlacedItem], centers: Floats) -> Floats:
    """(3,) the farthest corner of items' bounding boxes from the origin."""
    ends = [center + p.item.extents / 2 for p, center in zip(placed, centers, strict=True)]
    farthest: Floats = np.max([np.full(3, CELL), *ends], axis=0)
    return farthest
