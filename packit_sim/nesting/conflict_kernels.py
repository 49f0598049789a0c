"""Kernels that find the items in conflict, by their surfaces."""

from __future__ import annotations

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.nesting.cost_kernels import distance_of, offset, update_all_overlaps
from packit_sim.nesting.overlap_kernels import in_conflict
from packit_sim.nesting.pose_kernels import NO_LIMIT, apart

DEEP = 0.3
"""Voxels of depth from which on there is a conflict."""

BUMP = 0.01
"""Voxels by which a margin grows at first, and then twice as much each time."""


@inner_kernel
def find_conflicts(problem, state, i, count):
    """Find the items in conflict with one, by the surfaces, and let their margins grow.

    Parameters
    ----------
    problem : Problem
        The problem.
    state : State
        Where all items are; its margins are changed.
    i : int
        The item.
    count : int
        The other items have smaller numbers.

    Returns
    -------
    int
        How many there are.
    """
    found = 0
    o, p = state.turned[i], state.places[i]
    for j in range(count):
        if i == j or apart(state, i, j):
            continue
        distance = distance_of(problem, state, i, o, p, j)[0]
        if distance == NO_LIMIT:
            continue
        if distance >= -DEEP:
            first, other, rel, sx, sy, sz = offset(problem.lookup, state, i, o, p, j)
            if not in_conflict(problem, first, other, rel, sx, sy, sz, distance < 0.5):
                continue
        margin = max(distance, state.margins[i, j], 2 * state.margins[i, j]) + BUMP
        state.margins[i, j] = margin
        state.margins[j, i] = margin
        found += 1
    return found


@kernel
def find_all_conflicts(problem, state):
    """Find all items in conflict, by the surfaces; these pairs then overlap, as margins grow.

    Parameters
    ----------
    problem : Problem
        The problem.
    state : State
        Where all items are; its margins and overlaps are changed.

    Returns
    -------
    int
        The number of conflicts.
    """
    found = 0
    for i in range(len(state.types)):
        if state.inside[i]:
            found += find_conflicts(problem, state, i, i)
    if found:
        update_all_overlaps(problem, state)
    return found


@inner_kernel
def allow_contacts(problem, state):
    """Let pairs overlap a little that are not in conflict by the surfaces: their margins shrink.

    Parameters
    ----------
    problem : Problem
        The problem.
    state : State
        Where all items are, with their overlaps; margins and overlaps are changed.
    """
    for i in range(len(state.types)):
        for j in range(i):
            if not 0 < state.overlaps[i, j] < DEEP:
                continue
            o, p = state.turned[i], state.places[i]
            distance = distance_of(problem, state, i, o, p, j)[0]
            first, other, rel, sx, sy, sz = offset(problem.lookup, state, i, o, p, j)
            if not in_conflict(problem, first, other, rel, sx, sy, sz, distance < 0.5):
                state.margins[i, j] = state.margins[j, i] = distance
                state.overlaps[i, j] = state.overlaps[j, i] = 0
