"""How deep settled items are in each other and in the walls, by FCL on their meshes."""

from __future__ import annotations

import math
from itertools import combinations, product

import numpy as np

from packit_sim.core.caches import cached_property
from packit_sim.engine.collision import LooseMesh
from packit_sim.physics.convex.pieces import Floats
from packit_sim.physics.convex.solids import Solid
from packit_sim.physics.settling import Settled, SettledItem
from packit_sim.placement import PosedItem

DEPTHS = tuple(1e-4 * 2 ** (n / 2) for n in range(23))
"""The depths, in box units, that are told apart."""

_DIRECTIONS = [
    np.array(steps) / math.hypot(*steps) for steps in product((-1, 0, 1), repeat=3) if any(steps)
]


def penetrations(settled: Settled) -> dict[tuple[int, int], float]:
    """How deep settled items are in each other, for each pair (i, j), i < j, whose meshes cross.

    The depth is the least of `DEPTHS` that frees them, when one is shifted by it in one of the 26
    directions of a cube's faces, edges and corners, or when it goes back by no more than that on
    the straight way to where it was packed beside the other: the true depth, which is the least
    motion that frees them, is at most that. The way back tells of what stands in another's hollow,
    which no shift frees. Packed items are free of each other, within 1e-4. The depth is inf where
    one is wholly inside another, or farther than all `DEPTHS`.
    """
    bodies = [_Body(item) for item in settled.items]
    found = {}
    for (i, one), (j, other) in combinations(enumerate(bodies), 2):
        if (one.low > other.high).any() or (other.low > one.high).any():
            continue
        if one.mesh.crosses(other.mesh):
            found[i, j] = _depth(one, other)
        elif _is_in(one, other) or _is_in(other, one):
            found[i, j] = math.inf
    return found


def wall_penetrations(settled: Settled) -> list[float]:
    """How far each item reaches into the floor or through a wall, in box units."""
    bodies = [_Body(item) for item in settled.items]
    return [
        max(0.0, float((-body.low).max()), float((body.high - settled.size)[:2].max()))
        for body in bodies
    ]


class _Body:
    """A settled item where it ended. vertices: (n, 3) of its mesh, from low to high, (3,) each."""

    def __init__(self, item: SettledItem) -> None:
        self.item = item
        self.vertices = item.vertices
        self.low, self.high = self.vertices.min(axis=0), self.vertices.max(axis=0)

    @cached_property
    def mesh(self) -> LooseMesh:
        return self.at(self.vertices)

    def at(self, vertices: Floats) -> LooseMesh:
        """Its mesh, with the vertices elsewhere."""
        return LooseMesh(vertices, self.item.item.mesh.faces)


def _depth(one: _Body, other: _Body) -> float:
    way = _WayBack(one.item, other.item)
    for depth in DEPTHS:
        if not all(one.mesh.crosses(other.mesh, depth * towards) for towards in _DIRECTIONS):
            return depth
        back = way.after(depth)
        if back is None or not one.at(back).crosses(other.mesh):
            return depth
    return math.inf


class _WayBack:
    """The straight way of a settled item to where it was packed beside another."""

    def __init__(self, one: SettledItem, other: SettledItem) -> None:
        self._item, self._here = one.item, one.pose
        self._start = PosedItem(one.item, other.move @ one.start.matrix).pose
        cosine = min(abs(float(np.dot(self._here.wxyz, self._start.wxyz))), 1.0)
        radius = float(np.linalg.norm(self._item.extents)) / 2
        shift = float(np.linalg.norm(self._start.position - self._here.position))
        self._length = shift + 2 * math.acos(cosine) * radius

    def after(self, length: float) -> Floats | None:
        """(n, 3) of its mesh, so far on that no point has moved by more; None where it is over."""
        if self._length <= length:
            return None
        between = self._here.interpolate(self._start, length / self._length)
        return between.apply(self._item.turned(0).mesh.vertices)


def _is_in(one: _Body, other: _Body) -> bool:
    """Whether a corner of one is in what another's surface encloses, where their surfaces part.

    Voxels tell that, and may close the way into a hollow in which one was packed: that is allowed.
    """
    shape, packed = other.item.item.shape, other.item.start.matrix
    half = shape.extents / 2
    corners = _seen_from(other.item.move @ packed, one.vertices)
    if (np.abs(corners) > half).any():
        return False
    before = _seen_from(packed, one.item.start.vertices)
    before = before[(np.abs(before) <= half).all(axis=1)]
    solid = Solid(shape)
    return bool(solid.encloses(corners).any() and not solid.encloses(before).any())


def _seen_from(pose: Floats, points: Floats) -> Floats:
    """Points (n, 3) in the frame that a pose (4, 4) takes to theirs."""
    inward = np.linalg.inv(pose)
    return points @ inward[:3, :3].T + inward[:3, 3]
