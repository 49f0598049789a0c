"""The search for the lowest strip."""

from __future__ import annotations

import math

import numpy as np

from packit_sim.nesting.problem import Problem, boxes_of
from packit_sim.nesting.search import Search
from packit_sim.nesting.separation import Separation, constructed, height_of
from packit_sim.nesting.tasks import Poses, Solution, Task

_GROWTH, _DECAY = 1.1, 0.7
"""Factors of the shrinkage after a success and after a failure."""

_FROM_BEST = 0.3
"""Probability of starting again from the best strip after a failure, not from the failed one."""


class StripSearch(Search):
    """A search for the lowest strip: shrink it, move the items apart, and again.

    Parameters
    ----------
    task : Task
        The task.
    seed : int
        The seed.
    """

    def __init__(self, task: Task, seed: int) -> None:
        super().__init__(task, seed)
        self._shrink = task.settings.shrink
        self._failed: Poses | None = None
        self._target = math.inf

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a lower strip; an attempt at a still lower one goes on."""
        self.best = solution
        self.is_done = solution.score[0] <= least_height(problem, self._task) + problem.lookup.slack
        if solution.score[0] <= self._target:
            self._attempt = None

    def _constructed(self, problem: Problem) -> Solution:
        return self._solution(
            problem, constructed(problem, self._task, [self._task.size], self._rng)
        )

    def _begun(self, problem: Problem, best: Solution) -> Separation:
        x, y, _ = self._task.size
        least = least_height(problem, self._task)
        self._target = max(best.score[0] * (1 - self._shrink), least)
        boxes = boxes_of([(x, y, self._target)])
        if self._failed is None:
            return Separation(self._task, best.poses, boxes, self._task.settings.patience)
        from_best = self._choices.random() < _FROM_BEST
        start = best.poses if from_best else self._failed
        attempt = Separation(self._task, start, boxes, self._task.settings.patience)
        largest = np.argsort(-self._task.volumes)[: max(2, len(self._task.volumes) // 2)]
        if len(largest) > 1:
            i, j = self._choices.choice(largest, 2, replace=False)
            attempt.swap(int(i), int(j))
        return attempt

    def _end(self, problem: Problem, best: Solution, attempt: Separation, is_apart: bool) -> None:
        settings = self._task.settings
        if not is_apart:
            self._shrink = max(self._shrink * _DECAY, settings.least_shrink)
            self._failed = attempt.least
            return
        if self._failed is None:
            self._shrink = min(self._shrink * _GROWTH, settings.shrink)
        self._failed = None
        self.adopt(problem, self._solution(problem, attempt.least))

    def _solution(self, problem: Problem, poses: Poses) -> Solution:
        height = height_of(problem, poses, self._task.numbers)
        x, y, _ = self._task.size
        return Solution((height,), poses, boxes_of([(x, y, height)]))


def least_height(problem: Problem, task: Task) -> float:
    """Return a height that no strip can be lower than: the items' volume, or one of them alone."""
    x, y, _ = task.size
    lookup = problem.lookup
    heights = [float(task.volumes.sum()) / (x * y)]
    for a in np.unique(task.numbers):
        own = problem.allowed[a, : problem.allowed_counts[a]]
        sides = lookup.boxes[a, own, 3:] - lookup.boxes[a, own, :3]
        fits = (sides[:, :2] <= np.array([x, y]) + lookup.slack).all(axis=1)
        heights.append(float(sides[fits, 2].min()))
    return max(heights)
