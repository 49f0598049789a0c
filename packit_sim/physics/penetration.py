"""How deep settled items are in each other and in the walls, by FCL on their meshes."""

from __future__ import annotations

import math
from itertools import combinations, product

import numpy as np
from trimesh import transformations

from packit_sim.collision import LooseMesh
from packit_sim.physics.pieces import Floats
from packit_sim.physics.settling import Settled, SettledItem
from packit_sim.physics.solids import Solid
from packit_sim.pictures.layouts import Pose

DEPTHS = tuple(1e-4 * 2**n for n in range(12))
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
    items = settled.items
    meshes = [_mesh(item, item.vertices) for item in items]
    bounds = [(item.vertices.min(axis=0), item.vertices.max(axis=0)) for item in items]
    found = {}
    for i, j in combinations(range(len(items)), 2):
        (low, high), (other_low, other_high) = bounds[i], bounds[j]
        if (low > other_high).any() or (other_low > high).any():
            continue
        if meshes[i].crosses(meshes[j]):
            found[i, j] = _depth(items[i], items[j])
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


def _depth(one: SettledItem, other: SettledItem) -> float:
    here, there = _mesh(one, one.vertices), _mesh(other, other.vertices)
    for depth in DEPTHS:
        if not all(here.crosses(there, depth * direction) for direction in _DIRECTIONS):
            return depth
        back, parted = _back(one, other, depth)
        if parted or not _mesh(one, back).crosses(there):
            return depth
    return math.inf


def _back(one: SettledItem, other: SettledItem, length: float) -> tuple[Floats, bool]:
    """(n, 3) of one's mesh, so far back to where it was packed beside the other that no point of
    it moves by more; and whether it is there.
    """
    item, pose = one.placed.item, one.pose
    start = Pose.lying(item, other.move @ one.placed.pose)
    cosine = min(abs(float(np.dot(pose.turn, start.turn))), 1.0)
    radius = float(np.linalg.norm(item.extents)) / 2
    way = float(np.linalg.norm(start.center - pose.center)) + 2 * math.acos(cosine) * radius
    if way <= length:
        return one.vertices, True
    share = length / way
    between = pose.between(start, share, (1 - share) * pose.center + share * start.center)
    turn = transformations.quaternion_matrix(between.turn)[:3, :3]
    return item.turned(0).mesh.vertices @ turn.T + between.center, False


def _mesh(item: SettledItem, vertices: Floats) -> LooseMesh:
    return LooseMesh(vertices, item.placed.item.mesh.faces)


def _is_in(one: SettledItem, other: SettledItem) -> bool:
    """Whether a corner of one is in what another's surface encloses, where their surfaces part."""
    inward = np.linalg.inv(other.move @ other.placed.pose)
    corners = one.vertices @ inward[:3, :3].T + inward[:3, 3]
    half = other.placed.item.shape.extents / 2
    if (np.abs(corners) > half).any():
        return False
    return bool(Solid(other.placed.item.shape).encloses(corners).any())
