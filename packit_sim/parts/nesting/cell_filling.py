"""Filling of boxes with items as cells: each goes to the lowest place of all in a grid.

Algorithm: greedy construction by lowest tops, a relative of bottom-left-back fill, over all
positions of a fine grid and all rotations at once (`placement_kernels`). Each item then settles by
its surface, off the grid, before the next one is placed: that takes back what cells cost below it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.cells import Space, cells_of, least_side
from packit_sim.parts.nesting.conflict_kernels import load
from packit_sim.parts.nesting.pose_kernels import box_of, put
from packit_sim.parts.nesting.problem import Problem, State, boxes_of
from packit_sim.parts.nesting.settling_kernels import settle
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask

DENSITY = 0.33
"""Density by which the height of a strip is estimated, for the side of its cells."""

AT_ONCE = 32
"""Items that settle between two looks at the clock."""

ENOUGH = 0.02
"""Cells by which an item goes down on average in a sweep, if another one follows."""


def cell_side(problem: Problem, task: SearchTask) -> float:
    """Return the side of cells: a share of an item's, or larger if a box had too many cells."""
    settings = task.settings
    longest = 2 * problem.reach[task.numbers[: task.count]]
    volume = min(float(task.volumes.sum()) / DENSITY, float(np.prod(task.size)))
    most = settings.most_cells * task.count**0.5
    side = max(float(np.median(longest)) / settings.finest_cells, (volume / most) ** (1 / 3))
    return least_side(problem, side)


def filled_cells(
    problem: Problem,
    task: SearchTask,
    poses: Poses,
    boxes: Floats,
    order: Ints,
    rng: npt.NDArray[np.uint64],
    budget: SearchBudget | None = None,
    side: float | None = None,
) -> Poses:
    """Put in as many more items as fit, in one box after the other, without moving the others.

    Parameters
    ----------
    poses : Poses
        The items' poses, without conflicts.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    order : ndarray of int64
        The items to try, in this order; those inside are skipped.
    rng : ndarray of uint64, shape (1,)
        The state of the kernels' generator.
    budget : SearchBudget, optional
        When it is late, no further items are tried, after the first.
    side : float, optional
        The side of cells, if not `cell_side`.

    Returns
    -------
    Poses
        The poses; items for which there is no place or no time are not inside.
    """
    settings = task.settings
    cells = cells_of(problem, side or cell_side(problem, task))
    grow = problem.lookup.clearance / 2
    first, last = (step * cells.side for step in settings.settling_steps)
    state = task.state(problem.has_fields)
    state.inside[:] = poses.inside
    load(problem, state, poses.turned, poses.places, boxes, False)
    for k, box in enumerate(boxes):
        left = order[state.inside[order] == 0].tolist()
        if not left:
            break
        space = Space(cells, box)
        for i in np.flatnonzero(state.inside).tolist():
            if box_of(boxes, state.places[i, 0]) == k:
                space.put(_placed(problem, state, i), grow)
        for n, i in enumerate(left):
            if budget is not None and n > 0 and budget.is_late:
                return Poses.of(state)
            a = state.types[i]
            found = space.lowest(a, problem.allowed[a, : problem.allowed_counts[a]])
            if found is not None:
                put(problem.lookup, state, i, *found)
                own = np.array([i])
                settle(problem, state, boxes, own, first, last, settings.settling_tries, rng)
                space.put(_placed(problem, state, i), grow)
    return Poses.of(state)


def _placed(problem: Problem, state: State, i: int) -> Floats:
    """Return the triangles (n, 3, 3) of an item at its place."""
    starts = problem.surfaces.triangle_starts
    own = problem.surfaces.other[starts[state.types[i]] : starts[state.types[i] + 1]]
    placed: Floats = own @ problem.lookup.turns[state.turned[i]].T + state.places[i]
    return placed


def settle_all(
    problem: Problem,
    task: SearchTask,
    state: State,
    rng: npt.NDArray[np.uint64],
    budget: SearchBudget | None = None,
) -> None:
    """Lower all items until that gains little.

    Parameters
    ----------
    state : State
        Poses of all items, without conflicts; changed.
    rng : ndarray of uint64, shape (1,)
        The state of the kernels' generator.
    budget : SearchBudget, optional
        When it is late, the other items stay where they are.
    """
    settings = task.settings
    side, boxes = cell_side(problem, task), boxes_of([task.size])
    first, last = (step * side for step in settings.settling_steps)
    for _ in range(settings.settling_sweeps):
        inside = np.flatnonzero(state.inside[: task.count])
        order = inside[np.argsort(state.bounds[inside, 2], kind="stable")]
        way = 0.0
        for start in range(0, len(order), AT_ONCE):
            if budget is not None and budget.is_late:
                return
            some = order[start : start + AT_ONCE]
            way += settle(problem, state, boxes, some, first, last, settings.settling_tries, rng)
        if way < ENOUGH * side * len(order):
            return
