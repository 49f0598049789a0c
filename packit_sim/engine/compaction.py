"""Compaction of packed items: each is pushed down, then left, then back, until it meets another.

The items of a pack are at grid nodes, so that there may be a gap of up to a grid step below each of
them. Compaction takes them off the grid: every move is straight and ends exactly where the meshes
meet (see `sweeping`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.core.sums import plain_sum
from packit_sim.engine.sweeping import AxisNumber, free_distance
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import Contents, PlacedItem
from packit_sim.geometry.lattice import CELL, CONTACT_TOLERANCE

GAP = CONTACT_TOLERANCE / 10
"""Gap in box units that moves leave between collision meshes, which are shrunk: more than rounding
of surfaces that touch, and so little that meshes interpenetrate by less than the tolerance."""

SMALLEST_MOVE = 1e-4
"""Distance in box units: a round in which no item moves farther is the last."""

ROUNDS = 50
"""Maximum number of rounds."""

DOWN: AxisNumber = 2

_ORDER: tuple[AxisNumber, ...] = (2, 0, 1)
"""Down, left, back: the order of bottom-left-back fill."""


@dataclass(frozen=True, eq=False)
class Compacted:
    """Items that were pushed together.

    Attributes
    ----------
    placed : tuple of PlacedItem
        The items where they were before.
    shifts : ndarray of float64, shape (n, 3)
        The shift of each item, in box units.
    rounds : int
        Number of rounds; in each, all items are pushed down, left and back.
    converged : bool
        Whether no item moved farther than `SMALLEST_MOVE` in the last round.
    """

    placed: tuple[PlacedItem, ...]
    shifts: Floats
    rounds: int
    converged: bool

    @property
    def centers(self) -> Floats:
        """Centres of the items' bounding boxes afterwards, (n, 3) in box units."""
        return _centers(self.placed) + self.shifts

    @property
    def filled(self) -> tuple[float, float]:
        """Density of the items in the corner at the origin, before and after.

        The items' volume relative to that of the smallest box around the origin and all items; 0
        without items.
        """
        return self._filled(_centers(self.placed)), self._filled(self.centers)

    @property
    def height(self) -> tuple[float, float]:
        """Height of the highest item's top, before and after, in box units."""
        before, after = (_reach(self.placed, c)[2] for c in (_centers(self.placed), self.centers))
        return float(before), float(after)

    def _filled(self, centers: Floats) -> float:
        volume = plain_sum(placed.item.volume for placed in self.placed)
        return volume / float(_reach(self.placed, centers).prod()) if self.placed else 0.0


def compact(box: Contents[PlacedItem], rounds: int = ROUNDS) -> Compacted:
    """Push all items down, the lowest first, then left, then back, until none moves any more.

    Parameters
    ----------
    box : Contents
        The box and the items in it.
    rounds : int, default: 50
        Maximum number of rounds.

    Returns
    -------
    Compacted
        The shifts of the items.
    """
    placed = box.placed
    centers = _centers(placed)
    start, done, farthest = centers.copy(), 0, np.inf if placed else 0.0
    while farthest > SMALLEST_MOVE and done < rounds:
        before = centers.copy()
        for axis in _ORDER:
            lows = centers[:, axis] - [p.item.extents[axis] / 2 for p in placed]
            for n in np.argsort(lows, kind="stable").tolist():
                centers[n, axis] -= _free_distance(placed, centers, n, axis)
        farthest = float(np.abs(centers - before).max())
        done += 1
    return Compacted(tuple(placed), centers - start, done, farthest <= SMALLEST_MOVE)


def drops(box: Contents[PlacedItem]) -> Floats:
    """Compute the distance (n,) from each item down to other items or the floor, in box units."""
    centers = _centers(box.placed)
    return np.array([_free_distance(box.placed, centers, n, DOWN) for n in range(len(box.placed))])


def _free_distance(
    placed: Sequence[PlacedItem], centers: Floats, n: int, axis: AxisNumber
) -> float:
    """Compute how far item n can move towards 0 along an axis before it meets a wall or an item."""
    item = placed[n].item
    apart = centers - centers[n]
    sizes = np.array([p.item.extents for p in placed])
    gaps = -apart[:, axis] - (sizes[:, axis] + item.extents[axis]) / 2  # of bounding boxes
    distance = max(float(centers[n, axis] - item.extents[axis] / 2), 0.0)
    for m in np.argsort(gaps, kind="stable").tolist():
        if gaps[m] >= distance:
            break
        if m != n and _may_block(item.extents, sizes[m], apart[m], axis):
            met = free_distance(item, placed[m].item, apart[m], axis, forward=False)
            distance = min(distance, max(met - GAP, 0.0))
    return distance


def _may_block(own: Floats, its: Floats, apart: Floats, axis: AxisNumber) -> bool:
    """Decide whether bounding boxes overlap along an axis, and the other is not all above."""
    near = np.abs(apart) < (own + its) / 2
    near[axis] = apart[axis] - its[axis] / 2 < own[axis] / 2
    return bool(near.all())


def _centers(placed: Sequence[PlacedItem]) -> Floats:
    return np.array([p.center for p in placed]).reshape(-1, 3)


def _reach(placed: Sequence[PlacedItem], centers: Floats) -> Floats:
    """Return the largest coordinates (3,) of the items' bounding boxes, at least one cell."""
    ends = [center + p.item.extents / 2 for p, center in zip(placed, centers, strict=True)]
    farthest: Floats = np.max([np.full(3, CELL), *ends], axis=0)
    return farthest
