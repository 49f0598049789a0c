"""Kernels for the weighted overlap of an item with all others, at any pose."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inlined, inner_kernel, kernel
from packit_sim.nesting.distance_kernels import least_distance
from packit_sim.nesting.overlap_kernels import (
    FLOOR,
    add_field,
    in_conflict,
    interpolated,
    node_of,
    settle,
    settled,
)

NONE, ALL = 0.0, 1.5
"""Reaches of the surfaces, in voxels of distance by fields or points.

With none, these alone decide. With `ALL`, a cost of 0 is certain, unless a field is wrong by more.
"""

GRAZE = 0.15
"""Voxels that the depth of items in conflict is more than points say."""

NO_LIMIT = 1e300
"""A cost that is never reached."""


@inner_kernel
def random(state):
    """Return a number in [0, 1), and advance the state (1,) uint64 of the generator."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) / 9007199254740992.0


@inlined
def _beside(state, i, j, lx, ly, lz, hx, hy, hz):
    """Return whether an item's bounding box has nothing in that from (lx, ...) to (hx, ...)."""
    bounds = state.bounds
    return (
        bounds[j, 5] <= lz
        or bounds[j, 2] >= hz
        or bounds[j, 3] <= lx
        or bounds[j, 0] >= hx
        or bounds[j, 4] <= ly
        or bounds[j, 1] >= hy
        or j == i
    )


@inlined
def _offset(lookup, state, i, o, p, j):
    """Return the types of two items, in a fixed order, their relative rotation and offset (3)."""
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


@inner_kernel
def rough_cost(lookup, state, i, o, p, limit):
    """Compute the weighted overlap of an item at a pose, by the fields as they are.

    Parameters
    ----------
    lookup : Lookup
        The fields.
    state : State
        Where the other items are.
    i : int
        The item.
    o : int
        The number of its rotation.
    p : ndarray
        (3,) float64, its place.
    limit : float
        The cost from which on it does not matter.

    Returns
    -------
    float
        The cost, or any number of at least the limit if it is that much.
    """
    a = state.types[i]
    box = lookup.boxes[a, o]
    lx, ly, lz = p[0] + box[0], p[1] + box[1], p[2] + box[2]
    hx, hy, hz = p[0] + box[3], p[1] + box[4], p[2] + box[5]
    total = 0.0
    for j in range(len(state.types)):
        if _beside(state, i, j, lx, ly, lz, hx, hy, hz):
            continue
        first, other, rel, sx, sy, sz = _offset(lookup, state, i, o, p, j)
        number = lookup.numbers[first, other, rel]
        if number < 0:
            number = add_field(lookup, first, other, rel)
        at, fx, fy, fz = node_of(lookup, number, sx, sy, sz)
        if at < 0:
            continue
        distance = interpolated(lookup, number, at, fx, fy, fz)
        if distance < 0:
            total -= distance * state.weights[i, j] * lookup.sizes[first] * lookup.sizes[other]
            if total >= limit:
                return total
    return total


@inner_kernel
def fine_cost(problem, state, i, o, p, limit, reach):
    """Compute the weighted overlap of an item at a pose, near contact by the surfaces.

    Parameters
    ----------
    problem : Problem
        The problem.
    state : State
        Where the other items are; its `depths` get those of this item.
    i : int
        The item.
    o : int
        The number of its rotation.
    p : ndarray
        (3,) float64, its place.
    limit : float
        The cost from which on it does not matter.
    reach : float
        Voxels of distance up to which the surfaces decide, from `NONE` to `ALL`.

    Returns
    -------
    float
        The cost, or any number of at least the limit if it is that much.
    """
    problem.counts[0] += 1
    lookup = problem.lookup
    a = state.types[i]
    box = lookup.boxes[a, o]
    lx, ly, lz = p[0] + box[0], p[1] + box[1], p[2] + box[2]
    hx, hy, hz = p[0] + box[3], p[1] + box[4], p[2] + box[5]
    total = 0.0
    state.depths[:] = 0
    for j in range(len(state.types)):
        if _beside(state, i, j, lx, ly, lz, hx, hy, hz):
            continue
        first, other, rel, sx, sy, sz = _offset(lookup, state, i, o, p, j)
        number = lookup.numbers[first, other, rel]
        if number < 0:
            number = add_field(lookup, first, other, rel)
        at, fx, fy, fz = node_of(lookup, number, sx, sy, sz)
        if at < 0:
            continue
        if problem.refined and not settled(lookup, number, at):
            settle(problem, first, other, rel, at)
        distance = interpolated(lookup, number, at, fx, fy, fz)
        if distance > ALL:
            continue
        if not problem.refined:
            turn = problem.relative_turns[rel]
            distance = least_distance(problem.distances, first, other, turn, sx, sy, sz)
            distance = (distance - lookup.clearance) / lookup.voxel
        if distance >= 0 and distance >= reach and reach < ALL:
            continue
        found = -distance
        if reach > 0 and distance >= -problem.deep:
            maybe_nested = distance < 0.5
            if not in_conflict(problem, first, other, rel, sx, sy, sz, maybe_nested):
                continue
            found = max(FLOOR, (0.0 if problem.refined else GRAZE) - distance)
        state.depths[j] = found
        total += found * state.weights[i, j] * lookup.sizes[first] * lookup.sizes[other]
        if total >= limit:
            return total
    return total


@kernel
def put(lookup, state, i, o, p):
    """Set the pose of an item: a rotation's number and a place (3,)."""
    a = state.types[i]
    state.inside[i] = 1
    state.turned[i] = o
    less = lookup.slack - lookup.clearance
    for d in range(3):
        state.places[i, d] = p[d]
        state.bounds[i, d] = p[d] + lookup.boxes[a, o, d] + less
        state.bounds[i, 3 + d] = p[d] + lookup.boxes[a, o, 3 + d] - less


@kernel
def take_out(state, i):
    """Move an item to where it is in nobody's way."""
    state.inside[i] = 0
    state.bounds[i, :3] = NO_LIMIT
    state.bounds[i, 3:] = -NO_LIMIT
    state.overlaps[i] = 0
    state.overlaps[:, i] = 0


@kernel
def update_overlaps(problem, state, i, reach):
    """Compute the overlaps of an item with all others again; see `fine_cost` for the reach."""
    fine_cost(problem, state, i, state.turned[i], state.places[i], NO_LIMIT, reach)
    state.overlaps[i] = state.depths
    state.overlaps[:, i] = state.depths


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


@kernel
def box_of(boxes, x):
    """Return the number of the box that a place at x is in, or is next to."""
    k = len(boxes) - 1
    while k > 0 and x < boxes[k, 0] - 0.5 * boxes[k, 1]:
        k -= 1
    return k


@kernel
def clamp(lookup, a, o, p, boxes):
    """Move a place (3,) into its box; return whether the item fits into that."""
    box = boxes[box_of(boxes, p[0])]
    for d in range(3):
        start = box[0] if d == 0 else 0.0
        least = start - lookup.boxes[a, o, d]
        most = start + box[1 + d] - lookup.boxes[a, o, 3 + d]
        if most < least:
            if most < least - lookup.slack:
                return False
            most = least
        p[d] = min(max(p[d], least), most)
    return True


@inner_kernel
def sample(lookup, a, o, p, box, rng):
    """Write a random place in a box (4,) to `p` (3,); for an item that is too large, its corner."""
    for d in range(3):
        start = box[0] if d == 0 else 0.0
        least = start - lookup.boxes[a, o, d]
        most = start + box[1 + d] - lookup.boxes[a, o, 3 + d]
        p[d] = least + random(rng) * max(0.0, most - least)
