"""The base class of the searches for strips, knapsacks and bins."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Ints
from packit_sim.parts.nesting.problem import Problem
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask, Solution


class Attempt(Protocol):
    """An attempt to move overlapping items apart (see `Separation`).

    Attributes
    ----------
    least : Poses
        The poses of least overlap so far.
    """

    least: Poses

    def advance(
        self,
        problem: Problem,
        rng: npt.NDArray[np.uint64],
        budget: SearchBudget,
        is_precise: bool,
    ) -> bool | None:
        """Continue until the items are apart, the attempt gives up, or the budget is spent.

        Parameters
        ----------
        rng : ndarray of uint64, shape (1,)
            The state of the kernels' generator.
        is_precise : bool
            True to let the surfaces compute the nodes of fields even while much overlaps.

        Returns
        -------
        bool or None
            True if `least` has no conflict, False after giving up, None if the budget is spent.
        """


class NestSearch(ABC):
    """A search by attempts, which can resume in another process since it holds its whole state.

    Algorithm: construct a packing, then repeat: make it infeasible by asking for something better
    (`_begun`), separate the items (`Separation`), and keep or repair the result (`_end`). This is
    the outer loop of Egeblad et al. (2009) and of sparrow's exploration phase (Gardeyn et al.,
    2025). Our own is the order of the items: the most important ones are arranged first, and their
    number doubles whenever that finds nothing better. Few items are arranged quickly, and large
    ones would find no space later.

    Parameters
    ----------
    order : ndarray of int64, optional
        The items, the most important first. All are searched for at once without it, or if the
        task has poses to begin with.

    Attributes
    ----------
    best : Solution or None
        The best solution so far; there is one after the first call of `advance`.
    is_done : bool
        True if nothing better is possible.
    is_cut : bool
        True if the time was over before the first construction had tried all items.
    finishes : bool
        True if `finished` makes solutions better, for which some time is left.
    """

    finishes = False

    def __init__(self, task: SearchTask, seed: int, order: Ints | None = None) -> None:
        self.best: Solution | None = None
        self.is_done = False
        self.is_cut = False
        self._task = task
        self._rng = np.array([seed], dtype=np.uint64)
        self._choices = np.random.default_rng(seed)
        self._is_begun = False
        self._budget: SearchBudget | None = None  # of the round that runs
        self._attempt: Attempt | None = None
        self._levels = [np.arange(task.count) if order is None else order]
        fewest = 2 * task.settings.first_items
        while order is not None and task.start is None and len(self._levels[0]) >= fewest:
            self._levels.insert(0, order[: len(self._levels[0]) // 2])
        self._level = 0
        self._began = 0.0  # the share of the search that was over when it had the first level

    def begin_with(self, solution: Solution) -> None:
        """Begin with a solution instead of a construction, and search for all items at once."""
        self._task = replace(self._task, start=solution.poses)
        self._levels = self._levels[-1:]

    def advance(self, problem: Problem, budget: SearchBudget) -> None:
        """Search until the budget is spent."""
        self._budget = budget
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
            spent = budget.progress - self._began
            if not self._has_all and spent > self._most_share * share:
                self._attempt = None
                self._add_items(problem)

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a better solution."""
        self.best = solution

    def _is_over(self, budget: SearchBudget) -> bool:
        return self.is_done or budget.is_spent

    def _offer(self, problem: Problem, solution: Solution) -> None:
        """Take over a solution if it is the best so far."""
        if self.best is None or solution.score < self.best.score:
            self.adopt(problem, solution)

    def finished(self, problem: Problem, budget: SearchBudget) -> Solution | None:
        """Return the best solution after what pays at the end alone; the search stays as it is."""
        return self.best

    def restart(self) -> None:
        """Begin again with a construction: the best solution turned out not to be valid."""
        self.best = None
        self.is_done = False
        self._is_begun = False
        self._attempt = None

    @property
    def has_start(self) -> bool:
        """Whether it begins with given poses instead of a construction."""
        return self._task.start is not None

    @property
    def _items(self) -> Ints:
        """The items that are searched for now."""
        return self._levels[self._level]

    @property
    def _has_all(self) -> bool:
        """True if these are all items."""
        return self._level == len(self._levels) - 1

    @property
    def _most_share(self) -> float:
        """The share of the search after which all items are searched for, at the latest."""
        return self._task.settings.first_levels

    @property
    def _is_precise(self) -> bool:
        """True if surfaces compute fields from an attempt's start: fewer moves, but exact ones."""
        return self._has_all

    @property
    def _later(self) -> list[Ints]:
        """The items that each level up to the present one adds."""
        pairs = zip(self._levels[: self._level], self._levels[1:], strict=False)
        return [new[len(old) :] for old, new in pairs]

    def _own(self, poses: Poses) -> Poses:
        """Return poses without the items that are not searched for now."""
        inside = self._task.unplaced.inside
        inside[self._items] = poses.inside[self._items]
        return Poses(inside, poses.turned, poses.places)

    def _add_items(self, problem: Problem) -> None:
        """Search for more items from now on."""
        self._level += 1

    def _rebuild(self, problem: Problem, budget: SearchBudget) -> None:
        """Search in another way between attempts, if the search has one."""
        return

    @abstractmethod
    def _constructed(self, problem: Problem) -> Solution:
        """Return a first solution."""

    @abstractmethod
    def _begun(self, problem: Problem, best: Solution) -> Attempt:
        """Return the next attempt: poses that overlap, in less space or with more value."""

    @abstractmethod
    def _end(self, problem: Problem, best: Solution, attempt: Attempt, is_apart: bool) -> None:
        """Keep the result of an attempt if it is better, or adapt to the failure."""
