"""Kernels that move overlapping items until no two overlap: guided local search."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.nesting.cost_kernels import (
    NO_LIMIT,
    NONE,
    clamp,
    fine_cost,
    put,
    random,
    rough_cost,
    sample,
    total_overlap,
    update_overlaps,
)

KEPT = 4
"""Samples of a move that are improved by the fields as they are, besides the present pose."""

REFINED = 2
"""The best of these, which are improved by the surfaces."""


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


@inner_kernel
def _rough_descent(lookup, state, i, o, p, found, boxes, rng):
    """Improve a place by coordinate descent of the rough cost; return its cost."""
    trials = np.empty((4, 3))
    steps = np.full(3, lookup.voxel)
    a = state.types[i]
    while found > 0 and max(steps[0], steps[1], steps[2]) > 0.3 * lookup.voxel:
        count, d, e = _next_trials(p, steps, trials, rng)
        best = -1
        for n in range(count):
            clamp(lookup, a, o, trials[n], boxes)
            other = rough_cost(lookup, state, i, o, trials[n], found)
            if other < found:
                found = other
                best = n
        if best >= 0:
            p[:] = trials[best]
        _scale_steps(steps, d, e, best >= 0)
    return found


@inner_kernel
def _fine_descent(problem, state, i, o, p, found, boxes, reach, rng):
    """Improve a place by coordinate descent of the fine cost; return its cost."""
    lookup = problem.lookup
    trials = np.empty((4, 3))
    steps = np.full(3, 0.4 * lookup.voxel)
    a = state.types[i]
    while found > 0 and max(steps[0], steps[1], steps[2]) > problem.least_step:
        count, d, e = _next_trials(p, steps, trials, rng)
        best = -1
        for n in range(count):
            clamp(lookup, a, o, trials[n], boxes)
            other = fine_cost(problem, state, i, o, trials[n], found, reach)
            if other < found:
                found = other
                best = n
        if best >= 0:
            p[:] = trials[best]
        _scale_steps(steps, d, e, best >= 0)
    return found


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


@inner_kernel
def move(problem, state, i, boxes, samples, reach, rng):
    """Move an item to the pose of least weighted overlap that is found.

    Poses near the present one and all over the container are sampled; the best few are improved,
    first by the fields as they are, then by the surfaces.

    Parameters
    ----------
    problem : Problem
        The problem.
    state : State
        Where all items are; changed.
    i : int
        The item.
    boxes : ndarray
        (b, 4) float64, the boxes (see `boxes_of`).
    samples : int
        The number of samples.
    reach : float
        As for `fine_cost`.
    rng : ndarray
        (1,) uint64, the state of the generator.

    Returns
    -------
    float
        Its weighted overlap there.
    """
    lookup = problem.lookup
    a = state.types[i]
    costs = np.full(KEPT + 1, NO_LIMIT)
    kept = np.empty((KEPT + 1, 3))
    kept_turned = np.zeros(KEPT + 1, np.int64)
    p = np.empty(3)
    current = state.places[i].copy()
    turned = state.turned[i]
    before = fine_cost(problem, state, i, turned, current, NO_LIMIT, reach)
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
        found = fine_cost(problem, state, i, o, p, NO_LIMIT, NONE)
        if found > 0:
            found = _fine_descent(problem, state, i, o, p, found, boxes, NONE, rng)
        if found == 0:
            found = fine_cost(problem, state, i, o, p, NO_LIMIT, reach)
            if found > 0:
                found = _fine_descent(problem, state, i, o, p, found, boxes, reach, rng)
        if found < least:
            least, least_turned = found, o
            best[:] = p
            if found == 0:
                break
    if least < before:
        put(lookup, state, i, least_turned, best)
    return least


@kernel
def separate(problem, state, best, boxes, samples, passes, reach, rng):
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
    reach : float
        As for `fine_cost`.
    rng : ndarray
        (1,) uint64, the state of the generator.

    Returns
    -------
    float
        The least total overlap.
    """
    count = len(state.types)
    least = total_overlap(problem, state)
    _copy_poses(state, best)
    order = np.arange(count)
    for _ in range(passes):
        if least == 0:
            break
        problem.counts[2] += 1
        for n in range(count - 1, 0, -1):
            m = int(random(rng) * (n + 1))
            order[n], order[m] = order[m], order[n]
        for i in order:
            if state.overlaps[i].max() > 0:
                move(problem, state, i, boxes, samples, reach, rng)
                update_overlaps(problem, state, i, reach)
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
            if found > 0:
                weight = state.weights[i, j] * (1.2 + 0.8 * found / most)
            else:
                weight = max(1.0, state.weights[i, j] * 0.95)
            state.weights[i, j] = weight
            state.weights[j, i] = weight
