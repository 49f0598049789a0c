"""Kernels that change the poses of items, with their bounds, and the search's random numbers.

Only `put` and `take_out` write poses of a state, always together with the bounds. Bounds are drawn
in by the slack and grown by the clearance, so that touching items are apart at the first test. An
item that is taken out has bounds that nothing meets: no kernel needs to ask whether it is inside.

The generator is SplitMix64 (Steele, Lea and Flood, 2014): a state of one word, passed by the
caller, so that a search resumes anywhere with the same numbers.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inlined, inner_kernel, kernel

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
    return float(z >> np.uint64(11)) / 9007199254740992.0  # 53 bits: all that a float64 holds


@inner_kernel
def shuffle(order, rng):
    """Shuffle an array in place (Fisher and Yates)."""
    for n in range(len(order) - 1, 0, -1):
        m = int(random(rng) * (n + 1))
        order[n], order[m] = order[m], order[n]


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
    """Take an item out: give it bounds that meet no others, and no overlaps."""
    state.inside[i] = 0
    state.bounds[i, :3] = NO_LIMIT
    state.bounds[i, 3:] = -NO_LIMIT
    for j in range(len(state.types)):
        set_overlap(state, i, j, 0.0)


@inlined
def set_overlap(state, i, j, depth):
    """Set the overlap of a pair, if it changes: memory that is never written is not taken."""
    if state.overlaps[i, j] != depth:
        state.overlaps[i, j] = depth
        state.overlaps[j, i] = depth


@inner_kernel
def list_near(state, bounds, i, low, high):
    """List the items whose bounds have something in common with a box, besides item i.

    Parameters
    ----------
    state : State
        Its `meets` and `near` get whether an item is one of them, and their numbers.
    bounds : ndarray
        (n, 6), lowest and highest corners; each column is contiguous.
    i : int
        The item.
    low, high : tuple
        The corners of the box, of the type of the bounds: others are compared one at a time.

    Returns
    -------
    int
        Their number.
    """
    meets, near = state.meets, state.near
    # Two loops without branches for each item: the first compares eight at a time, and most of the
    # eights of the second are empty.
    for j in range(len(bounds)):
        meets[j] = (
            (bounds[j, 5] > low[2])
            & (bounds[j, 2] < high[2])
            & (bounds[j, 3] > low[0])
            & (bounds[j, 0] < high[0])
            & (bounds[j, 4] > low[1])
            & (bounds[j, 1] < high[1])
        )
    meets[i] = False
    count = 0
    for n in range(len(state.eights)):
        if state.eights[n] != 0:
            for j in range(8 * n, min(8 * n + 8, len(bounds))):
                near[count] = j
                count += meets[j]
    return count


@inlined
def apart(state, i, j):
    """Return whether the bounds of two items have nothing in common."""
    bounds = state.bounds
    return (
        bounds[j, 5] <= bounds[i, 2]
        or bounds[j, 2] >= bounds[i, 5]
        or bounds[j, 3] <= bounds[i, 0]
        or bounds[j, 0] >= bounds[i, 3]
        or bounds[j, 4] <= bounds[i, 1]
        or bounds[j, 1] >= bounds[i, 4]
    )


@kernel
def box_of(boxes, x):
    """Return the number of the box that a place at x is in or near."""
    # Gaps between boxes are two widths (`boxes_of`): half a width before its start is near box k.
    k = len(boxes) - 1
    while k > 0 and x < boxes[k, 0] - 0.5 * boxes[k, 1]:
        k -= 1
    return k


@inner_kernel
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
            most = least  # an item that fits exactly is too large by rounding
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
