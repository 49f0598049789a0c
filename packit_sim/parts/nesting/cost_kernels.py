"""Kernels for the weighted overlap of an item with all others, at any pose.

The cost of a pose is the sum, over the items it overlaps, of weight * depth * sizes. The depth is
the penetration depth in voxels, the shortest way out, as in Imamichi, Yagiura and Nagamochi (2009);
unlike a volume of overlap, it has a useful slope where one item is deep inside another. As in
sparrow (Gardeyn et al., 2025) it is scaled by the sizes of both items, so that large ones are moved
apart before small ones.

There are two measures. The *rough cost* interpolates penetration fields and computes no node: well
under a microsecond a pair, for samples and coordinate descent. The *fine cost* lets the surfaces
compute nodes near contact, or asks signed distances at points of the surfaces; it has a gradient.
Both are estimates. Only surfaces (`conflict_kernels`) decide about a packing.

Invariants: the distance of a pair does not depend on which of the two is asked (see `offset`), so
that overlaps are symmetric. A cost may stop at its limit; what it returns is then no cost.
"""

from __future__ import annotations

from packit_sim.core.compilation import inlined, inner_kernel
from packit_sim.parts.nesting.distance_kernels import least_distance
from packit_sim.parts.nesting.field_kernels import SCALE
from packit_sim.parts.nesting.overlap_kernels import (
    add_field,
    gradient,
    in_conflict,
    interpolated,
    node_of,
    refine_node,
    simplex,
)
from packit_sim.parts.nesting.pose_kernels import NO_LIMIT, list_near, set_overlap

FAR = 1.5
"""Voxels of distance by fields from which on a pair is apart: fields err by less."""

CROSSING = 2.0
"""Voxels of depth by fields from which on fields count, and not points.

Points that are deep in a thin item do not say how far the way out is.
"""

NEGLIGIBLE = 1e-9
"""Voxels of depth up to which a pair does not overlap.

A margin is often exactly a distance that was measured, and rounding then leaves an overlap that no
move can remove.
"""

DOUBT = 0.3
"""Voxels of depth by points up to which surfaces decide if an item is inside a hollow one.

Fields are too coarse for a place that is hardly larger than what it holds.
"""


@inner_kernel
def rough_cost(lookup, state, i, o, p, limit):
    """Compute the weighted overlap of an item at a pose, by fields alone.

    Parameters
    ----------
    lookup : Lookup
        The fields.
    state : State
        Poses of the other items.
    i : int
        The item.
    o : int
        The number of its rotation.
    p : ndarray
        (3,) float64, its place.
    limit : float
        The cost from which on its value does not matter.

    Returns
    -------
    float
        The cost if it is below the limit, else any number of at least the limit.
    """
    count = list_near_pose(lookup, state, i, o, p)
    total = 0.0
    for n in range(count):
        j = state.near[n]
        first, other, rel, sx, sy, sz = offset(lookup, state, i, o, p, j)
        number = lookup.numbers[first, other, rel]
        if number < 0:
            number = add_field(lookup, first, other, rel)
        at, fx, fy, fz = node_of(lookup, number, sx, sy, sz)
        if at < 0:  # outside of the field, which reaches beyond contact
            continue
        distance = interpolated(lookup, number, at, fx, fy, fz)
        if distance < 0:
            total -= distance * state.weights[i, j] * lookup.sizes[first] * lookup.sizes[other]
            if total >= limit:
                return total
    return total


@inner_kernel
def fine_cost(problem, state, i, o, p, limit):
    """Compute the weighted overlap of an item at a pose: near contact by points or surfaces.

    Parameters
    ----------
    state : State
        Poses of the other items; its `depths` get those of this item, its `slope` the gradient.
    i : int
        The item.
    o : int
        The number of its rotation.
    p : ndarray
        (3,) float64, its place.
    limit : float
        The cost from which on its value does not matter.

    Returns
    -------
    float
        The cost if it is below the limit, else any number of at least the limit.
    """
    lookup = problem.lookup
    a = state.types[i]
    count = list_near_pose(lookup, state, i, o, p)
    total = 0.0
    state.depths[:] = 0
    state.slope[:] = 0
    for n in range(count):
        j = state.near[n]
        distance, gx, gy, gz = distance_of(problem, state, i, o, p, j)
        depth = state.margins[i, j] - distance
        if depth <= NEGLIGIBLE:
            continue
        state.depths[j] = depth
        factor = state.weights[i, j] * lookup.sizes[a] * lookup.sizes[state.types[j]]
        state.slope[0] -= factor * gx
        state.slope[1] -= factor * gy
        state.slope[2] -= factor * gz
        total += factor * depth
        if total >= limit:
            return total
    return total


@inner_kernel
def distance_of(problem, state, i, o, p, j):
    """Return the distance of two items in voxels, and its gradient (3) for moves of the first.

    Without fields only surfaces are asked: any conflict has the depth 1 and no gradient.
    """
    lookup = problem.lookup
    first, other, rel, sx, sy, sz = offset(lookup, state, i, o, p, j)
    if not problem.has_fields:
        is_conflict = in_conflict(problem, first, other, rel, sx, sy, sz, True)
        return -1.0 if is_conflict else NO_LIMIT, 0.0, 0.0, 0.0
    number = lookup.numbers[first, other, rel]
    if number < 0:
        number = add_field(lookup, first, other, rel)
    at, fx, fy, fz = node_of(lookup, number, sx, sy, sz)
    if at < 0:
        return NO_LIMIT, 0.0, 0.0, 0.0
    nodes = simplex(lookup, number, at, fx, fy, fz)
    if problem.refined:
        # Nodes are computed when they are first needed, and final then: most never are.
        for n in range(4):
            if not lookup.values[nodes[n]] & 1:
                refine_node(problem, first, other, rel, nodes[n])
    x, y, z = gradient(lookup, number, nodes)
    distance = ((lookup.values[at] >> 1) + x * fx + y * fy + z * fz) / SCALE
    if distance > FAR:
        return NO_LIMIT, 0.0, 0.0, 0.0
    per_step = 1 / (SCALE * lookup.voxel)
    gx, gy, gz = x * per_step, y * per_step, z * per_step
    # Points see thin gaps that voxels fill, but a point deep in a thin wall is never deep: there
    # the field knows the way out. A hollow item is the exception, since its field fills the cavity.
    by_points = not problem.refined and distance >= -CROSSING
    may_be_inside = distance < -CROSSING and (lookup.hollow[first] or lookup.hollow[other])
    if by_points or may_be_inside:
        turn = problem.relative_turns[rel]
        least, px, py, pz = least_distance(problem.distances, first, other, turn, sx, sy, sz)
        per_voxel = 1 / lookup.voxel
        least = (least - lookup.clearance) * per_voxel
        if by_points:
            distance, gx, gy, gz = least, px * per_voxel, py * per_voxel, pz * per_voxel
        elif least > -DOUBT and not in_conflict(problem, first, other, rel, sx, sy, sz, True):
            distance, gx, gy, gz = max(least, 0.0), 0.0, 0.0, 0.0
    # The gradient is for moves of the other item in the first one's frame (see `offset`); turn it
    # to the container's frame, and for moves of item i.
    a, b = state.types[i], state.types[j]
    turn, sign = lookup.turns[o], -1.0
    if a > b or (a == b and i > j):
        turn, sign = lookup.turns[state.turned[j]], 1.0
    return (
        distance,
        sign * (turn[0, 0] * gx + turn[0, 1] * gy + turn[0, 2] * gz),
        sign * (turn[1, 0] * gx + turn[1, 1] * gy + turn[1, 2] * gz),
        sign * (turn[2, 0] * gx + turn[2, 1] * gy + turn[2, 2] * gz),
    )


@inlined
def list_near_pose(lookup, state, i, o, p):
    """List the other items whose bounds an item at a pose meets in `near`; return their number."""
    box = lookup.boxes[state.types[i], o]
    low = p[0] + box[0], p[1] + box[1], p[2] + box[2]
    high = p[0] + box[3], p[1] + box[4], p[2] + box[5]
    return list_near(state, state.bounds, i, low, high)


@inlined
def offset(lookup, state, i, o, p, j):
    """Return the types of two items, in a fixed order, their relative rotation and offset (3).

    The lower type is first, of equal types the lower number: one field serves a pair both ways, and
    the distance is exactly the same whichever of the two items is asked about.
    """
    a, b, q, ob = state.types[i], state.types[j], state.places[j], state.turned[j]
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    first, other, turned, rel = a, b, o, lookup.relative[o, ob]
    if a > b or (a == b and i > j):
        first, other, turned, rel = b, a, ob, lookup.relative[ob, o]
        dx, dy, dz = -dx, -dy, -dz
    turn = lookup.turns[turned]
    return (
        first,
        other,
        rel,
        turn[0, 0] * dx + turn[1, 0] * dy + turn[2, 0] * dz,
        turn[0, 1] * dx + turn[1, 1] * dy + turn[2, 1] * dz,
        turn[0, 2] * dx + turn[1, 2] * dy + turn[2, 2] * dz,
    )


@inlined
def update_overlaps(problem, state, i):
    """Compute the overlaps of an item with all others again."""
    fine_cost(problem, state, i, state.turned[i], state.places[i], NO_LIMIT)
    for j in range(len(state.types)):
        set_overlap(state, i, j, state.depths[j])


@inner_kernel
def total_overlap(problem, state):
    """Return the sum of all overlaps, unweighted."""
    sizes = problem.lookup.sizes
    total = 0.0
    for i in range(len(state.types)):
        for j in range(i):
            if state.overlaps[i, j] > 0:
                total += state.overlaps[i, j] * sizes[state.types[i]] * sizes[state.types[j]]
    return total
