"""The search for the most value in one box."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.nesting.problem import Problem, boxes_of
from packit_sim.nesting.search import Search
from packit_sim.nesting.separation import Separation, constructed, repaired
from packit_sim.nesting.tasks import Poses, Solution, Task

_MOST_IN = 3
"""Most items that are put in at a time."""

_MOST_OUT = 2
"""Most items that are taken out for others at a time."""

_WORSE = 0.02
"""Share of the value by which a box may be worse than the best to go on from it."""


class KnapsackSearch(Search):
    """A search for the most value in one box: exchange items, move all apart, and again.

    Parameters
    ----------
    task : Task
        The task.
    seed : int
        The seed.
    """

    def __init__(self, task: Task, seed: int) -> None:
        super().__init__(task, seed)
        self._boxes = boxes_of([task.size])
        self._current: Poses | None = None

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a more valuable box."""
        self.best = solution
        fits = fitting(problem, self._task.size)[self._task.numbers]
        self.is_done = bool((solution.poses.inside.astype(bool) | ~fits).all())

    def _constructed(self, problem: Problem) -> Solution:
        return self._solution(constructed(problem, self._task, [self._task.size], self._rng))

    def _begun(self, problem: Problem, best: Solution) -> Separation:
        poses = self._exchanged(problem, self._current or best.poses)
        return Separation(self._task, poses, self._boxes, self._task.settings.exchange_patience)

    def _end(self, problem: Problem, best: Solution, attempt: Separation, is_apart: bool) -> None:
        poses = repaired(problem, self._task, attempt.least, self._boxes, self._rng)
        found = self._solution(poses)
        if found.score < best.score:
            self.adopt(problem, found)
        is_good = self._value(poses) >= (1 - _WORSE * self._choices.random()) * -best.score[0]
        self._current = poses if is_good else best.poses

    def _value(self, poses: Poses) -> float:
        return float(self._task.values[poses.inside.astype(bool)].sum())

    def _solution(self, poses: Poses) -> Solution:
        return Solution((-self._value(poses),), poses, self._boxes)

    def _exchanged(self, problem: Problem, old: Poses) -> Poses:
        """Take out a few items, at random, and put others in at random poses."""
        inside = old.inside.copy()
        fits = fitting(problem, self._task.size)[self._task.numbers]
        left_out = self._choices.permutation(np.flatnonzero(fits & (inside == 0)))
        out = self._choices.permutation(np.flatnonzero(inside))
        inside[out[: self._choices.integers(_MOST_OUT + 1)]] = 0
        return with_random_poses(
            problem,
            self._task,
            Poses(inside, old.turned, old.places),
            left_out[: 1 + self._choices.integers(_MOST_IN)].tolist(),
            self._boxes,
            self._choices,
        )


def fitting(problem: Problem, size: tuple[float, float, float]) -> npt.NDArray[np.bool_]:
    """Return whether each type (t,) fits into a box in one of its rotations."""
    lookup = problem.lookup
    sides = lookup.boxes[..., 3:] - lookup.boxes[..., :3]
    fits = (sides <= np.array(size) + lookup.slack).all(axis=2)
    columns = np.arange(problem.allowed.shape[1]) < problem.allowed_counts[:, None]
    return np.asarray((np.take_along_axis(fits, problem.allowed, axis=1) & columns).any(axis=1))


def with_random_poses(
    problem: Problem,
    task: Task,
    poses: Poses,
    items: list[int],
    boxes: Floats,
    choices: np.random.Generator,
) -> Poses:
    """Put items at random poses in some boxes.

    Parameters
    ----------
    problem : Problem
        The problem.
    task : Task
        The task.
    poses : Poses
        Where all items are.
    items : list of int
        The items.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    choices : numpy.random.Generator
        Chooses the poses.

    Returns
    -------
    Poses
        The poses; those items are inside.
    """
    inside, turned, places = poses.inside.copy(), poses.turned.copy(), poses.places.copy()
    for i in items:
        a = task.numbers[i]
        own: Ints = problem.allowed[a, : problem.allowed_counts[a]]
        turned[i] = choices.choice(own)
        box = boxes[choices.integers(len(boxes))]
        places[i] = choices.random(3) * box[1:] + (box[0], 0, 0)
        inside[i] = 1
    return Poses(inside, turned, places)
