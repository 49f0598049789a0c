"""Kernels that move overlapping items until no two overlap: guided local search."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inlined, inner_kernel, kernel
from packit_sim.parts.nesting.conflict_kernels import DEEP, allow_contacts
from packit_sim.parts.nesting.cost_kernels import (
    fine_cost,
    rough_cost,
    total_overlap,
    update_overlaps,
)
from packit_sim.parts.nesting.pose_kernels import NO_LIMIT, clamp, put, random, sample
from packit_sim.parts.nesting.pushing_kernels import push_apart

KEPT = 4
"""Samples of a move that are improved by the fields as they are, besides the present pose."""

REFINED = 2
"""The best of these, which are improved by the surfaces."""

STEPS = 30
"""Most steps along the gradient of the fine cost."""

OVERSHOOT = 1.1
"""Factor of the steps to where the gradient says that the cost is 0."""

PATIENCE = 6
"""Steps without a gain of 2% after which these end."""

GROWTH = 0.05, 0.2
"""By which share the weight of a pair that overlaps grows: at least, and more for the deepest."""

DECAY = 0.95
"""Factor of the weight of a pair that does not overlap."""


@inner_kernel
def _next_trials(p, steps, trials, rng):
    """Write the places around one that a step of descent tries to `trials` (4, 3).

    Returns
    -------
    int
        Their number.
    int
        The axis of the step.
    int
        The second axis, or the same one.
    """
    d = int(random(rng) * 4)
    e = d
    if d == 3:
        d = int(random(rng) * 3)
        e = (d + 1) % 3
    count = 2 if d == e else 4
    for n in range(count):
        trials[n] = p
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
            for d in range(3):
                trial[d] = p[d] - OVERSHOOT * found / square * slope[d]
            if not clamp(problem.lookup, a, o, trial, boxes):  # a step into a box that is too small
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
    """Insert a sample into the sorted list of the best, unless a better one is close."""
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
                costs[m] = costs[m + 1]
                places[m] = places[m + 1]
                turned[m] = turned[m + 1]
            costs[KEPT - 1] = NO_LIMIT
            break
    if found >= costs[KEPT - 1]:
        return
    k = KEPT - 1
    while k > 0 and costs[k - 1] > found:
        costs[k] = costs[k - 1]
        places[k] = places[k - 1]
        turned[k] = turned[k - 1]
        k -= 1
    costs[k] = found
    places[k] = p
    turned[k] = o


@inlined
def _move(problem, state, i, boxes, samples, rng):
    """Move an item to the pose of least weighted overlap that is found.

    Poses near the present one and all over the container are sampled; the best few are improved,
    first by the fields as they are, then by the fine cost.
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
        if near:
            for d in range(3):
                p[d] = current[d] + (random(rng) + random(rng) - 1) * problem.reach[a]
        else:
            sample(lookup, a, o, p, boxes[int(random(rng) * len(boxes))], rng)
        if not clamp(lookup, a, o, p, boxes):
            continue
        found = rough_cost(lookup, state, i, o, p, costs[KEPT - 1])
        if found < costs[KEPT - 1]:
            _keep(costs, kept, kept_turned, found, o, p, 2 * lookup.voxel)
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
def separate(problem, state, best, boxes, samples, passes, rng):
    """Move overlapping items in passes; the weights of pairs that overlap grow.

    Parameters
    ----------
    problem : Problem
        The problem.
    state : State
        Where all items are; changed. Its overlaps must be up to date.
    best : State
        Gets the poses of least overlap.
    boxes : ndarray
        (b, 4) float64, the boxes (see `boxes_of`).
    samples : int
        Samples of a move.
    passes : int
        The most passes.
    rng : ndarray
        (1,) uint64, the state of the generator.

    Returns
    -------
    float
        The least total overlap.
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
        problem.counts[2] += 1
        for n in range(count - 1, 0, -1):
            m = int(random(rng) * (n + 1))
            order[n], order[m] = order[m], order[n]
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
            if pushed >= total:
                for i in range(count):
                    if state.inside[i]:
                        put(problem.lookup, state, i, turned[i], places[i])
                state.overlaps[:] = overlaps
            if state.overlaps.max() < DEEP:
                allow_contacts(problem, state)
            total = total_overlap(problem, state)
        if total < least:
            least = total
            _copy_poses(state, best)
        _reweight(state)
    return least


@inner_kernel
def _copy_poses(state, other):
    other.inside[:] = state.inside
    other.turned[:] = state.turned
    other.places[:] = state.places


@inner_kernel
def _reweight(state):
    """Let the weights of pairs that overlap grow, the deeper the more, and the others decay."""
    most = state.overlaps.max()
    for i in range(len(state.types)):
        for j in range(i):
            found = state.overlaps[i, j]
            weight = max(1.0, state.weights[i, j] * DECAY)
            if found > 0:
                weight = state.weights[i, j] * (1 + GROWTH[0] + GROWTH[1] * found / most)
            state.weights[i, j] = weight
            state.weights[j, i] = weight
