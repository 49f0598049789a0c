"""The computation of a nesting problem's arrays from its types of items.

The constants here fix what an accepted packing means or only save time without changing an answer;
the resolution of stored distances is in `SearchSettings`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, cKDTree

from packit_sim.core.caches import bounded_cache
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.parts import Parts
from packit_sim.geometry.triangle_trees import boxes_of, tree_order
from packit_sim.parts.nesting.distance_kernels import STEPS
from packit_sim.parts.nesting.problem import Closed, Distances, Lookup, Problem, Solids, Surfaces
from packit_sim.parts.nesting.search_frames import searched_rotations
from packit_sim.parts.nesting.settings import DEFAULT_SETTINGS, SearchSettings
from packit_sim.parts.nesting.surface_kernels import STACK
from packit_sim.parts.nesting.voxel_sets import (
    enclosed,
    signed_distances,
    spread_points,
    turned_voxels,
)
from packit_sim.parts.packings import checked_items
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.placement import PartArrays

SOLID_VOXELS = 200
"""Voxels along the longest side of an item, for the space that an open surface encloses."""

FARTHEST = 8
"""Vertices farthest from the centre: they distinguish most rotations before all are compared."""

DRAWN_IN = 0.95, 0.6
"""Shares of the tolerance by which the surfaces of the first and other item of a pair are drawn in.

Less than a check allows; not equal, so that no faces of equal items at one place coincide: they
cross, or one item is inside the other.
"""

APART = 2.0
"""Tolerances that items as cells keep from each other, where hundreds come into contact.

Drawing in a hollow moves its inner surface outwards, by other lengths in a check than here: of many
pairs that just do not cross here, some would cross there.
"""

SLACK = min(DRAWN_IN) / 2
"""Share of the tolerance by which bounding boxes may overlap."""

DISTANCES_BUDGET = 128 * 2**20
"""Bytes of cached distances: one box after the other has much the same types."""

INWARD = 2e-4
"""Share of its distance by which a part's vertex is moved towards the item's origin.

Equal items at one place are then inside each other; on a surface no winding number is defined.
"""


def build(
    types: Sequence[ItemType],
    unit: float,
    clearance: float,
    settings: SearchSettings = DEFAULT_SETTINGS,
    by_cells: bool = False,
    has_fields: bool = True,
    bodies: Sequence[ItemType] = (),
) -> Problem:
    """Compute the arrays of a problem.

    Parameters
    ----------
    types : sequence of ItemType
        The types of items, in the frames of the search (see `search_frames`).
    unit : float
        The longest fixed side of the container.
    clearance : float
        The distance to keep.
    settings : SearchSettings
        The resolution of stored distances, and where the surfaces compute them.
    by_cells : bool
        True to fill boxes with items as cells.
    has_fields : bool
        False for a problem without fields and stored distances.
    bodies : sequence of ItemType, optional
        Bodies around the types, which keep clear of each other instead; the walls of the container
        still count for the types.

    Returns
    -------
    Problem
        The problem; its fields are still empty.
    """
    tolerance = min(checked_items.tolerance(unit, float(each.extents.max())) for each in types)
    turns, own_turns = _turns(types)
    relative, relative_turns = _relative(turns)
    bodies = bodies or types
    own = [each.vertices - each.middle for each in types]
    centred = [body.vertices - each.middle for each, body in zip(types, bodies, strict=True)]
    beyond = max(
        float(np.abs(b).max() - np.abs(a).max()) for a, b in zip(own, centred, strict=True)
    )
    boxes = np.array([_turned_boxes(vertices, turns) for vertices in own])
    allowed = np.zeros((len(types), len(turns)), np.int64)
    counts = np.zeros(len(types), np.int64)
    distinct: dict[tuple[str, tuple[int, ...]], list[int]] = {}  # of equal types once
    for n, some in enumerate(own_turns):
        key = types[n].digest, tuple(some)
        if key not in distinct:
            distinct[key] = _distinct(own[n], boxes[n], turns, some, 0.01 * tolerance)
        counts[n] = len(distinct[key])
        allowed[n, : counts[n]] = distinct[key]
    longest = np.array([each.extents.max() for each in types])
    hulls = np.array([_hull_volume(each) for each in types])
    volumes = np.array([each.volume for each in types])
    fields = len(types) * (len(types) + 1) // 2 * len(relative_turns)
    triangles = float(np.mean([len(each.faces) for each in bodies]))
    is_simple = triangles <= settings.simple_triangles
    is_cheap = is_simple or fields * triangles <= settings.refined_work
    refined = fields <= settings.max_refined_fields and is_cheap
    if by_cells:
        refined, clearance = False, max(clearance, APART * tolerance)
    # Types of which fields and distances are computed: all or none.
    measured = list(zip(bodies, centred, strict=True)) if has_fields else []
    voxel = _voxel(types, len(relative_turns), refined, settings) if has_fields else longest.min()
    voxels = [turned_voxels(v[each.faces], relative_turns, voxel) for each, v in measured]
    flat = [each.ravel() for row in voxels for each in row]
    shapes = [each.shape for row in voxels for each in row]
    voxel_fields = np.column_stack((_starts(flat)[:-1], np.reshape(shapes, (-1, 3))))
    lookup = Lookup(
        voxel=voxel,
        clearance=clearance,
        slack=SLACK * tolerance - 2 * beyond,  # bounds then reach as far as two bodies
        identity=int(relative[0, 0]),
        turns=turns,
        relative=relative,
        boxes=boxes,
        sizes=np.sqrt(longest / longest.mean()),
        hollow=(volumes < settings.hollow * hulls) & (not is_simple),
        numbers=np.full((len(measured), len(measured), len(relative_turns)), -1, np.int64),
        fields=np.zeros((min(fields, settings.max_fields) * has_fields + 1, 4), np.int64),
        values=np.zeros(settings.max_field_values * has_fields, np.int16),
        used=np.zeros(3, np.int64),
        voxels=np.concatenate([np.empty(0, np.uint8), *flat]),
        voxel_fields=voxel_fields.reshape(len(measured), len(relative_turns), 4).astype(np.int64),
    )
    parts = [Parts.of(vertices, each.faces) for each, vertices in zip(bodies, centred, strict=True)]
    return Problem(
        lookup,
        by_cells=by_cells,
        has_fields=has_fields,
        refined=refined,
        relative_turns=relative_turns,
        allowed=allowed,
        allowed_counts=counts,
        reach=longest * 0.5,
        hulls=hulls,
        surfaces=_surfaces(bodies, centred, tolerance),
        closed=_closed(centred, parts),
        solids=_solids(bodies, centred, parts),
        distances=_distances(measured, clearance, settings),
        shift=np.zeros(3),
        waiting=np.zeros((STACK, 2), np.int64),
        triangle=np.zeros((3, 3)),
    )


def have_many_fields(types: Sequence[ItemType], in_strip: bool, settings: SearchSettings) -> bool:
    """Return whether types have so many fields that a search should have cells instead.

    Fields see thin walls less well than cells do.
    """
    turns, _ = _turns(types)
    fields = len(types) * (len(types) + 1) // 2 * len(_relative(turns)[1])
    may_be_hollow = in_strip and fields > settings.most_hollow_fields
    return fields > settings.most_fields or (may_be_hollow and _are_hollow(types, settings))


def _are_hollow(types: Sequence[ItemType], settings: SearchSettings) -> bool:
    """Return whether items fill little of their convex hulls, one of each type together."""
    volume = plain_sum(each.volume for each in types)
    return volume < settings.hollow * plain_sum(map(_hull_volume, types))


def _hull_volume(item_type: ItemType) -> float:
    """Return the volume of an item's convex hull, which may be flat (QJ)."""
    return float(ConvexHull(item_type.vertices, qhull_options="QJ").volume)


def _turns(types: Sequence[ItemType]) -> tuple[Floats, list[list[int]]]:
    """Return all rotations (m, 3, 3), the identity first, and the numbers of each type's."""
    found: list[Floats] = [np.eye(3)]
    known: dict[bytes, list[int]] = {}
    own = []
    for each in types:
        turns = searched_rotations(each)
        if (key := turns.tobytes()) not in known:
            known[key] = list(dict.fromkeys(_number(found, turn) for turn in turns))
        own.append(known[key])
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
    """Return the rotations without those that a symmetry of the vertices makes equal to others."""
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


def _turned_boxes(vertices: Floats, turns: Floats) -> Floats:
    """Return the bounding box (m, 6) of a type in each rotation (m, 3, 3)."""
    turned = vertices @ turns.transpose(0, 2, 1)
    return np.hstack((turned.min(axis=1), turned.max(axis=1)))


def _voxel(
    types: Sequence[ItemType], relative: int, refined: bool, settings: SearchSettings
) -> float:
    """Return the side of the voxels: enlarged until there is memory for all fields."""
    count = settings.refined_voxels if refined else settings.rough_voxels
    longest = np.array([each.extents.max() for each in types])
    voxel = float(np.median(longest)) / count
    extents = np.array([each.extents for each in types])
    while True:
        cells = extents / voxel
        nodes = (cells[:, None] + cells[None] + 7).prod(axis=2).sum() / 2 * relative
        if nodes <= settings.max_field_values or voxel > longest.min() / 4:
            return voxel
        voxel *= 1.1


def _surfaces(types: Sequence[ItemType], centred: list[Floats], tolerance: float) -> Surfaces:
    starts = _starts([each.faces for each in types])
    first, other = np.empty((2, starts[-1], 3, 3))  # filled in place: they are most of the memory
    owned = np.empty(starts[-1], np.uint8)
    boxes: list[Floats] = []
    leaves: list[Ints] = []
    for n, (each, vertices) in enumerate(zip(types, centred, strict=True)):
        smaller, larger = (
            vertices * (np.maximum(each.extents - share * tolerance, 0) / each.extents)
            for share in DRAWN_IN
        )
        faces = each.faces[tree_order(larger[each.faces])]
        own = slice(starts[n], starts[n + 1])
        first[own], other[own], owned[own] = smaller[faces], larger[faces], _owned(faces)
        own_boxes, own_leaves = boxes_of(other[own])
        boxes.append(own_boxes)
        leaves.append(own_leaves)
    return Surfaces(first, other, starts, owned, *_joined(boxes, leaves))


def _owned(faces: Ints) -> Ints:
    """Return bits (n,) of the edges and corners that no earlier face (n, 3) has."""
    following = np.roll(faces, -1, axis=1)
    edges = np.minimum(faces, following) * (faces.max() + 1) + np.maximum(faces, following)
    owned = np.zeros((len(faces), 6), np.uint8)
    for start, parts in ((0, edges.ravel()), (3, faces.ravel())):
        new = np.zeros(len(parts), np.uint8)
        new[np.unique(parts, return_index=True)[1]] = 1
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
    points: list[Floats] = []
    inner = [np.empty(0, np.uint64)]
    starts: dict[bytes, int] = {}  # copies of a shape in several sizes have the same voxels
    used = 0
    own = np.zeros(len(types), np.int64)
    dims = np.zeros((len(types), 3), np.int64)
    lows = np.zeros((len(types), 3))
    voxels = np.ones(len(types))
    for n, (each, vertices) in enumerate(zip(types, centred, strict=True)):
        points.append(vertices[parts[n].vertices] * (1 - INWARD))
        if len(parts[n].closed) == len(each.faces):
            continue
        voxels[n] = each.extents.max() / SOLID_VOXELS
        found, lows[n] = enclosed(vertices[each.faces], voxels[n])
        if not found.any():
            continue
        dims[n] = found.shape
        key = hashlib.sha256(found.tobytes()).digest()
        if key not in starts:
            starts[key] = used
            inner.append(found.ravel())
            used += found.size
        own[n] = starts[key]
    return Solids(
        np.concatenate(points),
        _starts(points),
        np.concatenate(inner),
        own,
        dims,
        lows,
        voxels,
    )


def _distances(
    types: Sequence[tuple[ItemType, Floats]], clearance: float, settings: SearchSettings
) -> Distances:
    """Return the distances to solids, from types with their centred vertices."""
    values, points = [np.empty((0, 0, 0), np.int16)], [np.empty((0, 3))]
    longest = np.array([each.extents.max() for each, _ in types])
    cells = (longest + 2 * clearance) / settings.distance_cells
    for (each, vertices), cell in zip(types, cells.tolist(), strict=True):
        own_margin = clearance + settings.distance_margin * cell
        own, spread = _distances_of(each, vertices, cell, own_margin, settings.surface_points)
        values.append(own)
        points.append(spread)
    flat = [each.ravel() for each in values]
    most = max(map(len, points))
    return Distances(
        np.concatenate(flat),
        _starts(flat)[1:],
        np.array([each.shape for each in values[1:]], np.int64).reshape(-1, 3),
        cells,
        np.asfortranarray(np.concatenate(points)),
        _starts(points)[1:],
        clearance + settings.distance_margin * float(cells.max(initial=0.0)),
        np.zeros((3, most)).T,
        np.zeros(most, np.bool_),
        np.zeros(most, np.int64),
    )


@bounded_cache(
    "distances to solids",
    DISTANCES_BUDGET,
    "bytes",
    size=lambda both: sum(each.nbytes for each in both),
    key=lambda each, vertices, *more: (each.digest, vertices[0].tobytes(), *more),
)
def _distances_of(
    each: ItemType, vertices: Floats, cell: float, margin: float, count: int
) -> tuple[npt.NDArray[np.int16], Floats]:
    """Return the distances to one solid and points of its surface, with its centred vertices."""
    found = signed_distances(vertices[each.faces], cell, margin)
    values = np.round(found * (STEPS / cell)).clip(-32000, 32000).astype(np.int16)
    return values, spread_points(vertices, each.faces, count)


def _joined(*columns: Any) -> Iterator[Any]:
    """Yield each column joined to one array, followed by the starts of its parts."""
    for parts in columns:
        yield np.concatenate(parts)
        yield _starts(parts)


def _starts(parts: Sequence[Any]) -> Ints:
    return np.concatenate(([0], np.cumsum([len(part) for part in parts]))).astype(np.int64)
