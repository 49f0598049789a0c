"""The arrays of a nesting problem: what its kernels read, and the state that they change."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from packit_sim.engine.containment import PartArrays
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.deviation import tree_of
from packit_sim.geometry.parts import Parts
from packit_sim.nesting import validity
from packit_sim.nesting.item_types import ItemType
from packit_sim.nesting.rotation_sets import FREE, matrices
from packit_sim.nesting.surface_kernels import STACK
from packit_sim.nesting.voxel_sets import enclosed, voxelized

VOXELS = 16
"""Voxels of the fields along the longest side of an item of median size."""

FIELD_VALUES = 200_000_000
"""Most nodes of all fields together, of two bytes; when they are full, all are dropped."""

MAX_FIELDS = 200_000
"""Most fields at a time."""

SETTLED_FIELDS = 3000
"""Most fields of a problem for which the surfaces compute nodes; else only offsets."""

SOLID_VOXELS = 200
"""Voxels along the longest side of an item for what it encloses without being closed."""

DRAWN_IN = 0.9
"""Share of the tolerance by which surfaces are drawn in: less than a check allows."""


class Surfaces(NamedTuple):
    """The surfaces of all types, drawn in, one after the other; see `deviation.Surface`."""

    triangles: Any
    triangle_starts: Any
    boxes: Any
    box_starts: Any
    leaves: Any
    leaf_starts: Any


class Closed(NamedTuple):
    """The closed parts of all types, one after the other; see `containment.PartArrays`."""

    triangles: Any
    part: Any
    triangle_starts: Any
    boxes: Any
    box_starts: Any
    leaves: Any
    leaf_starts: Any


class Solids(NamedTuple):
    """What surfaces enclose.

    points: (p, 3) a vertex of each connected part, by type from `point_starts`. enclosed: uint8,
    voxels that surfaces which are not closed enclose, from `starts`, in (t, 3) `dims` around the
    centre, with sides of `voxels` (t,).
    """

    points: Any
    point_starts: Any
    enclosed: Any
    starts: Any
    dims: Any
    voxels: Any


class Lookup(NamedTuple):
    """What a cost depends on while fields decide; small, since each call of a kernel copies it.

    t types, m rotations, r relative rotations. The origin of a type is the centre of its bounding
    box in the mesh's own frame, for all rotations.

    voxel: side of a field's voxels. clearance, slack: lengths. identity: the number of no relative
    rotation. turns: (m, 3, 3). relative: (m, m) numbers of relative rotations, from the first's
    frame to the other's. boxes: (t, m, 6) lowest and highest corners. sizes: (t,) factors of costs.
    numbers: (t, t, r) of fields, -1 for none. fields: (f, 4) start and dimensions in values. used:
    (3,) fields, values, times that they were full. voxels: uint8, at voxel_fields (t, r, 4), start
    and dimensions.
    """

    voxel: float
    clearance: float
    slack: float
    identity: int
    turns: Any
    relative: Any
    boxes: Any
    sizes: Any
    numbers: Any
    fields: Any
    values: Any
    used: Any
    voxels: Any
    voxel_fields: Any


class Problem(NamedTuple):
    """The items of a nesting problem, for kernels.

    least_step: a length. near: distance in voxels up to which surfaces decide. refined: whether
    nodes are computed by the surfaces. relative_turns: (r, 3, 3). allowed: (t, m), the first
    allowed_counts (t,) are the rotations that a type may take. reach: (t,) lengths of near samples.
    counts: (4,) costs, surface tests, passes, nodes. The rest is room to work in.
    """

    lookup: Lookup
    least_step: float
    near: float
    refined: bool
    relative_turns: Any
    allowed: Any
    allowed_counts: Any
    reach: Any
    surfaces: Surfaces
    closed: Closed
    solids: Solids
    counts: Any
    shift: Any
    waiting: Any
    triangle: Any


class State(NamedTuple):
    """Where all items are.

    types: (n,). inside: (n,) uint8, whether an item is in a box. turned: (n,) numbers of rotations.
    places: (n, 3) origins. bounds: (n, 6) lowest and highest corners, drawn in by half the
    tolerance, and grown by the clearance. weights, overlaps: (n, n) of pairs. depths: (n,) room for
    the depths of one item and each other one.
    """

    types: Any
    inside: Any
    turned: Any
    places: Any
    bounds: Any
    weights: Any
    overlaps: Any
    depths: Any


def build(types: Sequence[ItemType], unit: float, clearance: float) -> Problem:
    """Compute the arrays of a problem.

    Parameters
    ----------
    types : sequence of ItemType
        The types of items.
    unit : float
        The longest fixed side of the container.
    clearance : float
        The distance to keep.

    Returns
    -------
    Problem
        The problem; its fields are still empty.
    """
    tolerance = min(validity.tolerance(unit, float(each.extents.max())) for each in types)
    turns, own_turns = _turns(types)
    relative, relative_turns = _relative(turns)
    centred = [each.vertices - (each.low + each.high) / 2 for each in types]
    turned = [vertices @ turns.transpose(0, 2, 1) for vertices in centred]
    boxes = np.array([np.hstack((v.min(axis=1), v.max(axis=1))) for v in turned])
    allowed = np.zeros((len(types), len(turns)), np.int64)
    counts = np.zeros(len(types), np.int64)
    for n, own in enumerate(own_turns):
        kept = _distinct(centred[n], turns, own, tolerance)
        allowed[n, : len(kept)] = kept
        counts[n] = len(kept)
    longest = np.array([each.extents.max() for each in types])
    fields = len(types) * (len(types) + 1) // 2 * len(relative_turns)
    voxel = _voxel(types, len(relative_turns))
    voxels = [
        [voxelized(vertices[each.faces] @ turn.T, voxel) for turn in relative_turns]
        for vertices, each in zip(centred, types, strict=True)
    ]
    flat = [each.ravel() for row in voxels for each in row]
    shapes = [each.shape for row in voxels for each in row]
    voxel_fields = np.column_stack((_starts(flat)[:-1], shapes))
    refined = fields <= SETTLED_FIELDS
    lookup = Lookup(
        voxel=voxel,
        clearance=clearance,
        slack=0.5 * DRAWN_IN * tolerance,
        identity=int(relative[0, 0]),
        turns=turns,
        relative=relative,
        boxes=boxes,
        sizes=np.sqrt(longest / longest.mean()),
        numbers=np.full((len(types), len(types), len(relative_turns)), -1, np.int64),
        fields=np.zeros((min(fields, MAX_FIELDS) + 1, 4), np.int64),
        values=np.zeros(FIELD_VALUES, np.int16),
        used=np.zeros(3, np.int64),
        voxels=np.concatenate(flat),
        voxel_fields=voxel_fields.reshape(len(types), -1, 4).astype(np.int64),
    )
    return Problem(
        lookup,
        least_step=0.3 * tolerance,
        near=0.1 if refined else 1.0,
        refined=refined,
        relative_turns=relative_turns,
        allowed=allowed,
        allowed_counts=counts,
        reach=longest * 0.5,
        surfaces=_surfaces(types, centred, DRAWN_IN * tolerance),
        closed=_closed(types, centred),
        solids=_solids(types, centred),
        counts=np.zeros(4, np.int64),
        shift=np.zeros(3),
        waiting=np.zeros((STACK, 2), np.int64),
        triangle=np.zeros((3, 3)),
    )


def candidates(item_type: ItemType) -> Floats:
    """Return the rotations (m, 3, 3) that are searched for a type: for `free`, the 24 of `cube`."""
    return matrices("cube" if item_type.rotations == FREE else item_type.rotations)


def boxes_of(sizes: Sequence[Sequence[float]]) -> Floats:
    """Arrange boxes beside each other, so far apart that items in different ones don't meet.

    Parameters
    ----------
    sizes : sequence of three floats
        The sides of each box.

    Returns
    -------
    ndarray of float64, shape (b, 4)
        The x at which each box starts, and its sides.
    """
    found = np.array(sizes, dtype=float).reshape(-1, 3)
    starts = np.arange(len(found)) * 3 * found[:, 0].max()
    return np.column_stack((starts, found))


def state_of(types: Sequence[int]) -> State:
    """Return a state of items of some types, all at the origin."""
    n = len(types)
    return State(
        np.array(types, np.int64),
        np.zeros(n, np.uint8),
        np.zeros(n, np.int64),
        np.zeros((n, 3)),
        np.zeros((n, 6)),
        np.ones((n, n)),
        np.zeros((n, n)),
        np.zeros(n),
    )


def _turns(types: Sequence[ItemType]) -> tuple[Floats, list[list[int]]]:
    """Return all rotations (m, 3, 3), the identity first, and the numbers of each type's."""
    found: list[Floats] = []
    own = [[_number(found, turn) for turn in candidates(each)] for each in types]
    return np.array(found), own


def _relative(turns: Floats) -> tuple[Ints, Floats]:
    """Return the numbers (m, m) of all relative rotations, and these (r, 3, 3)."""
    found: list[Floats] = []
    numbers = [[_number(found, one.T @ other) for other in turns] for one in turns]
    return np.array(numbers, np.int64), np.array(found)


def _number(found: list[Floats], turn: Floats) -> int:
    """Return the number of a rotation in a list, to which it is added if it is new."""
    for n, each in enumerate(found):
        if np.abs(each - turn).max() < 1e-9:
            return n
    found.append(turn)
    return len(found) - 1


def _distinct(vertices: Floats, turns: Floats, own: list[int], tolerance: float) -> list[int]:
    """Return the rotations that differ by more than a symmetry of the vertices."""
    tree = cKDTree(vertices)
    kept: list[int] = []
    for n in own:
        same = (tree.query(vertices @ (turns[k].T @ turns[n]).T)[0].max() for k in kept)
        if not any(distance < 0.01 * tolerance for distance in same):
            kept.append(n)
    return kept


def _voxel(types: Sequence[ItemType], relative: int) -> float:
    """Return the side of the voxels: small, but so that about a half of all fields has room."""
    longest = np.array([each.extents.max() for each in types])
    voxel = float(np.median(longest)) / VOXELS
    extents = np.array([each.extents for each in types])
    while True:
        cells = extents / voxel
        nodes = (cells[:, None] + cells[None] + 7).prod(axis=2).sum() / 2 * relative
        if nodes <= 2 * FIELD_VALUES or voxel > longest.min() / 4:
            return voxel
        voxel *= 1.1


def _surfaces(types: Sequence[ItemType], centred: list[Floats], less: float) -> Surfaces:
    trees = []
    for each, vertices in zip(types, centred, strict=True):
        drawn_in = vertices * (np.maximum(each.extents - less, 0) / each.extents)
        triangles = drawn_in[each.faces]
        order, boxes, leaves = tree_of(triangles)
        trees.append((np.ascontiguousarray(triangles[order]), boxes, leaves))
    return Surfaces(*_joined(*zip(*trees, strict=True)))


def _closed(types: Sequence[ItemType], centred: list[Floats]) -> Closed:
    found = [
        PartArrays.of(vertices, Parts.of(vertices, each.faces))
        for each, vertices in zip(types, centred, strict=True)
    ]
    triangles, starts, boxes, box_starts, leaves, leaf_starts = _joined(
        [each.triangles for each in found],
        [each.boxes for each in found],
        [each.starts for each in found],
    )
    part = np.concatenate([each.part for each in found])
    return Closed(triangles, part, starts, boxes, box_starts, leaves, leaf_starts)


def _solids(types: Sequence[ItemType], centred: list[Floats]) -> Solids:
    points, inner = [], []
    dims = np.zeros((len(types), 3), np.int64)
    voxels = np.ones(len(types))
    for n, (each, vertices) in enumerate(zip(types, centred, strict=True)):
        parts = Parts.of(vertices, each.faces)
        points.append(vertices[parts.vertices])
        found = np.empty(0, np.uint8)
        if len(parts.closed) < len(each.faces):
            voxels[n] = each.extents.max() / SOLID_VOXELS
            cells = enclosed(vertices[each.faces], voxels[n])
            dims[n] = cells.shape
            found = cells.ravel()
        inner.append(found)
    return Solids(
        np.concatenate(points), _starts(points), np.concatenate(inner), _starts(inner), dims, voxels
    )


def _joined(*columns: Any) -> Iterator[Any]:
    """Yield arrays joined, each followed by where its parts start."""
    for parts in columns:
        yield np.concatenate(parts)
        yield _starts(parts)


def _starts(parts: Sequence[Any]) -> Ints:
    return np.concatenate(([0], np.cumsum([len(part) for part in parts]))).astype(np.int64)
