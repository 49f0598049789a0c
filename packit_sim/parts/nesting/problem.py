"""The arrays of a nesting problem, which its kernels read, and the state that they change.

All arrays but fields and work arrays are constant: threads share them. A state belongs to
one search.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from packit_sim.geometry.arrays import Floats


class Surfaces(NamedTuple):
    """The surfaces of all types, drawn in, one after the other; see `triangle_trees`.

    Attributes
    ----------
    first, other : ndarray
        (n, 3, 3) float64, corners for the first and other item of a pair, which are drawn in by
        unequal lengths; those of type t from triangle_starts[t] on.
    triangle_starts, box_starts, leaf_starts : ndarray
        (t + 1,) int64.
    owned : ndarray
        (n,) uint8, bits of the edges and corners that no earlier triangle has: 1, 2, 4 for the
        edges from each corner to the next one, 8, 16, 32 for the corners.
    boxes : ndarray
        (b, 2, 3) float64, of the trees' nodes.
    leaves : ndarray
        (l,) int64, where each leaf's triangles start.
    """

    first: Any
    other: Any
    triangle_starts: Any
    owned: Any
    boxes: Any
    box_starts: Any
    leaves: Any
    leaf_starts: Any


class Closed(NamedTuple):
    """The closed parts of all types, one after the other; see `containment.PartArrays`.

    Attributes
    ----------
    triangles : ndarray
        (n, 3, 3) float64, corners; those of type t from triangle_starts[t] on.
    part : ndarray
        (n,) int64, the number of each triangle's part.
    triangle_starts, box_starts, leaf_starts : ndarray
        (t + 1,) int64.
    boxes, leaves : ndarray
        As in `Surfaces`.
    """

    triangles: Any
    part: Any
    triangle_starts: Any
    boxes: Any
    box_starts: Any
    leaves: Any
    leaf_starts: Any


class Solids(NamedTuple):
    """The space that surfaces enclose although they are not closed.

    Attributes
    ----------
    points : ndarray
        (p, 3) float64, a vertex of each connected part; those of type t from point_starts[t] on.
    point_starts : ndarray
        (t + 1,) int64.
    enclosed : ndarray
        (c,) uint64, words of 4 x 4 x 4 voxels that surfaces which are not closed enclose, of type t
        from starts[t] on; types may share them.
    starts : ndarray
        (t,) int64.
    dims : ndarray
        (t, 3) int64, the numbers of these words along the axes, 0 without any.
    lows : ndarray
        (t, 3) float64, the lowest corners of the first ones.
    voxels : ndarray
        (t,) float64, their sides.
    """

    points: Any
    point_starts: Any
    enclosed: Any
    starts: Any
    dims: Any
    lows: Any
    voxels: Any


class Distances(NamedTuple):
    """Signed distances to all types' solids, and points of their surfaces.

    Attributes
    ----------
    values : ndarray
        int16, in steps of a cell / `STEPS`; those of type t from starts[t] on.
    starts, point_starts : ndarray
        (t + 1,) int64.
    dims : ndarray
        (t, 3) int64, the numbers of nodes along the axes, around the origin.
    cells : ndarray
        (t,) float64, the distances of neighbouring nodes.
    points : ndarray
        (p, 3) float64; those of type t from point_starts[t] on; each column is contiguous.
    margin : float
        The largest distance that counts.
    placed, reached, listed : ndarray
        (k, 3) float64, bool and int64, work arrays for as many points as a type has at most.
    """

    values: Any
    starts: Any
    dims: Any
    cells: Any
    points: Any
    point_starts: Any
    margin: float
    placed: Any
    reached: Any
    listed: Any


class Lookup(NamedTuple):
    """Arrays for costs by fields; few of them, since each call of a kernel copies the tuple.

    Attributes
    ----------
    voxel : float
        Side of a field's voxels.
    clearance : float
        The distance to keep.
    slack : float
        How far bounding boxes may overlap; below 0 where bodies around items keep clear instead.
    identity : int
        The number of the relative rotation that is the identity.
    turns : ndarray
        (m, 3, 3) float64, the rotations.
    relative : ndarray
        (m, m) int64, numbers of relative rotations, from the first's frame to the other's.
    boxes : ndarray
        (t, m, 6) float64, lowest and highest corners. The origin of a type is the centre of its
        bounding box in the mesh's own frame, for all rotations.
    sizes : ndarray
        (t,) float64, factors of costs.
    hollow : ndarray
        (t,) bool, True for types that fill little of their convex hull: others may be inside.
    numbers : ndarray
        (t, t, r) int64, numbers of fields by types and relative rotation; -1: none yet.
    fields : ndarray
        (f, 4) int64, start and dimensions in values.
    values : ndarray
        int16, the nodes of all fields (see `field_kernels.encoded`).
    used : ndarray
        (3,) int64, the numbers of fields and of values in use, and how often they were full.
    voxels : ndarray
        uint8, of all types in all relative rotations.
    voxel_fields : ndarray
        (t, r, 4) int64, start and dimensions in voxels.
    """

    voxel: float
    clearance: float
    slack: float
    identity: int
    turns: Any
    relative: Any
    boxes: Any
    sizes: Any
    hollow: Any
    numbers: Any
    fields: Any
    values: Any
    used: Any
    voxels: Any
    voxel_fields: Any


class Problem(NamedTuple):
    """The items of a nesting problem, for kernels.

    Attributes
    ----------
    lookup : Lookup
        The fields.
    by_cells : bool
        True for so many types that boxes are filled with items as cells (see `cells`).
    has_fields : bool
        False for a strip of so many types: then items are also moved apart as cells, and no fields
        and signed distances are computed.
    refined : bool
        True if the surfaces compute the nodes of fields near contact; else points decide (see
        `Distances`). A search may switch this off for a while.
    relative_turns : ndarray
        (r, 3, 3) float64, the relative rotations.
    allowed : ndarray
        (t, m) int64, the first allowed_counts[t] are the rotations that a type may take.
    allowed_counts : ndarray
        (t,) int64.
    reach : ndarray
        (t,) float64, largest distance along an axis of near samples from an item.
    hulls : ndarray
        (t,) float64, the volumes of the convex hulls.
    surfaces, closed, solids, distances
        The exact data, which decides where fields leave doubt.
    shift, waiting, triangle : ndarray
        Work arrays.
    """

    lookup: Lookup
    by_cells: bool
    has_fields: bool
    refined: bool
    relative_turns: Any
    allowed: Any
    allowed_counts: Any
    reach: Any
    hulls: Any
    surfaces: Surfaces
    closed: Closed
    solids: Solids
    distances: Distances
    shift: Any
    waiting: Any
    triangle: Any


class State(NamedTuple):
    """Poses of all items, with bounds, overlaps and weights that kernels keep up to date.

    Only `pose_kernels.put` and `take_out` change poses, together with the bounds. Whoever moves an
    item computes its row and column of `overlaps` again; `state_checks` compares both with a state
    that is rebuilt from the poses.

    Attributes
    ----------
    movable : int
        The first items can be moved; the others are obstacles.
    types : ndarray
        (n,) int64.
    inside : ndarray
        (n,) uint8, 1 for items in a box.
    turned : ndarray
        (n,) int64, numbers of rotations.
    places : ndarray
        (n, 3) float64, of the origins.
    bounds : ndarray
        (n, 6) float64, lowest and highest corners, drawn in by the slack and grown by the
        clearance; each of the six columns is contiguous (see `list_near`).
    weights, overlaps : ndarray
        (n, n) float64, symmetric; weights are at least 1, or all 0 without fields, and overlaps
        depths in voxels.
    depths : ndarray
        (n,) float64, a work array for the depths of one item and each other one.
    margins : ndarray
        (n, n) float64, distances in voxels below which pairs count as overlapping; negative
        where the surfaces allow more.
    slope : ndarray
        (3,) float64, a work array for the gradient of an item's cost.
    meets, near : ndarray
        (n,) bool, with up to seven more that are never set, and int64, work arrays of `list_near`.
    eights : ndarray
        uint64, the memory of `meets`, eight items at a time.
    """

    movable: int
    types: Any
    inside: Any
    turned: Any
    places: Any
    bounds: Any
    weights: Any
    overlaps: Any
    depths: Any
    margins: Any
    slope: Any
    meets: Any
    near: Any
    eights: Any


def with_own_arrays(problem: Problem) -> Problem:
    """Return a problem that shares all but work arrays: for a thread."""
    own = _emptied(problem.distances, "placed", "reached", "listed")
    distances = problem.distances._replace(**own)
    return problem._replace(
        **_emptied(problem, "shift", "waiting", "triangle"), distances=distances
    )


def with_own_fields(problem: Problem) -> Problem:
    """Return a problem that has its own, empty fields, and shares the rest."""
    lookup = problem.lookup
    fields = _emptied(lookup, "fields", "values", "used")
    fields["numbers"] = np.full_like(lookup.numbers, -1)
    return problem._replace(lookup=lookup._replace(**fields))


def _emptied(arrays: NamedTuple, *names: str) -> dict[str, Any]:
    """Return zeros like some arrays; memory is only taken when they are written."""
    found = {name: getattr(arrays, name) for name in names}
    return {
        name: np.zeros(each.shape, each.dtype, "C" if each.flags.c_contiguous else "F")
        for name, each in found.items()
    }


def boxes_of(sizes: Sequence[Sequence[float]], widest: float = 0.0) -> Floats:
    """Arrange boxes along x, spaced so that boxes never interact.

    Parameters
    ----------
    sizes : sequence of three floats
        The sides of each box.
    widest : float
        The longest side along x that a box may have later, if longer than all of these.

    Returns
    -------
    ndarray of float64, shape (b, 4)
        The x at which each box starts, and its sides.
    """
    found = np.array(sizes, dtype=float).reshape(-1, 3)
    starts = np.arange(len(found)) * 3 * max(widest, found[:, 0].max())
    return np.column_stack((starts, found))


def state_of(types: Sequence[int], movable: int, has_weights: bool = True) -> State:
    """Return a state of items of some types, all at the origin; the first ones can be moved.

    Without fields nothing is weighted: the weights are then 0, which takes no memory.
    """
    n = len(types)
    eights = np.zeros(-(-n // 8), np.uint64)
    weights = np.ones((n, n)) if has_weights else np.zeros((n, n))
    return State(
        movable,
        np.array(types, np.int64),
        np.zeros(n, np.uint8),
        np.zeros(n, np.int64),
        np.zeros((n, 3)),
        np.zeros((6, n)).T,
        weights,
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros(3),
        eights.view(np.bool_),
        np.zeros(n, np.int64),
        eights,
    )
