"""How deep settled items are in each other and in the walls, by FCL on their meshes."""

from __future__ import annotations

import math
from itertools import combinations, product

import numpy as np

from packit_sim.collision import LooseMesh
from packit_sim.physics.settling import Settled, SettledItem
from packit_sim.physics.solids import Solid

DEPTHS = tuple(1e-4 * 2**n for n in range(12))
"""The depths, in box units, that are told apart."""

_DIRECTIONS = [
    np.array(steps) / math.hypot(*steps) for steps in product((-1, 0, 1), repeat=3) if any(steps)
]


def penetrations(settled: Settled) -> dict[tuple[int, int], float]:
    """How deep settled items are in each other, for each pair (i, j), i < j, whose meshes cross.

    The depth is the least of `DEPTHS` that frees them, when one is shifted by it in one of the 26
    directions of a cube's faces, edges and corners: the true depth, which is the least shift in any
    direction, is at most that. It is inf where none does, and where one is wholly inside another.
    """
    items = settled.items
    meshes = [LooseMesh(item.vertices, item.placed.item.mesh.faces) for item in items]
    bounds = [(item.vertices.min(axis=0), item.vertices.max(axis=0)) for item in items]
    found = {}
    for i, j in combinations(range(len(items)), 2):
        (low, high), (other_low, other_high) = bounds[i], bounds[j]
        if (low > other_high).any() or (other_low > high).any():
            continue
        if meshes[i].crosses(meshes[j]):
            found[i, j] = _depth(meshes[i], meshes[j])
        elif _is_in(items[i], items[j]) or _is_in(items[j], items[i]):
            found[i, j] = math.inf
    return found


def wall_penetrations(settled: Settled) -> list[float]:
    """How far each item reaches into the floor or through a wall, in box units."""
    found = []
    for item in settled.items:
        low, high = item.vertices.min(axis=0), item.vertices.max(axis=0)
        found.append(max(0.0, float((-low).max()), float((high - settled.size)[:2].max())))
    return found


def _depth(one: LooseMesh, other: LooseMesh) -> float:
    for depth in DEPTHS:
        if not all(one.crosses(other, depth * direction) for direction in _DIRECTIONS):
            return depth
    return math.inf


def _is_in(one: SettledItem, other: SettledItem) -> bool:
    """Whether a corner of one is in what another's surface encloses, where their surfaces part."""
    inward = np.linalg.inv(other.move @ other.placed.pose)
    corners = one.vertices @ inward[:3, :3].T + inward[:3, 3]
    half = other.placed.item.shape.extents / 2
    if (np.abs(corners) > half).any():
        return False
    return bool(Solid(other.placed.item.shape).encloses(corners).any())
