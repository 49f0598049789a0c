"""Kernels that place items one by one where they are not in conflict.

Each item is sampled below the top of the items before it; the lowest samples without overlap are
lowered as far as steps lead, down, then left and back, and so are some that are dropped from above.
The lowest result that the surfaces confirm is kept. This is bottom-left-back fill with random
starts instead of a grid (our own). A construction never fails while there is space on top.

Invariants: items that are already inside do not move. The rough cost is only a filter; no item is
put anywhere before `find_conflicts` has found none by the surfaces. Margins are changed on the way
and are all 0 afterwards.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inlined, inner_kernel, kernel
from packit_sim.parts.nesting.conflict_kernels import find_conflicts
from packit_sim.parts.nesting.cost_kernels import fine_cost, rough_cost
from packit_sim.parts.nesting.pose_kernels import NO_LIMIT, clamp, put, random, sample, take_out

TRIES = 8
"""Lowest samples of an item that are lowered and shown to the surfaces; sizes of arrays."""

DROPS = 8
"""Random places above all other items from which it is also lowered."""

MARGINS = 0.0, 0.2, 0.5
"""Voxels of distance to keep while an item is lowered; the next one if surfaces then conflict."""


@kernel
def construct(problem, state, order, box, samples, rng):
    """Place items in an order in a box, each at the lowest place that is found.

    Parameters
    ----------
    state : State
        Poses of all items, those of the order taken out; changed.
    order : ndarray
        (k,) int64, the items to place; those for which there is no place stay taken out.
    box : ndarray
        (1, 4) float64, the box (see `boxes_of`); its height may be infinite.
    samples : int
        Samples for each item.
    rng : ndarray
        (1,) uint64, the state of the generator.
    """
    lookup = problem.lookup
    limits = box.copy()
    p = np.empty(3)
    heights = np.empty(TRIES)
    places = np.empty((TRIES, 3))
    turned = np.zeros(TRIES, np.int64)
    gap = lookup.clearance - min(lookup.slack, 0.0)  # as far as bounds reach where bodies count
    top = _top(lookup, state, box)
    for i in order:
        a = state.types[i]
        heights[:] = NO_LIMIT
        for _ in range(samples):
            o = problem.allowed[a, int(random(rng) * problem.allowed_counts[a])]
            height = lookup.boxes[a, o, 5] - lookup.boxes[a, o, 2]
            # Samples above the top are of no use: the item can always stand there.
            limits[0, 3] = min(box[0, 3], top + gap + height)
            sample(lookup, a, o, p, limits[0], rng)
            if not clamp(lookup, a, o, p, limits):
                continue
            height = p[2] + lookup.boxes[a, o, 5]
            # The cheap test first: most samples are higher than the lowest few.
            if height >= heights[TRIES - 1] or rough_cost(lookup, state, i, o, p, 1e-9) > 0:
                continue
            k = TRIES - 1
            while k > 0 and heights[k - 1] > height:
                heights[k] = heights[k - 1]
                places[k] = places[k - 1]
                turned[k] = turned[k - 1]
                k -= 1
            heights[k] = height
            places[k] = p
            turned[k] = o
        least = NO_LIMIT
        best = p.copy()
        best_turned = 0
        for k in range(TRIES + DROPS):
            if k < TRIES:
                if heights[k] == NO_LIMIT:
                    continue
                o = turned[k]
                p[:] = places[k]
            else:
                o = problem.allowed[a, int(random(rng) * problem.allowed_counts[a])]
                sample(lookup, a, o, p, limits[0], rng)
                p[2] = top + gap - lookup.boxes[a, o, 2]
                if not clamp(lookup, a, o, p, box):
                    continue
            if _is_lowered(problem, state, i, o, p, box, least):
                least, best_turned = p[2] + lookup.boxes[a, o, 5], o
                best[:] = p
        state.margins[:] = 0  # those of the trials mean nothing to the next item
        if least < NO_LIMIT:
            put(lookup, state, i, best_turned, best)
        else:
            take_out(state, i)
            least = _put_on_top(problem, state, i, top + gap, box)
        if least < NO_LIMIT:
            top = max(top, least)


@inner_kernel
def _top(lookup, state, box):
    """Return the height of the highest item in a box (1, 4)."""
    top = 0.0
    for j in range(len(state.types)):
        # Boxes are three widths apart: within one width of the middle is in this box.
        if abs(state.places[j, 0] - box[0, 0] - 0.5 * box[0, 1]) < box[0, 1] and state.inside[j]:
            top = max(top, state.places[j, 2] + lookup.boxes[state.types[j], state.turned[j], 5])
    return top


@allocating_kernel
def _put_on_top(problem, state, i, height, box):
    """Put an item at a height, if that is inside the box; return the height of its top."""
    lookup = problem.lookup
    a = state.types[i]
    p = np.empty(3)
    for k in range(problem.allowed_counts[a]):
        o = problem.allowed[a, k]
        p[0] = box[0, 0]
        p[1] = 0.0
        p[2] = height - lookup.boxes[a, o, 2]
        top = p[2] + lookup.boxes[a, o, 5]
        if top <= box[0, 3] and clamp(lookup, a, o, p, box):
            put(lookup, state, i, o, p)
            return top
    return NO_LIMIT


@inlined
def _is_lowered(problem, state, i, o, p, box, limit):
    """Lower an item; return whether it then is not in conflict and lower than a limit."""
    place = p.copy()
    is_free = False
    for margin in MARGINS:
        state.margins[i, :] = margin
        p[:] = place
        if fine_cost(problem, state, i, o, p, 1e-9) > 0:  # nor would a larger margin be free
            break
        _lower(problem, state, i, o, p, box)
        if p[2] + problem.lookup.boxes[state.types[i], o, 5] >= limit:
            break
        put(problem.lookup, state, i, o, p)
        is_free = find_conflicts(problem, state, i, len(state.types)) == 0
        if is_free:
            break
    return is_free


@inlined
def _lower(problem, state, i, o, p, box):
    """Lower an item, and move it to the left and back, as far as steps without conflict lead."""
    lookup = problem.lookup
    a = state.types[i]
    step = lookup.voxel * 4
    trial = np.empty(3)
    while step > 0.05 * lookup.voxel:
        moved = False
        for d in (2, 0, 1):  # down before left before back
            trial[:] = p
            trial[d] -= step
            clamp(lookup, a, o, trial, box)  # at the wall the step is shorter
            if trial[d] < p[d] and fine_cost(problem, state, i, o, trial, 1e-9) == 0:
                p[:] = trial
                moved = True
        if not moved:
            step *= 0.5
