"""The computation of a nesting problem's arrays from its types of items."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.parts import Parts
from packit_sim.geometry.triangle_trees import boxes_of, tree_order
from packit_sim.parts.nesting.distance_kernels import STEPS
from packit_sim.parts.nesting.problem import Closed, Distances, Lookup, Problem, Solids, Surfaces
from packit_sim.parts.nesting.surface_kernels import STACK
from packit_sim.parts.nesting.voxel_sets import (
    enclosed,
    signed_distances,
    spread_points,
    turned_voxels,
)
from packit_sim.parts.packings import validity
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.rotation_sets import matrices
from packit_sim.placement import PartArrays

VOXELS = 16, 8
"""Voxels of the fields along the longest side of an item of median size.

More where the surfaces compute their nodes than where fields only choose among samples.
"""

FIELD_VALUES = 200_000_000
"""Most nodes of all fields together, of two bytes; when they are full, all are dropped."""

MAX_FIELDS = 200_000
"""Most fields at a time."""

SETTLED_FIELDS = 3000
"""Most fields of a problem for which the surfaces compute nodes; else only offsets."""

SIMPLE = 200
"""Most triangles of an item, on average, for which the surfaces compute nodes."""

FEW = 50_000
"""Fields times triangles of an item, on average, up to which the surfaces compute nodes as well."""

SOLID_VOXELS = 200
"""Voxels along the longest side of an item for what it encloses without being closed."""

DISTANCE_CELLS = 40
"""Cells of the grids of signed distances along an item's longest side, with the clearance."""

MARGIN = 3.0
"""Cells around an item, besides the clearance, in which distances to it are known."""

POINTS = 128
"""Points of an item's surface whose depth in others counts."""

FARTHEST = 8
"""Vertices farthest from the centre, which distinguish most rotations."""

DRAWN_IN = 0.95, 0.6
"""Shares of the tolerance by which the surfaces of the first and other item of a pair are drawn in.

Less than a check allows; not equal, so that no faces of equal items at one place coincide: they
cross, or one item is inside the other.
"""

SLACK = min(DRAWN_IN) / 2
"""Share of the tolerance by which bounding boxes may overlap."""

HOLLOW = 0.6
"""Share of the convex hull below which the volume makes an item hollow.

Not if items are simple: then fewer samples are searched in the same time, and strips of the
literature's polytopes became higher.
"""

INWARD = 2e-4
"""Share of its distance by which a point that stands for a part is nearer to the item's origin."""


def build(types: Sequence[ItemType], unit: float, clearance: float) -> Problem:
    """Compute the arrays of a problem.

    Parameters
    ----------
    types : sequence of ItemType
        The types of items, in the frames of the search (see `search_frames`).
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
        kept = _distinct(centred[n], boxes[n], turns, own, 0.01 * tolerance)
        allowed[n, : len(kept)] = kept
        counts[n] = len(kept)
    longest = np.array([each.extents.max() for each in types])
    fields = len(types) * (len(types) + 1) // 2 * len(relative_turns)
    triangles = float(np.mean([len(each.faces) for each in types]))
    is_simple = triangles <= SIMPLE
    refined = fields <= SETTLED_FIELDS and (is_simple or fields * triangles <= FEW)
    voxel = _voxel(types, len(relative_turns), VOXELS[0 if refined else 1])
    voxels = [
        turned_voxels(vertices[each.faces], relative_turns, voxel)
        for vertices, each in zip(centred, types, strict=True)
    ]
    flat = [each.ravel() for row in voxels for each in row]
    shapes = [each.shape for row in voxels for each in row]
    voxel_fields = np.column_stack((_starts(flat)[:-1], shapes))
    lookup = Lookup(
        voxel=voxel,
        clearance=clearance,
        slack=SLACK * tolerance,
        identity=int(relative[0, 0]),
        turns=turns,
        relative=relative,
        boxes=boxes,
        sizes=np.sqrt(longest / longest.mean()),
        hollow=np.array([not is_simple and _is_hollow(each) for each in types]),
        numbers=np.full((len(types), len(types), len(relative_turns)), -1, np.int64),
        fields=np.zeros((min(fields, MAX_FIELDS) + 1, 4), np.int64),
        values=np.zeros(FIELD_VALUES, np.int16),
        used=np.zeros(3, np.int64),
        voxels=np.concatenate(flat),
        voxel_fields=voxel_fields.reshape(len(types), -1, 4).astype(np.int64),
    )
    parts = [Parts.of(vertices, each.faces) for each, vertices in zip(types, centred, strict=True)]
    return Problem(
        lookup,
        refined=refined,
        relative_turns=relative_turns,
        allowed=allowed,
        allowed_counts=counts,
        reach=longest * 0.5,
        surfaces=_surfaces(types, centred, tolerance),
        closed=_closed(centred, parts),
        solids=_solids(types, centred, parts),
        distances=_distances(types, centred, clearance),
        counts=np.zeros(4, np.int64),
        shift=np.zeros(3),
        waiting=np.zeros((STACK, 2), np.int64),
        triangle=np.zeros((3, 3)),
    )


def _is_hollow(item_type: ItemType) -> bool:
    """Return whether an item fills little of its convex hull, which may be flat (QJ)."""
    return item_type.volume < HOLLOW * ConvexHull(item_type.vertices, qhull_options="QJ").volume


def _turns(types: Sequence[ItemType]) -> tuple[Floats, list[list[int]]]:
    """Return all rotations (m, 3, 3), the identity first, and the numbers of each type's."""
    found: list[Floats] = []
    own = [[_number(found, turn) for turn in matrices(each.rotations)] for each in types]
    return np.array(found), own


def _relative(turns: Floats) -> tuple[Ints, Floats]:
    """Return the numbers (m, m) of all relative rotations, and these (r, 3, 3)."""
    found: list[Floats] = []
    numbers = [[_number(found, one.T @ other) for other in turns] for one in turns]
    return np.array(numbers, np.int64), np.array(found)


def _number(found: list[Floats], turn: Floats) -> int:
    """Return the number of a rotation in a list, to which it is added if it is new."""
    if found:
        same = np.flatnonzero(np.abs(np.array(found) - turn).max(axis=(1, 2)) < 1e-9)
        if len(same):
            return int(same[0])
    found.append(turn)
    return len(found) - 1


def _distinct(
    vertices: Floats, boxes: Floats, turns: Floats, own: list[int], least: float
) -> list[int]:
    """Return the rotations that differ by more than a symmetry of the vertices."""
    tree = cKDTree(vertices)
    far = vertices[np.argsort(-(vertices**2).sum(axis=1), kind="stable")[:FARTHEST]]
    alike = np.abs(boxes[:, None] - boxes).max(axis=2) < least
    kept: list[int] = []
    for n in own:
        for k in kept:
            if alike[n, k] and all(
                tree.query(points @ (turns[k].T @ turns[n]).T)[0].max() < least
                for points in (far, vertices)
            ):
                break
        else:
            kept.append(n)
    return kept


def _voxel(types: Sequence[ItemType], relative: int, count: int) -> float:
    """Return the side of the voxels: small, but so that there is space for all fields."""
    longest = np.array([each.extents.max() for each in types])
    voxel = float(np.median(longest)) / count
    extents = np.array([each.extents for each in types])
    while True:
        cells = extents / voxel
        nodes = (cells[:, None] + cells[None] + 7).prod(axis=2).sum() / 2 * relative
        if nodes <= FIELD_VALUES or voxel > longest.min() / 4:
            return voxel
        voxel *= 1.1


def _surfaces(types: Sequence[ItemType], centred: list[Floats], tolerance: float) -> Surfaces:
    trees = []
    for each, vertices in zip(types, centred, strict=True):
        smaller, larger = (
            vertices * (np.maximum(each.extents - share * tolerance, 0) / each.extents)
            for share in DRAWN_IN
        )
        faces = each.faces[tree_order(larger[each.faces])]
        tree = boxes_of(larger[faces])
        trees.append((smaller[faces], _owned(faces), larger[faces], *tree))
    first, owned, other, boxes, leaves = zip(*trees, strict=True)
    corners, starts, *rest = _joined(other, boxes, leaves)
    return Surfaces(np.concatenate(first), corners, starts, np.concatenate(owned), *rest)


def _owned(faces: Ints) -> Ints:
    """Return bits (n,) of the edges and corners that no earlier face (n, 3) has."""
    edges = np.sort(np.stack((faces, np.roll(faces, -1, axis=1)), axis=-1), axis=-1)
    owned = np.zeros((len(faces), 6), np.uint8)
    for start, parts in ((0, edges.reshape(-1, 2)), (3, faces.reshape(-1, 1))):
        new = np.zeros(len(parts), np.uint8)
        new[np.unique(parts, axis=0, return_index=True)[1]] = 1
        owned[:, start : start + 3] = new.reshape(-1, 3)
    return np.asarray(np.packbits(owned, axis=1, bitorder="little")[:, 0])


def _closed(centred: list[Floats], parts: Sequence[Parts]) -> Closed:
    found = [PartArrays.of(vertices, each) for each, vertices in zip(parts, centred, strict=True)]
    triangles, starts, boxes, box_starts, leaves, leaf_starts = _joined(
        [each.triangles for each in found],
        [each.boxes for each in found],
        [each.starts for each in found],
    )
    part = np.concatenate([each.part for each in found])
    return Closed(triangles, part, starts, boxes, box_starts, leaves, leaf_starts)


def _solids(types: Sequence[ItemType], centred: list[Floats], parts: Sequence[Parts]) -> Solids:
    points, inner = [], []
    dims = np.zeros((len(types), 3), np.int64)
    lows = np.zeros((len(types), 3))
    voxels = np.ones(len(types))
    for n, (each, vertices) in enumerate(zip(types, centred, strict=True)):
        points.append(vertices[parts[n].vertices] * (1 - INWARD))
        found = np.empty((0, 0, 0), np.uint64)
        if len(parts[n].closed) < len(each.faces):
            voxels[n] = each.extents.max() / SOLID_VOXELS
            found, lows[n] = enclosed(vertices[each.faces], voxels[n])
            if not found.any():
                found = np.empty((0, 0, 0), np.uint64)
        dims[n] = found.shape
        inner.append(found.ravel())
    return Solids(
        np.concatenate(points),
        _starts(points),
        np.concatenate(inner),
        _starts(inner),
        dims,
        lows,
        voxels,
    )


def _distances(types: Sequence[ItemType], centred: list[Floats], clearance: float) -> Distances:
    values, points = [], []
    dims = np.zeros((len(types), 3), np.int64)
    cells = np.array([(each.extents.max() + 2 * clearance) / DISTANCE_CELLS for each in types])
    margin = clearance + MARGIN * float(cells.max())
    for n, (each, vertices) in enumerate(zip(types, centred, strict=True)):
        own_margin = clearance + MARGIN * cells[n]
        found = signed_distances(vertices[each.faces], cells[n], own_margin)
        dims[n] = found.shape
        values.append(np.round(found * (STEPS / cells[n])).clip(-32000, 32000).astype(np.int16))
        points.append(spread_points(vertices, each.faces, POINTS))
    flat = [each.ravel() for each in values]
    return Distances(
        np.concatenate(flat),
        _starts(flat),
        dims,
        cells,
        np.concatenate(points),
        _starts(points),
        margin,
    )


def _joined(*columns: Any) -> Iterator[Any]:
    """Yield arrays joined, each followed by where its parts start."""
    for parts in columns:
        yield np.concatenate(parts)
        yield _starts(parts)


def _starts(parts: Sequence[Any]) -> Ints:
    return np.concatenate(([0], np.cumsum([len(part) for part in parts]))).astype(np.int64)
