"""What the searches for strips, knapsacks and bins have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from packit_sim.geometry.arrays import Ints
from packit_sim.parts.nesting.problem import Problem
from packit_sim.parts.nesting.separation import Separation
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask, Solution

FEWEST = 6
"""Fewest items that are searched for alone."""

FIRST_LEVELS = 0.2
"""Share of the search after which all items are searched for, at the latest."""


class NestSearch(ABC):
    """A search by attempts, which can resume in another process: it holds all that it needs.

    The most important items are arranged first. Whenever that finds nothing better, the number of
    items doubles: few items are arranged quickly, and large ones find no space later.

    Parameters
    ----------
    task : SearchTask
        The task.
    seed : int
        The seed.
    order : ndarray of int64, optional
        The items, the most important first; without it, or if the task has poses to begin with,
        all are searched for at once.

    Attributes
    ----------
    best : Solution or None
        The best solution so far; there is one after the first call of `advance`.
    is_done : bool
        Whether nothing better is possible.
    """

    def __init__(self, task: SearchTask, seed: int, order: Ints | None = None) -> None:
        self.best: Solution | None = None
        self.is_done = False
        self._task = task
        self._rng = np.array([seed], dtype=np.uint64)
        self._choices = np.random.default_rng(seed)
        self._is_begun = False
        self._attempt: Separation | None = None
        self._levels = [np.arange(task.count) if order is None else order]
        while order is not None and task.start is None and len(self._levels[0]) >= 2 * FEWEST:
            self._levels.insert(0, order[: len(self._levels[0]) // 2])
        self._level = 0

    def advance(self, problem: Problem, budget: SearchBudget) -> None:
        """Search until the budget is spent.

        Parameters
        ----------
        problem : Problem
            The problem.
        budget : SearchBudget
            The budget.
        """
        if not self._is_begun:
            self._is_begun = True
            self._offer(problem, self._constructed(problem))
        while self.best is not None and not self._is_over(budget):
            self._rebuild(problem, budget)
            attempt = self._attempt or self._begun(problem, self.best)
            self._attempt = attempt
            has_few_fields = len(problem.relative_turns) == 1  # whose values are used many times
            is_precise = has_few_fields or self._is_precise
            is_apart = attempt.advance(problem, self._rng, budget, is_precise)
            if is_apart is not None:
                self._attempt = None
                self._end(problem, self.best, attempt, is_apart)
            share = (self._level + 1) / max(1, len(self._levels) - 1)
            if not self._has_all and budget.progress > FIRST_LEVELS * share:
                self._attempt = None
                self._add_items(problem)

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a better solution.

        Parameters
        ----------
        problem : Problem
            The problem.
        solution : Solution
            The solution.
        """
        self.best = solution

    def _is_over(self, budget: SearchBudget) -> bool:
        return self.is_done or budget.is_spent

    def _offer(self, problem: Problem, solution: Solution) -> None:
        """Take over a solution if it is the best so far."""
        if self.best is None or solution.score < self.best.score:
            self.adopt(problem, solution)

    def restart(self) -> None:
        """Forget what was found, which is not valid: begin again with a construction."""
        self.best = None
        self.is_done = False
        self._is_begun = False
        self._attempt = None

    @property
    def _items(self) -> Ints:
        """The items that are searched for now."""
        return self._levels[self._level]

    @property
    def _has_all(self) -> bool:
        """Whether these are all items."""
        return self._level == len(self._levels) - 1

    @property
    def _is_precise(self) -> bool:
        """Whether surfaces compute the fields from the start of an attempt: few, exact moves."""
        return self._has_all

    @property
    def _later(self) -> list[Ints]:
        """The items of each level up to now that the one before does not have."""
        pairs = zip(self._levels[: self._level], self._levels[1:], strict=False)
        return [new[len(old) :] for old, new in pairs]

    def _own(self, poses: Poses) -> Poses:
        """Return poses without the items that are not searched for now."""
        inside = self._task.nowhere.inside
        inside[self._items] = poses.inside[self._items]
        return Poses(inside, poses.turned, poses.places)

    def _add_items(self, problem: Problem) -> None:
        """Go on with more items."""
        self._level += 1

    def _rebuild(self, problem: Problem, budget: SearchBudget) -> None:
        """Look for better solutions in another way, between attempts."""
        return  # only some searches have one

    @abstractmethod
    def _constructed(self, problem: Problem) -> Solution:
        """Return a first solution."""

    @abstractmethod
    def _begun(self, problem: Problem, best: Solution) -> Separation:
        """Begin an attempt at something better."""

    @abstractmethod
    def _end(self, problem: Problem, best: Solution, attempt: Separation, is_apart: bool) -> None:
        """Keep what an attempt found, if it is better, or learn from the failure."""
