"""Kernels that lower or slide items by steps that the surfaces allow, and count conflicts.

Settling takes out the space that a grid of cells leaves: items go down by steps, straight or also
aside, each of which `in_conflict` finds free at its end. A step may pass through others: a packing
is what counts, not the way to it. Steps shrink until they gain nothing. This is our own.

Sliding moves items along one axis until their centre of gravity is where it is wanted.

Invariants: items that are free of conflicts stay so when they settle or slide, and none gets higher
when they settle.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.parts.nesting.cost_kernels import list_near_pose, offset
from packit_sim.parts.nesting.overlap_kernels import in_conflict
from packit_sim.parts.nesting.pose_kernels import apart, clamp, put, random

LEAST = 0.2
"""Share of the last step by which a step must be lower: at the floor nothing is tried."""


@kernel
def settle(problem, state, boxes, order, first, last, tries, rng):
    """Lower items one after the other, by steps that are free.

    Parameters
    ----------
    state : State
        Poses of all items, without conflicts; changed.
    boxes : ndarray
        (b, 4) float64, the boxes (see `boxes_of`).
    order : ndarray
        (n,) int64, the items, the lowest first.
    first, last : float
        The first steps, and those after which an item stays.
    tries : int
        Steps that also go aside, after the straight one.
    rng : ndarray
        (1,) uint64, the state of the generator.

    Returns
    -------
    float
        How far they went down in total.
    """
    lookup = problem.lookup
    p = np.empty(3)
    total = 0.0
    for i in order:
        a, o = state.types[i], state.turned[i]
        place = state.places[i].copy()
        start = place[2]
        step = first
        blocking = -1
        while step > last:
            is_lower = False
            for n in range(1 + tries):
                p[:] = place
                p[2] -= step
                if n > 0:
                    angle = 2 * np.pi * random(rng)
                    way = 2 * step * random(rng)
                    p[0] += way * np.cos(angle)
                    p[1] += way * np.sin(angle)
                if not clamp(lookup, a, o, p, boxes) or p[2] > place[2] - LEAST * last:
                    continue
                found = _blocking(problem, state, i, o, p, blocking)
                if found < 0:
                    place[:] = p
                    is_lower = True
                    break
                blocking = found
            if not is_lower:
                step *= 0.5
        if place[2] < start:
            total += start - place[2]
            put(lookup, state, i, o, place)
    return total


@kernel
def slide(problem, state, boxes, order, axis, weights, moment, farthest, last):
    """Slide items along an axis, one after the other, by steps that are free.

    Parameters
    ----------
    state : State
        Poses of all items, without conflicts; changed.
    boxes : ndarray
        (b, 4) float64, the boxes (see `boxes_of`).
    order : ndarray
        (k,) int64, the items, those first that are farthest ahead.
    axis : int
        The axis.
    weights : ndarray
        (n,) float64, the weight of each item.
    moment : float
        The sum that is wanted of the items' ways, each times its weight; its sign is the direction.
    farthest : float
        The longest way of an item.
    last : float
        The step after which an item stays.
    """
    p = np.empty(3)
    sign = 1.0 if moment > 0 else -1.0
    wanted = abs(moment)
    for i in order:
        if weights[i] <= 0:
            continue
        a, o = state.types[i], state.turned[i]
        place = state.places[i].copy()
        start = place[axis]
        left = min(wanted / weights[i], farthest)
        step = left
        blocking = -1
        while step > last and left > 0:
            p[:] = place
            p[axis] += sign * min(step, left)
            fits = clamp(problem.lookup, a, o, p, boxes)
            way = sign * (p[axis] - place[axis])
            found = _blocking(problem, state, i, o, p, blocking) if fits and way > 0 else i
            if found < 0:
                place[:] = p
                left -= way
            else:
                blocking = -1 if found == i else found
                step *= 0.5
        if place[axis] != start:
            wanted -= weights[i] * sign * (place[axis] - start)
            put(problem.lookup, state, i, o, place)


@inner_kernel
def _blocking(problem, state, i, o, p, first_tried):
    """Return an item that an item at a pose is in conflict with, or -1; one may be tried first."""
    lookup = problem.lookup
    count = list_near_pose(lookup, state, i, o, p)
    for n in range(-1, count):
        j = first_tried if n < 0 else state.near[n]
        if j < 0 or not state.meets[j] or (n >= 0 and j == first_tried):
            continue
        first, other, rel, sx, sy, sz = offset(lookup, state, i, o, p, j)
        if in_conflict(problem, first, other, rel, sx, sy, sz, True):
            return j
    return -1


@kernel
def count_conflicts(problem, state):
    """Return the number of pairs of items inside that are in conflict."""
    found = 0
    for i in range(state.movable):
        for j in range(len(state.types)):
            if j >= i and j < state.movable:  # each pair once
                continue
            if state.inside[i] and state.inside[j] and not apart(state, i, j):
                found += are_in_conflict(problem, state, i, j)
    return found


@inner_kernel
def are_in_conflict(problem, state, i, j):
    """Return whether two items are in conflict where they are."""
    first, other, rel, sx, sy, sz = offset(
        problem.lookup, state, i, state.turned[i], state.places[i], j
    )
    return in_conflict(problem, first, other, rel, sx, sy, sz, True)
