"""Filling of boxes: construction, repair, rebuilding and random poses.

Algorithm: greedy construction with lowering, one item after the other, each at the lowest of some
sampled places (`construction_kernels`), an off-grid relative of bottom-left-back fill.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.cell_filling import filled_cells
from packit_sim.parts.nesting.cell_orders import hardest_first
from packit_sim.parts.nesting.conflict_kernels import load
from packit_sim.parts.nesting.construction_kernels import construct
from packit_sim.parts.nesting.pose_kernels import take_out
from packit_sim.parts.nesting.problem import Problem, State, boxes_of
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask

AT_ONCE = 8
"""Items of a construction between two looks at the clock."""


def loaded(
    problem: Problem, task: SearchTask, poses: Poses, boxes: Floats, is_checked: bool = False
) -> State:
    """Return a state with all items at given poses, moved into their boxes (see `load`)."""
    state = task.state(problem.has_fields)
    state.inside[:] = poses.inside
    load(problem, state, poses.turned, poses.places, boxes, is_checked)
    return state


def constructed(
    problem: Problem,
    task: SearchTask,
    sizes: Sequence[Sequence[float]],
    rng: npt.NDArray[np.uint64],
    budget: SearchBudget | None = None,
    order: Ints | None = None,
    side: float | None = None,
    is_complete: bool = False,
) -> Poses:
    """Construct a packing, box after box, around given first poses.

    Parameters
    ----------
    sizes : sequence of three floats
        The sides of each box.
    rng : ndarray of uint64, shape (1,)
        The state of the kernels' generator.
    budget : SearchBudget, optional
        As in `filled`.
    order : ndarray of int64, optional
        The items in their order, instead of that of the task, or the hardest first.
    side : float, optional
        The side of cells, if not `cell_side`; only for items as cells.
    is_complete : bool
        Whether all items are tried, also when the budget is late; only for items as cells.

    Returns
    -------
    Poses
        The poses; items for which there is no place are not inside.
    """
    boxes = boxes_of(sizes)
    poses = task.start or task.unplaced
    if order is None:
        order = hardest_first(problem, task) if problem.by_cells else task.order
    if problem.by_cells:
        end = None if is_complete else budget
        return filled_cells(problem, task, poses, boxes, order, rng, end, side)
    return filled(problem, task, poses, boxes, order, rng, budget)


def filled(
    problem: Problem,
    task: SearchTask,
    poses: Poses,
    boxes: Floats,
    order: Ints,
    rng: npt.NDArray[np.uint64],
    budget: SearchBudget | None = None,
) -> Poses:
    """Put in as many more items as fit, in one box after the other, without moving any.

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
        When it is late, no further items are tried, after the first `AT_ONCE`.

    Returns
    -------
    Poses
        The poses; items for which there is no place are not inside.
    """
    state = loaded(problem, task, poses, boxes)
    for k in range(len(boxes)):
        left = order[state.inside[order] == 0]
        for first in range(0, len(left), AT_ONCE):
            if budget is not None and first > 0 and budget.is_late:
                break
            waiting = left[first : first + AT_ONCE]
            box, samples = boxes[k : k + 1], task.settings.construction_samples
            while len(some := task.addable(state.inside, waiting)):
                construct(problem, state, some, box, samples, rng)
                waiting = waiting[~np.isin(waiting, some)]
    return Poses.of(state)


def rebuilt(
    problem: Problem,
    task: SearchTask,
    poses: Poses,
    boxes: Floats,
    choices: np.random.Generator,
    rng: npt.NDArray[np.uint64],
    budget: SearchBudget | None = None,
) -> Poses:
    """Take out a few items, neighbours or random ones, and fill the box again.

    Algorithm: ruin and recreate (Schrimpf et al., 2000). The ruin is radial (neighbours) or random;
    the recreation tries all items roughly in the task's order, with a random change of ranks.

    Parameters
    ----------
    poses : Poses
        The items' poses, without conflicts.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    choices : numpy.random.Generator
        Chooses the items and the order.
    rng : ndarray of uint64, shape (1,)
        The state of the kernels' generator.
    budget : SearchBudget, optional
        As in `filled`.

    Returns
    -------
    Poses
        The poses, without conflicts.
    """
    settings = task.settings
    packed = choices.permutation(np.flatnonzero(poses.inside[: task.count]))
    if choices.random() < settings.rebuilt_neighbours:
        ways = poses.places[packed] - poses.places[packed[:1]]
        packed = packed[np.linalg.norm(ways, axis=1).argsort(kind="stable")]
    goes = packed[: 1 + choices.integers(settings.max_rebuilt)]
    order = shuffled(task.order, settings.shuffle, choices)
    return filled(problem, task, poses.changed(goes, 0), boxes, order, rng, budget)


def shuffled(order: Ints, shuffle: float, choices: np.random.Generator) -> Ints:
    """Change the ranks of items at random, with a standard deviation as a share of their number."""
    n = len(order)
    ranks = np.arange(n) + choices.normal(0, shuffle * n, n)
    return order[ranks.argsort(kind="stable")]


def repaired(problem: Problem, task: SearchTask, poses: Poses, boxes: Floats) -> Poses:
    """Take out items until none is in conflict, each time the one with most overlap per value.

    Parameters
    ----------
    poses : Poses
        The items' poses.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.

    Returns
    -------
    Poses
        The poses, without conflicts.
    """
    state = loaded(problem, task, poses, boxes, is_checked=True)
    while state.overlaps.any():
        overlaps = state.overlaps[: task.count].sum(axis=1)
        # An item without value goes first, by a division that does not warn.
        take_out(state, int((overlaps / np.maximum(task.values, 1e-300)).argmax()))
    return Poses.of(state)


def tops(problem: Problem, task: SearchTask, poses: Poses) -> Floats:
    """Return how high each item and obstacle (n + m,) reaches."""
    found: Floats = poses.places[:, 2] + problem.lookup.boxes[task.numbers, poses.turned, 5]
    return found


def least_heights(problem: Problem, task: SearchTask) -> Floats:
    """Return the least height of each item (n,) in the container, infinite if it does not fit."""
    found = _least_heights(problem, task.size)
    return found[task.numbers[: task.count]]


def fitting(problem: Problem, task: SearchTask, boxes: Floats) -> npt.NDArray[np.bool_]:
    """Return a table (n, b): True where an item fits into a box that is empty."""
    sizes = [tuple(sides) for sides in boxes[:, 1:].tolist()]
    known = {size: np.isfinite(_least_heights(problem, size)) for size in set(sizes)}
    return np.column_stack([known[size] for size in sizes])[task.numbers[: task.count]]


def _least_heights(problem: Problem, size: Sequence[float]) -> Floats:
    """Return the least height of each type in an empty box, infinite if it does not fit."""
    lookup = problem.lookup
    sides = lookup.boxes[..., 3:] - lookup.boxes[..., :3]
    fits = (sides <= np.array(size) + max(lookup.slack, 0.0)).all(axis=2)
    heights = np.where(fits, sides[..., 2], np.inf)
    rows = zip(heights, problem.allowed, problem.allowed_counts, strict=True)
    return np.array([own[allowed[:count]].min() for own, allowed, count in rows])


def with_random_poses(
    problem: Problem,
    task: SearchTask,
    poses: Poses,
    items: list[int],
    boxes: Floats,
    choices: np.random.Generator,
) -> Poses:
    """Put items at random poses in boxes that they fit into.

    Parameters
    ----------
    poses : Poses
        The items' poses.
    items : list of int
        The items to put in.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    choices : numpy.random.Generator
        Chooses the poses.

    Returns
    -------
    Poses
        The poses, with overlaps.
    """
    inside, turned, places = poses.inside.copy(), poses.turned.copy(), poses.places.copy()
    fits = fitting(problem, task, boxes)
    for i in items:
        a = task.numbers[i]
        own: Ints = problem.allowed[a, : problem.allowed_counts[a]]
        turned[i] = choices.choice(own)
        possible = np.flatnonzero(fits[i])
        box = boxes[possible[choices.integers(len(possible))]]
        places[i] = choices.random(3) * box[1:] + (box[0], 0, 0)
        inside[i] = 1
    return Poses(inside, turned, places)
