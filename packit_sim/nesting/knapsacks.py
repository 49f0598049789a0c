"""The search for the most value in one box."""

from __future__ import annotations

import numpy as np

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.nesting.problem import Problem, boxes_of
from packit_sim.nesting.search import Search
from packit_sim.nesting.separation import Separation, constructed
from packit_sim.nesting.tasks import Poses, Solution, Task

_GROWTH, _DECAY = 1.2, 0.8
"""Factors of the share of value to gain, after a success and after a failure."""

_MOST, _LEAST = 0.1, 0.001
"""Largest and smallest share of value to gain at a time."""

_MOST_OUT = 2
"""Most items that are taken out for others."""


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
        self._share = _MOST

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a more valuable box."""
        self.best = solution
        self.is_done = bool(solution.poses.inside.all())

    def _constructed(self, problem: Problem) -> Solution:
        return self._solution(constructed(problem, self._task, [self._task.size], self._rng))

    def _begun(self, problem: Problem, best: Solution) -> Separation:
        return Separation(self._task, self._exchanged(problem, best.poses), self._boxes)

    def _end(self, problem: Problem, best: Solution, attempt: Separation, is_apart: bool) -> None:
        factor = _GROWTH if is_apart else _DECAY
        self._share = min(max(self._share * factor, _LEAST), _MOST)
        if is_apart:
            found = self._solution(attempt.least)
            if found.score < best.score:
                self.adopt(problem, found)

    def _value(self, poses: Poses) -> float:
        return float(self._task.values[poses.inside.astype(bool)].sum())

    def _solution(self, poses: Poses) -> Solution:
        return Solution((-self._value(poses),), poses, self._boxes)

    def _exchanged(self, problem: Problem, old: Poses) -> Poses:
        """Take out a few items, at random, and put others in at random poses, of more value."""
        task = self._task
        inside = old.inside.copy()
        out = self._choices.integers(_MOST_OUT + 1)
        inside[self._choices.permutation(np.flatnonzero(inside))[:out]] = 0
        most = float(np.prod(task.size)) - task.volumes[inside == 1].sum()
        goal = (1 + self._share) * self._value(old) - task.values[inside == 1].sum()
        added = []
        for i in self._choices.permutation(np.flatnonzero(inside == 0)):
            if goal <= 0:
                break
            if task.volumes[i] <= most:
                added.append(int(i))
                most -= task.volumes[i]
                goal -= task.values[i]
        return with_random_poses(
            problem, task, Poses(inside, old.turned, old.places), added, self._boxes, self._choices
        )


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
