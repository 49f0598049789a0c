"""What the searches for strips, knapsacks and bins have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from packit_sim.nesting.problem import Problem
from packit_sim.nesting.separation import Separation
from packit_sim.nesting.tasks import Budget, Solution, Task


class Search(ABC):
    """A search by attempts, which can go on in another process: all that it needs is in it.

    Parameters
    ----------
    task : Task
        The task.
    seed : int
        The seed.

    Attributes
    ----------
    best : Solution or None
        The best solution so far; there is one after the first call of `advance`.
    is_done : bool
        Whether nothing better is possible.
    """

    def __init__(self, task: Task, seed: int) -> None:
        self.best: Solution | None = None
        self.is_done = False
        self._task = task
        self._rng = np.array([seed], dtype=np.uint64)
        self._choices = np.random.default_rng(seed)
        self._attempt: Separation | None = None

    def advance(self, problem: Problem, budget: Budget) -> None:
        """Search until the budget is spent.

        Parameters
        ----------
        problem : Problem
            The problem.
        budget : Budget
            The budget.
        """
        if self.best is None:
            self.adopt(problem, self._constructed(problem))
        while self.best is not None and not (self.is_done or budget.is_spent):
            attempt = self._attempt or self._begun(problem, self.best)
            self._attempt = attempt
            is_apart = attempt.advance(problem, self._rng, budget)
            if is_apart is not None:
                self._attempt = None
                self._end(problem, self.best, attempt, is_apart)

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

    def restart(self) -> None:
        """Forget what was found, which is not valid: begin again with a construction."""
        self.best = None
        self.is_done = False
        self._attempt = None

    @abstractmethod
    def _constructed(self, problem: Problem) -> Solution:
        """Return a first solution."""

    @abstractmethod
    def _begun(self, problem: Problem, best: Solution) -> Separation:
        """Begin an attempt at something better."""

    @abstractmethod
    def _end(self, problem: Problem, best: Solution, attempt: Separation, is_apart: bool) -> None:
        """Keep what an attempt found, if it is better, or learn from the failure."""
