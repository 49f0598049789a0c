"""Depths to which settled items penetrate each other and the walls, by FCL on their meshes."""

from __future__ import annotations

import math
from itertools import combinations, product

import numpy as np

from packit_sim.core.caches import cached_property
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import ItemInBox, PosedItem
from packit_sim.geometry.motions import split
from packit_sim.physics.convex.solids import Solid
from packit_sim.physics.settling import Settled, SettledItem
from packit_sim.placement import LooseMesh

DEPTHS = tuple(1e-4 * 2 ** (n / 2) for n in range(23))
"""The depths that are tried, in box units."""

DIRECTIONS = [
    np.array(steps) / math.hypot(*steps) for steps in product((-1, 0, 1), repeat=3) if any(steps)
]
"""The directions in which a shift is tried: of a cube's faces, edges and corners."""


def penetrations(settled: Settled) -> dict[tuple[int, int], float]:
    """Compute how deep settled items penetrate each other.

    Parameters
    ----------
    settled : Settled
        The items.

    Returns
    -------
    dict of (int, int) to float
        For each pair of numbers i < j whose meshes cross, an upper bound of the depth in box units.
        It is inf if one item is wholly inside the other, or none of `DEPTHS` separates them.

    Notes
    -----
    The depth is the smallest motion that separates two items. The bound is the first of `DEPTHS`
    that separates them in one of two ways: a shift of one item in one of the 26 directions of a
    cube's faces, edges and corners, or its return towards the place relative to the other item in
    which it was packed. The return separates items in hollows of others, which no shift does, since
    packed items penetrate each other by at most 1e-4.
    """
    meshes = [_SettledMesh(item) for item in settled.items]
    found = {}
    for (i, one), (j, other) in combinations(enumerate(meshes), 2):
        if (one.low > other.high).any() or (other.low > one.high).any():
            continue
        if one.mesh.crosses(other.mesh):
            found[i, j] = _depth(one, other)
        elif _is_in(one, other) or _is_in(other, one):
            found[i, j] = math.inf
    return found


def wall_penetrations(settled: Settled) -> list[float]:
    """Compute how far each item protrudes through the floor or a wall, in box units."""
    meshes = [_SettledMesh(item) for item in settled.items]
    return [
        max(0.0, float((-mesh.low).max()), float((mesh.high - settled.size)[:2].max()))
        for mesh in meshes
    ]


class _SettledMesh:
    """The mesh of a settled item where it ended: vertices (n, 3), and their bounds (3,)."""

    def __init__(self, item: SettledItem) -> None:
        self.item = item
        self.vertices = item.vertices
        self.low, self.high = self.vertices.min(axis=0), self.vertices.max(axis=0)

    @cached_property
    def mesh(self) -> LooseMesh:
        return self.moved(self.vertices)

    def moved(self, vertices: Floats) -> LooseMesh:
        """Return the mesh with other vertices."""
        return LooseMesh(vertices, self.item.item.mesh.faces)


def _depth(one: _SettledMesh, other: _SettledMesh) -> float:
    path = _ReturnPath(one.item, other.item)
    for depth in DEPTHS:
        if not all(one.mesh.crosses(other.mesh, depth * towards) for towards in DIRECTIONS):
            return depth
        back = path.vertices(depth)
        if back is None or not one.moved(back).crosses(other.mesh):
            return depth
    return math.inf


class _ReturnPath:
    """The straight path of a settled item back to where it was packed, relative to another item."""

    def __init__(self, one: SettledItem, other: SettledItem) -> None:
        self._item, self._here = one.item, one.pose
        self._start = PosedItem(one.item, one.start.matrix).moved(other.move).pose
        cosine = min(abs(float(np.dot(self._here.wxyz, self._start.wxyz))), 1.0)
        radius = float(np.linalg.norm(self._item.extents)) / 2
        shift = float(np.linalg.norm(self._start.translation - self._here.translation))
        self._length = shift + 2 * math.acos(cosine) * radius

    def vertices(self, length: float) -> Floats | None:
        """Return the mesh's vertices (n, 3) after a motion of this length, None past the end.

        No vertex has moved by more than the length.
        """
        if self._length <= length:
            return None
        between = self._here.interpolate(self._start, length / self._length)
        return between.apply(self._item.turned(0).mesh.vertices)


def _is_in(one: _SettledMesh, other: _SettledMesh) -> bool:
    """Decide whether a vertex of one item is enclosed by the other; their surfaces don't cross.

    Voxels decide it, and they may close the opening of a hollow: an item that was packed in the
    hollow is not counted.
    """
    shape = other.item.item.shape
    half = shape.extents / 2
    corners = _in_shape(other.item, one.vertices)
    if (np.abs(corners) > half).any():
        return False
    before = _in_shape(other.item.start, one.item.start.vertices)
    before = before[(np.abs(before) <= half).all(axis=1)]
    solid = Solid(shape)
    return bool(solid.encloses(corners).any() and not solid.encloses(before).any())


def _in_shape(placed: ItemInBox, points: Floats) -> Floats:
    """Map points (n, 3) from the box to the canonical frame of an item's shape."""
    linear, shift = split(np.asarray(np.linalg.inv(placed.matrix), dtype=np.float64))
    return points @ linear.T + shift
