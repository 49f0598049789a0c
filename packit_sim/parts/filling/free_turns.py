"""Rotations to try for parts that may turn freely: flush with slanted walls, and diagonal ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from packit_sim.geometry.arrays import Floats
from packit_sim.parts.filling.convex_fits import REFINED, convex_space, corners_of
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.nesting.search_frames import search_frame, searched_rotations
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.mesh_containers import MeshContainer
from packit_sim.parts.packings.rotation_sets import FREE, matrices
from packit_sim.parts.reading.prepared import PreparedPart
from packit_sim.parts.reading.sizes import fits

WALL_SHARE = 0.03
"""Least share of a container's surface that is a wall to be flush with."""

MOST_WALLS = 4
"""Most slanted walls, the largest first."""

MOST_DIAGONALS = 6
"""Most diagonal rotations of a part in a container."""

MOST_TRIED = 60
"""Most rotations of those of small bounding boxes that are tried exactly."""

ANGLES = np.radians(np.arange(3.0, 90.0, 3.0))
"""Angles between quarter turns that are tried about each axis."""

RANDOM = 30
"""Random rotations to begin with, where no turn about one axis is enough."""

_SAME = 1e-6
"""Relative difference of bounding boxes of rotations that count as the same."""


def with_free_turns(task: PackTask) -> PackTask:
    """Return a task with rotations to try for parts that may turn freely.

    A part that fits into a box in its usual 24 rotations may also lie flush with slanted walls. One
    that does not gets diagonal rotations instead, if there are any.
    """
    parts = [_with_turns(task, p) if p.part.rotations == FREE else p for p in task.parts]
    return replace(task, parts=tuple(parts))


def flush_frames(container: Container) -> list[Floats]:
    """Return the least rotations (3, 3) by which an axis becomes normal to each slanted wall."""
    if not isinstance(container, MeshContainer):
        return []
    corners = container.mesh.vertices[container.mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    _, numbers = np.unique((normals / areas[:, None]).round(3) + 0.0, axis=0, return_inverse=True)
    shares = np.bincount(numbers.ravel(), areas) / areas.sum()
    found: list[Floats] = []
    for n in np.argsort(-shares, kind="stable"):
        normal = normals[numbers.ravel() == n].sum(axis=0)
        normal /= np.linalg.norm(normal)
        axis = int(np.abs(normal).argmax())
        unit = np.eye(3)[axis] * np.sign(normal[axis])
        if shares[n] < WALL_SHARE or len(found) == MOST_WALLS:
            break
        crossed = np.cross(unit, normal)
        if (sine := float(np.linalg.norm(crossed))) < 1e-2:
            continue
        angle = np.arctan2(sine, float(unit @ normal))
        turn = Rotation.from_rotvec(crossed / sine * angle).as_matrix()
        if not any(np.abs(turn - each).max() < 1e-2 for each in found):
            found.append(turn)
    return found


def _with_turns(task: PackTask, part: PreparedPart) -> PreparedPart:
    own = part.item_type
    usual = searched_rotations(own)
    margin = task.search_margin
    more = [wall @ usual for box in task.boxes for wall in flush_frames(box.container)]
    if any(fits(part, box, margin) for box in task.boxes):
        turns = np.concatenate((usual, *more))
    else:
        more += [_diagonal(part, box.container, task) for box in task.boxes]
        turns = np.concatenate(more)
    turns = turns[own.turning.allows(turns)]
    if len(turns) in (0, len(usual)) and not more:
        return part
    return part if len(turns) == 0 else replace(part, item_type=own.changed(turns=turns))


def _diagonal(part: PreparedPart, container: Container, task: PackTask) -> Floats:
    """Return rotations (n, 3, 3) in which a part fits into the convex hull of a container."""
    own, margin = part.item_type, task.search_margin
    corners = corners_of(own.vertices - own.middle)
    inner = np.array(container.size) - margin.lower - margin.upper
    space = convex_space(container, margin, is_hull=True)
    longest = max(np.linalg.norm(corners - each, axis=1).max() for each in corners)
    if space is None or longest > np.linalg.norm(inner):
        return np.empty((0, 3, 3))
    usual = matrices("cube") @ search_frame(own)
    about = [
        Rotation.from_rotvec(axis * angle).as_matrix() for axis in np.eye(3) for angle in ANGLES
    ]
    turns = (np.array(about)[:, None] @ usual).reshape(-1, 3, 3)
    turns = turns[own.turning.allows(turns)]
    sides = np.array([np.ptp(corners @ turn.T, axis=0) for turn in turns]).reshape(-1, 3)
    possible = np.flatnonzero((sides <= inner).all(axis=1))
    found: list[Floats] = []
    known: list[Floats] = []
    for n in possible[np.argsort(sides[possible].prod(axis=1), kind="stable")][:MOST_TRIED]:
        if any(np.abs(sides[n] - each).max() < _SAME * longest for each in known):
            continue
        known.append(sides[n])
        if space.largest(corners, turns[n]).scale >= 1:
            found.append(turns[n])
            if len(found) == MOST_DIAGONALS:
                break
    if not found:
        random = Rotation.random(RANDOM, np.random.default_rng(0)).as_matrix()
        starts = np.concatenate((usual, random))
        starts = starts[own.turning.allows(starts)]
        tried = sorted((space.largest(corners, turn) for turn in starts), key=lambda f: -f.scale)
        for each in tried[:REFINED]:
            best = space.refined(corners, each)
            if best.scale >= 1:
                halves = 2 * np.array([np.diag(axis) for axis in np.eye(3)]) - np.eye(3)
                others = halves @ best.rotation
                found = [turn for turn in others if space.largest(corners, turn).scale >= 1]
                found.append(best.rotation)
                break
    return np.array(found).reshape(-1, 3, 3)
