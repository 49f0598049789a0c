"""Kernels that find the items in conflict, by their surfaces, and correct stored distances by it.

Stored distances (`overlap_kernels`, `distance_kernels`) are estimates: they may see an overlap
where the surfaces have none, and none where they cross. A *margin* for each pair corrects them: a
pair overlaps where its distance is below its margin. A conflict that the distances missed raises
the margin above the present distance, so that the separation has something to remove; a pair that
the surfaces find apart lowers it to the present distance, so that bowls may nest deeper than their
fields allow. The method is our own. A conflict is what makes a packing invalid (`validity`): two
surfaces that cross or are closer than the clearance, or one item inside the other.

Invariants: margins are symmetric, and only these kernels and a construction change them. They are
right near the present offset of a pair alone, so that a separation asks `load` again and again
until it finds no conflict.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inlined, inner_kernel, kernel
from packit_sim.parts.nesting.cost_kernels import distance_of, offset, update_overlaps
from packit_sim.parts.nesting.overlap_kernels import in_conflict
from packit_sim.parts.nesting.pose_kernels import NO_LIMIT, apart, clamp, put, take_out

DEEP = 0.3
"""Voxels of depth from which on a pair is taken to be in conflict without asking the surfaces."""

BUMP = 0.01
"""Voxels by which a margin grows at first; then it doubles each time the conflict remains."""


@inlined
def find_conflicts(problem, state, i, count):
    """Find the items in conflict with one, by the surfaces, and let their margins grow.

    Margins of pairs that overlap by fields or points, but not by the surfaces, shrink.

    Parameters
    ----------
    state : State
        Poses of all items; its margins are changed.
    i : int
        The item.
    count : int
        The other items have smaller numbers.

    Returns
    -------
    int
        Their number.
    """
    found = 0
    for j in range(count):
        if i == j or apart(state, i, j):
            continue
        distance = distance_of(problem, state, i, state.turned[i], state.places[i], j)[0]
        if distance == NO_LIMIT:  # farther by fields than these are ever wrong
            continue
        if _is_conflict(problem, state, i, j, distance):
            # Above the distance, so that the pair overlaps; doubled, so that few repetitions do.
            margin = max(distance, state.margins[i, j], 2 * state.margins[i, j]) + BUMP
            state.margins[i, j] = margin
            state.margins[j, i] = margin
            found += 1
        elif distance < state.margins[i, j]:  # an overlap by distances alone: allow it
            state.margins[i, j] = state.margins[j, i] = distance
    return found


@inlined
def allow_contacts(problem, state):
    """Let pairs overlap a little that are not in conflict by the surfaces: their margins shrink.

    Parameters
    ----------
    state : State
        Poses of all items, with overlaps; margins and overlaps are changed.
    """
    for i in range(len(state.types)):
        for j in range(i):
            if not 0 < state.overlaps[i, j] < DEEP:
                continue
            distance = distance_of(problem, state, i, state.turned[i], state.places[i], j)[0]
            if not _is_conflict(problem, state, i, j, distance):
                state.margins[i, j] = state.margins[j, i] = distance
                state.overlaps[i, j] = state.overlaps[j, i] = 0


@inlined
def _is_conflict(problem, state, i, j, distance):
    """Return whether two items at a distance in voxels are in conflict by their surfaces."""
    first, other, rel, sx, sy, sz = offset(
        problem.lookup, state, i, state.turned[i], state.places[i], j
    )
    # One can only be inside the other where the distance is negative, up to half a voxel of error.
    return in_conflict(problem, first, other, rel, sx, sy, sz, distance < 0.5)


@inner_kernel
def _rotation_in_box(problem, a, o, p, boxes):
    """Move a place (3,) into its box; return a rotation in which the item fits there, or -1."""
    if clamp(problem.lookup, a, o, p, boxes):
        return o
    for k in range(problem.allowed_counts[a]):
        if clamp(problem.lookup, a, problem.allowed[a, k], p, boxes):
            return problem.allowed[a, k]
    return -1


@kernel
def load(problem, state, turned, places, boxes, is_checked):
    """Put the items that are inside at given poses, moved into their boxes; take out the others.

    Obstacles stay where they are. An item that does not fit into its box takes another rotation; if
    it fits in none of its own, it is taken out.

    Parameters
    ----------
    state : State
        Poses of all items; changed.
    turned : ndarray
        (n,) int64, the numbers of their rotations.
    places : ndarray
        (n, 3) float64, the places of their origins.
    boxes : ndarray
        (b, 4) float64, the boxes (see `boxes_of`).
    is_checked : bool
        True to find all conflicts by the surfaces; margins grow, so that these pairs overlap.

    Returns
    -------
    int
        The number of conflicts that were found.
    """
    lookup = problem.lookup
    p = np.empty(3)
    for i in range(len(state.types)):
        if not state.inside[i]:
            take_out(state, i)
            state.turned[i] = turned[i]
            state.places[i] = places[i]
            continue
        a, o = state.types[i], turned[i]
        p[:] = places[i]
        if i < state.movable:
            o = _rotation_in_box(problem, a, o, p, boxes)
        if o < 0:
            take_out(state, i)
        else:
            put(lookup, state, i, o, p)
    found = 0
    if is_checked:
        for i in range(len(state.types)):  # each pair once; two obstacles never
            if state.inside[i]:
                found += find_conflicts(problem, state, i, min(i, state.movable))
    # After all margins are final: an overlap is measured from its pair's margin.
    for i in range(state.movable):
        if state.inside[i]:
            update_overlaps(problem, state, i)
    return found
