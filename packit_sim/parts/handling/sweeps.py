"""Sweeps: the distances that parts of a packing can move straight before they meet others.

Sweeps compare meshes triangle by triangle over the whole motion, without time steps (see
`engine.sweeping`). For each pair both meshes are drawn in as the validity check of packings does
it, so that parts which a valid packing lets touch do not block each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
import trimesh

from packit_sim.core.caches import bounded_cache
from packit_sim.core.choices import Door
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.deviation import Surface
from packit_sim.parts.packings import checked_items
from packit_sim.parts.packings.packing import Packing
from packit_sim.placement import AxisNumber, cyclic, least_rise, reordered

Direction = Literal["up", "+x", "-x", "+y", "-y", "down"]

SIDEWAYS: tuple[Direction, ...] = ("+x", "-x", "+y", "-y")

OUT: dict[Door, Direction] = {"x-": "-x", "x+": "+x", "y-": "-y", "y+": "+y", "z+": "up"}
"""The direction in which parts leave through each door."""

INTO: dict[Door, Direction] = {"x-": "+x", "x+": "-x", "y-": "+y", "y+": "-y", "z+": "down"}
"""The direction in which they come in."""

AXES: dict[Direction, tuple[AxisNumber, int]] = {
    "up": (2, 1),
    "+x": (0, 1),
    "-x": (0, -1),
    "+y": (1, 1),
    "-y": (1, -1),
    "down": (2, -1),
}
"""The axis of each direction, and its sign."""

_ANY = 1e9
"""Longer than any motion: the first obstacle that is found is enough."""

_HERE = np.zeros(3)


def check_door(door: str) -> None:
    """Raise ArgumentError if there is no such door."""
    if door not in OUT:
        raise ArgumentError(f"door {door!r} is not possible: choose from {', '.join(OUT)}")


class PartSweeps:
    """The parts of a packing, and the distances that each can move (see `sweeps_of`).

    Lengths are relative to the container's longest side that is not infinite. Answers about two
    parts do not depend on any third one; they are cached.

    Attributes
    ----------
    unit : float
        The container's longest side that is not infinite.
    size : ndarray of float64, shape (3,)
        The container's sides; that along z is inf for a strip.
    low, high : ndarray of float64, shape (n, 3)
        The corners of the parts' bounding boxes.
    held : dict
        The parts that hold a part, by its number, a number of moves, and the directions out of the
        box: while all of them are there, it can't be taken out (see `removal`).
    ways_out : dict
        The known ways out of each part, each with the parts that stay (see `ways_out`).
    """

    def __init__(self, packing: Packing) -> None:
        self.packing = packing
        self.unit = packing.container.longest
        self.size = np.array(packing.container.size) / self.unit
        placed = packing.placements
        corners = [packing.vertices(placement) / self.unit for placement in placed]
        self.low = np.array([one.min(axis=0) for one in corners]).reshape(-1, 3)
        self.high = np.array([one.max(axis=0) for one in corners]).reshape(-1, 3)
        self._boxes = np.array([placement.box for placement in placed], dtype=int)
        types = packing.types
        longest = [p.scale * float(types[p.type].extents.max()) / self.unit for p in placed]
        self._tolerances = [checked_items.tolerance(1.0, side) for side in longest]
        self._centres = [self._centre(n) for n in range(len(placed))]
        self._surfaces: dict[tuple[int, bytes, float, float, AxisNumber], Surface] = {}
        self._distances: dict[tuple[int, int, AxisNumber, bytes], float] = {}
        self._meetings: dict[tuple[int, int, AxisNumber, bytes], bool] = {}
        self.held: dict[tuple[int, int, tuple[Direction, ...]], frozenset[int]] = {}
        self.ways_out: dict[int, list[tuple[frozenset[int], Any]]] = {}

    def __len__(self) -> int:
        return len(self.packing.placements)

    def together(self, number: int) -> list[int]:
        """Return the numbers of all parts in the same box, in order; the part itself included."""
        return np.flatnonzero(self._boxes == self._boxes[number]).tolist()

    def drawn_in(self, one: int, other: int) -> float:
        """Return by how much the meshes of two parts are drawn in together (see `validity`)."""
        return min(self._tolerances[one], self._tolerances[other])

    def distance(
        self,
        mover: int,
        other: int,
        direction: Direction,
        shift: Floats = _HERE,
        enough: float = 0.0,
    ) -> float:
        """Compute how far a part can move before it meets another.

        Parameters
        ----------
        mover : int
            The number of the part that moves.
        other : int
            The number of the other part.
        direction : Direction
            Where it moves.
        shift : ndarray of float64, shape (3,)
            Where the motion begins, from the part's pose.
        enough : float
            If they meet before this, any distance below it may be returned, sooner.

        Returns
        -------
        float
            The distance, inf if they never meet.
        """
        lower, upper, axis, apart = self._pair(mover, other, direction, shift)
        key = lower, upper, axis, apart.tobytes()
        if key not in self._distances:
            found = self._rise(lower, upper, axis, apart, enough)
            if found <= enough:
                return found
            self._distances[key] = found
        return self._distances[key]

    def meets(self, mover: int, other: int, direction: Direction, shift: Floats = _HERE) -> bool:
        """Decide whether a part meets another if it moves on and on; arguments as `distance`."""
        lower, upper, axis, apart = self._pair(mover, other, direction, shift)
        key = lower, upper, axis, apart.tobytes()
        if key in self._distances:
            return self._distances[key] < math.inf
        if key not in self._meetings:
            self._meetings[key] = self._rise(lower, upper, axis, apart, _ANY) < math.inf
        return self._meetings[key]

    def in_the_way(
        self, mover: int, others: Iterable[int], direction: Direction, shift: Floats = _HERE
    ) -> list[tuple[int, float]]:
        """Return those of other parts whose bounding boxes are in the way of a part's.

        Parameters
        ----------
        mover : int
            The number of the part that moves.
        others : iterable of int
            The numbers of other parts.
        direction : Direction
            Where it moves.
        shift : ndarray of float64, shape (3,)
            Where the motion begins, from the part's pose.

        Returns
        -------
        list of (int, float)
            Their numbers and the distances to their boxes, the nearest first.
        """
        axis, sign = AXES[direction]
        numbers = np.array([n for n in others if n != mover], dtype=int)
        if len(numbers) == 0:
            return []
        low, high = self.low[mover] + shift, self.high[mover] + shift
        across = [d for d in range(3) if d != axis]
        overlap = (low[across] < self.high[numbers][:, across]) & (
            high[across] > self.low[numbers][:, across]
        )
        if sign > 0:
            ahead = self.high[numbers, axis] > low[axis]
            gaps = self.low[numbers, axis] - high[axis]
        else:
            ahead = self.low[numbers, axis] < high[axis]
            gaps = low[axis] - self.high[numbers, axis]
        kept = overlap.all(axis=1) & ahead
        order = np.argsort(gaps[kept], kind="stable")
        return list(zip(numbers[kept][order].tolist(), gaps[kept][order].tolist(), strict=True))

    def _pair(
        self, mover: int, other: int, direction: Direction, shift: Floats
    ) -> tuple[int, int, AxisNumber, Floats]:
        """Return the lower and the upper part along an axis, and the vector between them."""
        axis, sign = AXES[direction]
        apart = self._centres[other] - self._centres[mover] - shift
        return (mover, other, axis, apart) if sign > 0 else (other, mover, axis, -apart)

    def _rise(
        self, lower: int, upper: int, axis: AxisNumber, apart: Floats, enough: float
    ) -> float:
        drawn_in = self.drawn_in(lower, upper)
        mine, its = (self._surface(n, drawn_in, axis) for n in (lower, upper))
        return float(least_rise(mine, its, apart[cyclic(axis)], enough))

    def _centre(self, number: int) -> Floats:
        """Return where the centre of the bounding box of a part's mesh is."""
        placement = self.packing.placements[number]
        item_type = self.packing.types[placement.type]
        return np.asarray(placement.apply(item_type.middle) / self.unit)

    def triangles(self, number: int) -> Floats:
        """Return the triangles (n, 3, 3) of a part where it is."""
        return self._surface(number, 0.0, 2).triangles + self._centres[number]

    def _surface(self, number: int, drawn_in: float, axis: AxisNumber) -> Surface:
        """Look up a part's mesh from its centre, this axis last; equal poses share it."""
        placement = self.packing.placements[number]
        turn = placement.pose.rotation.tobytes()
        key = placement.type, turn, placement.scale, drawn_in, axis
        if key not in self._surfaces:
            if axis != 2:
                self._surfaces[key] = reordered(self._surface(number, drawn_in, 2), axis)
            else:
                item_type = self.packing.types[placement.type]
                extents = item_type.extents * placement.scale / self.unit
                shrink = np.maximum(extents - drawn_in, 0) / extents
                own = (item_type.vertices - (item_type.low + item_type.high) / 2) * shrink
                vertices = placement.pose.direction(own * placement.scale) / self.unit
                mesh = trimesh.Trimesh(vertices, item_type.faces, process=False)
                self._surfaces[key] = Surface.of(mesh)
        return self._surfaces[key]


@bounded_cache("sweeps of packings", 4, "packings", lambda _: 1, lambda packing: packing)
def sweeps_of(packing: Packing) -> PartSweeps:
    """Return the sweeps of a packing, which all questions about the same packing share."""
    return PartSweeps(packing)
