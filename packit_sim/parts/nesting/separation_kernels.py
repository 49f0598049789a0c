"""Kernels that move overlapping items until no two overlap: separation by guided local search.

The objective is the sum over pairs of weight * depth * sizes (`cost_kernels`). A pass takes the
overlapping items in random order and moves each to the best pose that a search for that item alone
finds; then weights of overlapping pairs grow. So a local minimum becomes more expensive until the
search leaves it.

Sources: guided local search (Voudouris and Tsang, 1999), for packing by overlap minimisation by
Egeblad, Nielsen and Odgaard (2007) and Egeblad, Nielsen and Brazil (2009). Moves and weights are
those of sparrow's separation procedure (Gardeyn, Vanden Berghe and Wauters, 2025): samples near
the item and in the whole container, the best of them refined by coordinate descent; weights that
are multiplied, more for deeper pairs, and decay. Our own are the descent along the gradient of the
fine cost, which needs points or surfaces, and the push of all items after a pass.

Invariants: `state.overlaps` is symmetric and fits the poses whenever a kernel returns, which
`update_overlaps` after each move ensures. A move needs a lower fine cost; the push needs a lower
total overlap, or is undone. The same state of the generator gives the same moves, so that each call
of `random` is part of the result.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inlined, inner_kernel, kernel
from packit_sim.parts.nesting.conflict_kernels import DEEP, allow_contacts
from packit_sim.parts.nesting.cost_kernels import (
    fine_cost,
    rough_cost,
    total_overlap,
    update_overlaps,
)
from packit_sim.parts.nesting.pose_kernels import NO_LIMIT, clamp, put, random, sample, shuffle
from packit_sim.parts.nesting.pushing_kernels import push_apart

KEPT = 4
"""Samples of a move that are improved by the rough cost, in addition to the present pose."""

REFINED = 2
"""The best of these, which are improved by the fine cost: it takes most of the time."""

STEPS = 30
"""Limit of steps along the gradient of the fine cost."""

OVERSHOOT = 1.1
"""Factor of a step to where the gradient predicts cost 0: contact then ends in a gap."""

PATIENCE = 6
"""Steps without a gain of 2% after which these end."""


@inner_kernel
def _next_trials(p, steps, trials, rng):
    """Write the trials of a descent step to `trials` (4, 3): along an axis, or along two at once.

    Returns
    -------
    int
        Their number.
    int
        The axis of the step.
    int
        The second axis, or the same one.
    """
    # One step in four is diagonal: in a corner between two items, each axis alone is blocked.
    d = int(random(rng) * 4)
    e = d
    if d == 3:
        d = int(random(rng) * 3)
        e = (d + 1) % 3
    count = 2 if d == e else 4
    for n in range(count):
        for axis in range(3):
            trials[n, axis] = p[axis]
        trials[n, d] += steps[d] if n & 1 else -steps[d]
        if e != d:
            trials[n, e] += steps[e] if n & 2 else -steps[e]
    return count, d, e


@inlined
def _rough_descent(lookup, state, i, o, p, found, boxes, rng):
    """Improve a place by coordinate descent of the rough cost; return its cost."""
    trials = np.empty((4, 3))
    steps = np.full(3, lookup.voxel)
    a = state.types[i]
    while found > 0 and max(steps[0], steps[1], steps[2]) > 0.3 * lookup.voxel:
        count, d, e = _next_trials(p, steps, trials, rng)
        best = -1
        for n in range(count):
            if not clamp(lookup, a, o, trials[n], boxes):
                continue
            # The cost so far is the limit: a trial that reaches it ends early, and loses.
            other = rough_cost(lookup, state, i, o, trials[n], found)
            if other < found:
                found = other
                best = n
        if best >= 0:
            p[:] = trials[best]
        _scale_steps(steps, d, e, best >= 0)
    return found


@inlined
def _fine_descent(problem, state, i, o, p, found, boxes):
    """Improve a place along the gradient of the fine cost, last computed there; return its cost."""
    a = state.types[i]
    slope = state.slope
    best = p.copy()
    trial = np.empty(3)
    least = found
    idle = 0
    for _ in range(STEPS):
        is_blocked = True
        while is_blocked:  # walls take away components of the slope, one after the other
            is_blocked = False
            square = slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2
            if square < 1e-30:
                break
            # Newton's step for a cost that is linear along its gradient, as depths nearly are.
            for d in range(3):
                trial[d] = p[d] - OVERSHOOT * found / square * slope[d]
            # Boxes stand side by side: a step may lead into the next one, which may be too small.
            if not clamp(problem.lookup, a, o, trial, boxes):
                square = 0.0
                break
            for d in range(3):
                if trial[d] == p[d] and slope[d] != 0:
                    slope[d] = 0
                    is_blocked = True
        if square < 1e-30:
            break
        p[:] = trial
        found = fine_cost(problem, state, i, o, p, NO_LIMIT)
        idle = 0 if found < 0.98 * least else idle + 1
        if found < least:
            least = found
            best[:] = p
        if least == 0 or idle > PATIENCE:
            break
    p[:] = best
    return least


@inner_kernel
def _scale_steps(steps, d, e, better):
    """Let the steps along two axes grow after an improvement, and shrink without one."""
    factor = 1.1 if better else 0.5
    steps[d] *= factor
    if e != d:
        steps[e] *= factor


@inner_kernel
def _keep(costs, places, turned, found, o, p, spread):
    """Insert a sample into the sorted list of the best, unless a better one is close.

    Without that the list would hold one place many times, and its descents would end alike.
    """
    for k in range(KEPT):
        if (
            costs[k] < NO_LIMIT
            and turned[k] == o
            and abs(places[k, 0] - p[0]) < spread
            and abs(places[k, 1] - p[1]) < spread
            and abs(places[k, 2] - p[2]) < spread
        ):
            if found >= costs[k]:
                return
            for m in range(k, KEPT - 1):
                _copy_sample(costs, places, turned, m + 1, m)
            costs[KEPT - 1] = NO_LIMIT
            break
    if found >= costs[KEPT - 1]:
        return
    k = KEPT - 1
    while k > 0 and costs[k - 1] > found:
        _copy_sample(costs, places, turned, k - 1, k)
        k -= 1
    costs[k] = found
    for d in range(3):
        places[k, d] = p[d]
    turned[k] = o


@inlined
def _copy_sample(costs, places, turned, k, m):
    costs[m] = costs[k]
    for d in range(3):
        places[m, d] = places[k, d]
    turned[m] = turned[k]


@inlined
def _move(problem, state, i, boxes, samples, rng):
    """Move an item to the pose of least weighted overlap that is found.

    Algorithm: the search for a placement of sparrow. A third of the samples is near the present
    pose, the others are all over the container; the best few are improved, first by the rough cost,
    then by the fine cost.
    """
    lookup = problem.lookup
    a = state.types[i]
    costs = np.full(KEPT + 1, NO_LIMIT)
    kept = np.empty((KEPT + 1, 3))
    kept_turned = np.zeros(KEPT + 1, np.int64)
    p = np.empty(3)
    current = state.places[i].copy()
    turned = state.turned[i]
    before = fine_cost(problem, state, i, turned, current, NO_LIMIT)
    for n in range(samples):
        near = n % 3 == 0
        o = turned
        if not near or n % 6 == 0:
            o = problem.allowed[a, int(random(rng) * problem.allowed_counts[a])]
        if near:  # the sum of two uniform numbers has a triangular density, highest at 0
            for d in range(3):
                p[d] = current[d] + (random(rng) + random(rng) - 1) * problem.reach[a]
        else:
            sample(lookup, a, o, p, boxes[int(random(rng) * len(boxes))], rng)
        if not clamp(lookup, a, o, p, boxes):
            continue
        found = rough_cost(lookup, state, i, o, p, costs[KEPT - 1])
        if found < costs[KEPT - 1]:
            _keep(costs, kept, kept_turned, found, o, p, 2 * lookup.voxel)
    # The present pose competes too: its own descent is often the smallest move that helps.
    kept[KEPT], kept_turned[KEPT] = current, turned
    costs[KEPT] = rough_cost(lookup, state, i, turned, current, NO_LIMIT)
    for k in range(KEPT + 1):
        if 0 < costs[k] < NO_LIMIT:
            o = kept_turned[k]
            costs[k] = _rough_descent(lookup, state, i, o, kept[k], costs[k], boxes, rng)
    least, least_turned = before, turned
    best = current.copy()
    order = np.argsort(costs)
    for n in range(REFINED):
        k = order[n]
        if costs[k] == NO_LIMIT:
            break
        o = kept_turned[k]
        p[:] = kept[k]
        found = fine_cost(problem, state, i, o, p, NO_LIMIT)
        if found > 0:
            found = _fine_descent(problem, state, i, o, p, found, boxes)
        if found < least:
            least, least_turned = found, o
            best[:] = p
            if found == 0:
                break
    if least < before:
        put(lookup, state, i, least_turned, best)


@kernel
def separate(problem, state, best, boxes, samples, passes, weights, rng):
    """Move overlapping items in passes; the weights of pairs that overlap grow.

    Parameters
    ----------
    state : State
        Poses of all items, with overlaps that fit them; changed.
    best : State
        Gets the poses of least overlap.
    boxes : ndarray
        (b, 4) float64, the boxes (see `boxes_of`).
    samples : int
        Samples of a move.
    passes : int
        The most passes.
    weights : tuple of float
        By which share the weight of an overlapping pair grows, for all pairs and in addition for
        the deepest; and the factor of the weight of a pair that does not overlap.
    rng : ndarray
        (1,) uint64, the state of the generator.

    Returns
    -------
    float
        The least total overlap, unweighted: weights change with each pass, so that weighted sums
        of two passes could not be compared.
    """
    count = state.movable
    least = total_overlap(problem, state)
    _copy_poses(state, best)
    turned, places = state.turned.copy(), state.places.copy()
    overlaps = state.overlaps.copy()
    order = np.arange(count)
    for _ in range(passes):
        if least == 0:
            break
        shuffle(order, rng)
        for k in range(count):
            i = order[k]
            if state.overlaps[i].max() > 0:
                _move(problem, state, i, boxes, samples, rng)
                update_overlaps(problem, state, i)
        total = total_overlap(problem, state)
        if total > 0:
            turned[:], places[:], overlaps[:] = state.turned, state.places, state.overlaps
            push_apart(problem, state, boxes)
            pushed = total_overlap(problem, state)
            if pushed >= total:  # put back; overlaps are copied, since computing them costs more
                for i in range(count):
                    if state.inside[i]:
                        put(problem.lookup, state, i, turned[i], places[i])
                state.overlaps[:] = overlaps
            if state.overlaps.max() < DEEP:  # nearly apart: the surfaces may already agree
                allow_contacts(problem, state)
            total = total_overlap(problem, state)
        if total < least:
            least = total
            _copy_poses(state, best)
        _reweight(state, state.overlaps.max(), weights)
    return least


@allocating_kernel
def _copy_poses(state, other):
    other.inside[:] = state.inside
    other.turned[:] = state.turned
    other.places[:] = state.places


@inner_kernel
def _reweight(state, most, weights):
    """Let the weights of pairs that overlap grow, the deeper the more, and the others decay."""
    least, deepest, decay = weights
    for i in range(len(state.types)):
        for j in range(i):
            found = state.overlaps[i, j]
            weight = max(1.0, state.weights[i, j] * decay)
            if found > 0:
                weight = state.weights[i, j] * (1 + least + deepest * found / most)
            state.weights[i, j] = weight
            state.weights[j, i] = weight
