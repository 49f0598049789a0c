"""Items put at poses, constructed packings, and attempts to move overlapping items apart."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.nesting.construction_kernels import construct
from packit_sim.nesting.cost_kernels import (
    ALL,
    NONE,
    clamp,
    put,
    take_out,
    update_overlaps,
)
from packit_sim.nesting.problem import Problem, State, boxes_of, state_of
from packit_sim.nesting.separation_kernels import separate
from packit_sim.nesting.tasks import Budget, Poses, Task

FIELD_ONLY = 2
"""Factor of the samples where these cost little, compared with what the best of them do."""

GAIN = 0.98
"""Share of the least overlap below which a pass counts as a gain."""


def load(problem: Problem, state: State, poses: Poses, boxes: Floats, reach: float = ALL) -> bool:
    """Put all items at some poses, moved into their boxes.

    Parameters
    ----------
    problem : Problem
        The problem.
    state : State
        Where all items are; changed.
    poses : Poses
        The poses.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    reach : float
        As for `fine_cost`.

    Returns
    -------
    bool
        Whether each item fits into its box, in another rotation if need be.
    """
    for i, a in enumerate(state.types):
        if not poses.inside[i]:
            take_out(state, i)
            state.turned[i], state.places[i] = poses.turned[i], poses.places[i]
            continue
        own = int(poses.turned[i])
        place = poses.places[i].copy()
        for o in (own, *problem.allowed[a, : problem.allowed_counts[a]].tolist()):
            if clamp(problem.lookup, a, o, place, boxes):
                put(problem.lookup, state, i, o, place)
                break
        else:
            return False
    for i in range(len(state.types)):
        update_overlaps(problem, state, i, reach)
    return True


def height_of(problem: Problem, poses: Poses, numbers: Ints) -> float:
    """Return how high the items inside reach; 0 without items."""
    tops = poses.places[:, 2] + problem.lookup.boxes[numbers, poses.turned, 5]
    return float(tops[poses.inside.astype(bool)].max(initial=0.0))


def constructed(
    problem: Problem, task: Task, sizes: Sequence[Sequence[float]], rng: npt.NDArray[np.uint64]
) -> Poses:
    """Place items, the largest first, in one box after the other.

    Parameters
    ----------
    problem : Problem
        The problem.
    task : Task
        The task.
    sizes : sequence of three floats
        The sides of each box.
    rng : ndarray of uint64, shape (1,)
        The state of the kernels' generator.

    Returns
    -------
    Poses
        The poses; items for which there is no place are not inside.
    """
    state = state_of(task.numbers.tolist())
    for i in range(len(task.numbers)):
        take_out(state, i)
    order = np.argsort(-task.volumes, kind="stable")
    boxes = boxes_of(sizes)
    for k in range(len(boxes)):
        left = order[state.inside[order] == 0]
        if len(left) == 0:
            break
        construct(problem, state, left, boxes[k : k + 1], task.settings.construction_samples, rng)
    return Poses.of(state)


def repaired(
    problem: Problem, task: Task, poses: Poses, boxes: Floats, rng: npt.NDArray[np.uint64]
) -> Poses:
    """Take out items until none is in conflict, then put others in where they fit.

    Parameters
    ----------
    problem : Problem
        The problem.
    task : Task
        The task.
    poses : Poses
        Where the items are.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    rng : ndarray of uint64, shape (1,)
        The state of the kernels' generator.

    Returns
    -------
    Poses
        The poses, without conflicts.
    """
    state = state_of(task.numbers.tolist())
    load(problem, state, poses, boxes)
    while state.overlaps.any():
        worst = int((state.overlaps.sum(axis=1) / np.maximum(task.values, 1e-300)).argmax())
        take_out(state, worst)
    order = np.argsort(-task.volumes, kind="stable")
    for k in range(len(boxes)):
        left = order[state.inside[order] == 0]
        construct(problem, state, left, boxes[k : k + 1], task.settings.construction_samples, rng)
    return Poses.of(state)


class Separation:
    """An attempt to move overlapping items apart, which can be interrupted.

    Parameters
    ----------
    task : Task
        The task.
    poses : Poses
        Where the items are at first.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    patience : int
        Passes without a gain after which it gives up.

    Attributes
    ----------
    least : Poses
        The poses of least overlap so far.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    """

    def __init__(self, task: Task, poses: Poses, boxes: Floats, patience: int) -> None:
        self.least = poses
        self.boxes = boxes
        self._task = task
        self._patience = patience
        self._idle = 0
        self._overlap = math.inf
        self._reach = NONE
        self._state: State | None = None

    def swap(self, i: int, j: int) -> None:
        """Let two items change places before the attempt begins."""
        places = self.least.places.copy()
        places[[i, j]] = places[[j, i]]
        self.least = Poses(self.least.inside, self.least.turned, places)

    def advance(self, problem: Problem, rng: npt.NDArray[np.uint64], budget: Budget) -> bool | None:
        """Go on until the items are apart, or it gives up, or the budget is spent.

        Parameters
        ----------
        problem : Problem
            The problem.
        rng : ndarray of uint64, shape (1,)
            The state of the kernels' generator.
        budget : Budget
            The budget.

        Returns
        -------
        bool or None
            Whether `least` has no conflict; None if that is still open.
        """
        if self._state is None:
            self._reach = problem.near
            self._state = state_of(self._task.numbers.tolist())
            if not load(problem, self._state, self.least, self.boxes, self._reach):
                budget.take()
                return False
        found = state_of(self._task.numbers.tolist())
        samples = self._task.settings.samples * (1 if problem.refined else FIELD_ONLY)
        while self._idle < self._patience:
            if self._overlap == 0:
                if self._reach == ALL:
                    return True
                self._reach, self._overlap = ALL, math.inf
                load(problem, self._state, self.least, self.boxes)
            if budget.is_spent:
                return None
            passes = budget.take()
            overlap = separate(
                problem, self._state, found, self.boxes, samples, passes, self._reach, rng
            )
            self._idle = 0 if overlap < GAIN * self._overlap else self._idle + passes
            if overlap < self._overlap:
                self._overlap = overlap
                self.least = Poses.of(found)
        return False
