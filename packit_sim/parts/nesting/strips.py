"""The search for the lowest strip: shrink it and move the items apart."""

from __future__ import annotations

import math

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.parts.nesting.compaction import compacted, shaken
from packit_sim.parts.nesting.filling import (
    constructed,
    filled,
    least_heights,
    tops,
    with_random_poses,
)
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.search import Attempt, NestSearch
from packit_sim.parts.nesting.separation import Separation
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask, Solution


class StripSearch(NestSearch):
    """A search for the lowest strip: shrink it, move the items apart, and repeat.

    Algorithm: strip packing as a sequence of separations at decreasing heights (Egeblad et al.,
    2009). As in sparrow (Gardeyn et al., 2025), the attempt after a failure continues from the
    failed poses, disrupted by exchanging two large items that differ. Our own are the step sizes,
    which adapt to successes and failures, and the strip's growth when more items join.
    """

    finishes = True

    def __init__(self, task: SearchTask, seed: int) -> None:
        super().__init__(task, seed, np.argsort(-task.volumes, kind="stable"))
        self._current: Poses | None = None
        self._height = self._target = math.inf
        self._shrink = task.settings.shrink
        self._failed: Poses | None = None
        self._has_space = True
        self._more_space = task.settings.more_space
        self._heights = np.zeros(task.count)

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a lower strip."""
        self.best = solution
        self.is_done = solution.score[0] <= self._least_height() + problem.lookup.slack
        if self._has_all and solution.score[0] < self._height:
            self._current, self._height = solution.poses, solution.score[0]
            self._failed = None
            self._has_space = True
            if solution.score[0] <= self._target:
                self._attempt = None

    def finished(self, problem: Problem, budget: SearchBudget) -> Solution | None:
        """Return the lowest strip after moves of all its items at once; each takes a pass."""
        best, settings = self.best, self._task.settings
        if best is None or self.is_done or not best.poses.inside.all():
            return best
        given = problem, self._task
        moves = budget.take(settings.finishing_moves)
        poses = compacted(*given, best.poses, best.boxes, moves, budget)
        for _ in range(budget.take(settings.finishing_shakes) if moves else 0):
            if budget.is_late:
                break
            poses = shaken(*given, poses, best.boxes, self._choices, budget)
            poses = compacted(*given, poses, best.boxes, moves, budget)
        return self._solution(problem, poses)

    def _constructed(self, problem: Problem) -> Solution:
        self._heights = least_heights(problem, self._task)
        solution = self._solution(
            problem, constructed(problem, self._task, [self._task.size], self._rng)
        )
        self._current = self._own(solution.poses)
        self._height = self._height_of(problem, self._current)
        return solution

    def _begun(self, problem: Problem, best: Solution) -> Separation:
        settings = self._task.settings
        if self._has_space:
            least = self._least_height()
            self._target = max(self._height * (1 - self._shrink), least)
        start = self._failed or self._current
        is_disrupted = self._failed is not None and self._has_space
        if is_disrupted:
            restarts = self._choices.random() < settings.restart_probability
            start = self._current if restarts else start
        assert start is not None
        boxes = self._boxes(self._target)
        later = self._later if is_disrupted else ()
        most = settings.most_patience if self._has_all else settings.patience
        attempt = Separation(self._task, start, boxes, settings.patience, later, most)
        if is_disrupted:
            largest = self._items[: max(2, len(self._items) // 2)]
            i = int(self._choices.choice(largest))
            kinds = np.column_stack((self._task.numbers[largest], attempt.least.turned[largest]))
            others = largest[(kinds != kinds[largest == i]).any(axis=1)]
            if len(others):
                attempt.swap(i, int(self._choices.choice(others)))
        return attempt

    def _end(self, problem: Problem, best: Solution, attempt: Attempt, is_apart: bool) -> None:
        settings = self._task.settings
        if is_apart:
            if self._failed is None:
                self._shrink = min(self._shrink * settings.shrink_growth, settings.shrink)
            self._failed = None
            self._has_space = True
            self._current = attempt.least
            self._height = self._height_of(problem, attempt.least)
            if self._has_all:
                self._offer(problem, self._solution(problem, attempt.least))
        else:
            self._failed = attempt.least
            if self._has_space:
                self._shrink = max(self._shrink * settings.shrink_decay, self._least_shrink)
            else:
                self._target *= 1 + self._more_space
                self._more_space *= 2
        is_least = self._height <= self._least_height() + problem.lookup.slack
        is_full = is_least or self._shrink < settings.full_shrink
        if not self._has_all and self._has_space and is_full:
            self._add_items(problem)

    def _add_items(self, problem: Problem) -> None:
        """Add items where they fit, or at random poses; the strip grows by their volume's share."""
        if self._has_space:
            self._offer_all(problem)
        old = self._items
        height = self._height if self._has_space else self._target
        super()._add_items(problem)
        start = self._current if self._has_space else self._failed or self._current
        assert start is not None
        volumes = self._task.volumes
        more = float(volumes[self._items].sum() / volumes[old].sum())
        self._more_space = self._task.settings.more_space
        self._target = max(height * more * (1 + self._more_space), self._least_height())
        self._shrink = self._task.settings.shrink / 2
        self._failed = None
        self._has_space = False
        boxes = self._boxes(self._target)
        poses = filled(problem, self._task, start, boxes, self._items, self._rng)
        left = self._items[poses.inside[self._items] == 0].tolist()
        self._current = with_random_poses(problem, self._task, poses, left, boxes, self._choices)

    def _offer_all(self, problem: Problem) -> None:
        """Offer a packing already now: the other items placed around those that are arranged."""
        assert self._current is not None
        boxes = self._boxes(self._task.size[2])
        poses = filled(problem, self._task, self._current, boxes, self._task.order, self._rng)
        self._offer(problem, self._solution(problem, poses))

    def _solution(self, problem: Problem, poses: Poses) -> Solution:
        height = self._height_of(problem, poses)
        return Solution((height,), poses, self._boxes(height))

    @property
    def _is_precise(self) -> bool:
        return super()._is_precise and self._has_space

    @property
    def _least_shrink(self) -> float:
        """The smallest share by which the strip shrinks: small steps are for the end.

        An attempt at a hardly lower strip fails nearly as often as one at a strip that is lower by
        1%, and what it gains is less.
        """
        settings, budget = self._task.settings, self._budget
        left = 1 - budget.progress if self._has_all and budget is not None else 0.0
        return max(settings.least_shrink, settings.early_shrink * left)

    def _boxes(self, height: float) -> Floats:
        x, y, _ = self._task.size
        return boxes_of([(x, y, height)])

    def _height_of(self, problem: Problem, poses: Poses) -> float:
        """Return the height of the highest item; 0 without items."""
        own = slice(self._task.count)
        inside = poses.inside[own] > 0
        return float(tops(problem, self._task, poses)[own][inside].max(initial=0.0))

    def _least_height(self) -> float:
        """Return a lower bound of the height: by the items' volume, and by each item alone."""
        x, y, _ = self._task.size
        volume = float(self._task.volumes[self._items].sum())
        return max(volume / (x * y), float(self._heights[self._items].max()))
