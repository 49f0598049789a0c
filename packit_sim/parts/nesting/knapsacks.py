"""The search for the most value in one box: exchange items, and rebuild parts of the box."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Ints
from packit_sim.parts.nesting.balancing import balanced
from packit_sim.parts.nesting.cell_filling import filled_cells, settle_all
from packit_sim.parts.nesting.cell_orders import most_valuable_first
from packit_sim.parts.nesting.filling import (
    constructed,
    filled,
    least_heights,
    loaded,
    rebuilt,
    repaired,
    shuffled,
    with_random_poses,
)
from packit_sim.parts.nesting.finer_sides import FinerSides
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.search import Attempt, NestSearch
from packit_sim.parts.nesting.separation import Separation
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask, Solution

_BALANCED = 0.5
"""Probability that an attempt with a box that is off balance exchanges the places of two items."""

SHUFFLE = 0.02
"""Standard deviation of the change of ranks in a further construction, as a share of all."""

CONSTRUCTING = 0.95
"""Share of the search after which a box of many types is not constructed again: exchanges, which
need the fields of pairs, gain next to nothing there."""

_NO_EFFORT = 1e-9
"""Share of the search below which nothing was tried."""


class KnapsackSearch(NestSearch):
    """A search for the most value in one box: exchange items, move all apart, and repeat.

    Algorithm: separation of exchanged items. Some items are replaced by others of slightly more
    value; if they can't be separated, the worst ones are removed (`repaired`) and what fits is put
    in. The search continues from a box that is worse than the best by up to a random share, which
    is record-to-record travel (Dueck, 1993) with a random deviation. Between exchanges the box is
    rebuilt: ruin and recreate (Schrimpf et al., 2000), which moves no other item.

    Which of the most important items go in first decides more than all later exchanges. So they are
    arranged again and again, each time from another construction, until half of the time is over.

    Rebuilds gain more than exchanges if few large items fit in, and next to nothing if many small
    ones do. So their time, at most that of exchanges, follows from the gains of both so far.

    With many types (items as cells), most of the time goes to constructions on finer cells.

    Where the centre of gravity must be near the middle, items slide towards it after each change of
    the box (`balanced`); if that is not enough, the search continues with the box as it is, from
    which items exchange places, and what counts is the box without the items that are too much.
    """

    def __init__(self, task: SearchTask, seed: int) -> None:
        super().__init__(task, seed, task.order)
        self._boxes = boxes_of([task.size])
        self._fits = np.ones(task.count, bool)
        self._most_value = task.limits.most_value(task.values)
        self._failures = 0
        self._order = task.order
        self._sides = FinerSides(task, CONSTRUCTING, repeats=True)
        self._good = self._current = self._rebuilt = task.unplaced
        self._progress = 0.0  # when a box was last rebuilt
        self._gains, self._efforts = np.zeros(2), np.zeros(2)  # of exchanges, and of rebuilds

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a more valuable box."""
        self.best = solution
        is_all = bool((self._packed(solution.poses) | ~self._fits).all())
        self.is_done = is_all or -solution.score[0] >= self._most_value * (1 - 1e-9)
        if self._has_all and -solution.score[0] > self._value(self._good):
            self._good = self._current = solution.poses

    def _constructed(self, problem: Problem) -> Solution:
        possible = self._task.limits.possible(self._task.count)
        self._fits = np.isfinite(least_heights(problem, self._task)) & possible
        sizes = [self._task.size]
        assert self._budget is not None
        side, before = None, self._budget.progress
        if problem.by_cells:
            self._order = most_valuable_first(problem, self._task)
            side = self._sides.first(problem, self._order, self._rng, self._budget)
        given = problem, self._task, sizes, self._rng, self._budget
        poses = constructed(*given, self._order, side)
        if problem.by_cells:
            poses = self._settled_and_filled(problem, poses, side, self._budget)
            self._sides.spend(self._budget.progress - before)
        poses = self._within_limits(problem, poses)
        for order in self._other_orders():
            if self._budget.is_late:
                break
            other = constructed(*given, order, side)
            poses = max(poses, self._within_limits(problem, other), key=self._value)
        solution = self._solution(poses)
        self.is_cut = self._budget.is_late and bool((self._fits & ~self._packed(poses)).any())
        self._good = self._current = self._own(solution.poses)
        self._rebuilt = solution.poses
        return solution

    def _other_orders(self) -> Iterator[Ints]:
        """Yield further orders of construction: with limits it matters more which items come first.

        Limits need not run out: then the order by volume is better than that of the task.
        """
        task = self._task
        if not task.limits.count:
            return
        orders = task.order_by(task.volumes), task.order
        yield orders[0]
        for number in range(task.settings.constructed_again // max(1, task.count)):
            yield shuffled(orders[number % 2], task.settings.shuffle, self._choices)

    def _within_limits(self, problem: Problem, poses: Poses) -> Poses:
        """Take out items beyond the limits, which cells and packings to begin with do not know."""
        excess = self._task.limits.excess(self._packed(poses), self._task.values)
        poses = balanced(problem, self._task, poses.changed(excess, 0), self._boxes)
        return self._balanced(poses)

    def _balanced(self, poses: Poses) -> Poses:
        """Take out the items by which the centre of gravity is too far off."""
        balance = self._task.balance
        if balance is None:
            return poses
        return poses.changed(balance.excess(poses, self._task.values), 0)

    def _settled_and_filled(
        self, problem: Problem, poses: Poses, side: float | None, budget: SearchBudget
    ) -> Poses:
        """Let items settle, which leaves space above them, and fill it, while that gains value."""
        task, value = self._task, -1.0
        while self._value(poses) > value and not budget.is_late:
            value = self._value(poses)
            state = loaded(problem, task, poses, self._boxes)
            settle_all(problem, task, state, self._rng, budget)
            given = Poses.of(state), self._boxes, self._order
            poses = filled_cells(problem, task, *given, self._rng, budget, side)
        return poses

    def _rebuild(self, problem: Problem, budget: SearchBudget) -> None:
        if problem.by_cells and not self._sides.is_over:
            self._construct_finer(problem, budget)
            return
        self._count_effort(0, budget)
        most = self._rebuilt_share * self._efforts[0]
        while self._efforts[1] < most and not self._is_over(budget):
            for _ in range(budget.take(self._task.settings.passes_at_once)):
                self._rebuild_once(problem)
                if self._is_over(budget):  # one may take a second
                    break
            self._count_effort(1, budget)

    def _construct_finer(self, problem: Problem, budget: SearchBudget) -> None:
        """Construct on a finer grid, in another order."""
        task, before = self._task, budget.progress
        side = self._sides.next(problem, before)
        if side is None:
            return
        given = task.unplaced, self._boxes, shuffled(self._order, SHUFFLE, self._choices)
        poses = filled_cells(problem, task, *given, self._rng, budget, side)
        poses = self._settled_and_filled(problem, poses, side, budget)
        solution = self._solution(self._within_limits(problem, poses))
        if self.best is not None and solution.score < self.best.score:
            self._good = self._current = self._rebuilt = solution.poses
        self._offer(problem, solution)
        budget.take(task.settings.passes_at_once)
        self._sides.spend(budget.progress - before)

    def _count_effort(self, kind: int, budget: SearchBudget) -> None:
        """Count the share of the search since the last call for exchanges (0) or rebuilds (1)."""
        progress = budget.progress
        self._efforts[kind] += progress - self._progress
        self._progress = progress

    @property
    def _rebuilt_share(self) -> float:
        """The time that rebuilds should take, as a share of the time for exchanges."""
        exchanges, rebuilds = self._gains / np.maximum(self._efforts, _NO_EFFORT)
        share = (rebuilds / exchanges) ** 2 if exchanges > 0 else float(rebuilds > 0)
        return min(1.0, max(self._task.settings.least_rebuilding, share))

    def _rebuild_once(self, problem: Problem) -> None:
        """Rebuild the best box, or one that was rebuilt from it and is not much worse."""
        assert self.best is not None
        most, max_loss = -self.best.score[0], self._task.settings.max_loss
        if self._value(self._rebuilt) < (1 - max_loss) * most:
            self._rebuilt = self.best.poses
        task, boxes, choices = self._task, self._boxes, self._choices
        poses = rebuilt(problem, task, self._rebuilt, boxes, choices, self._rng, self._budget)
        poses = self._balanced(balanced(problem, task, poses, boxes))
        value = self._value(poses)
        if value > most:
            self._gains[1] += value - most
            self._offer(problem, self._solution(poses))
        if value >= (1 - max_loss * self._choices.random()) * most:
            self._rebuilt = poses

    def _begun(self, problem: Problem, best: Solution) -> Separation:
        task, balance = self._task, self._task.balance
        is_off = balance is not None and not balance.is_kept(self._current)
        if balance is not None and is_off and self._choices.random() < _BALANCED:
            found = Separation(task, self._current, self._boxes, task.settings.exchange_patience)
            found.swap(*balance.pair(self._current, self._choices))
            return found
        poses = self._exchanged(problem)
        return Separation(task, poses, self._boxes, task.settings.exchange_patience)

    def _end(self, problem: Problem, best: Solution, attempt: Attempt, is_apart: bool) -> None:
        settings = self._task.settings
        poses = attempt.least
        if not is_apart:
            poses = repaired(problem, self._task, poses, self._boxes)
        most = self._value(self._good)
        if self._value(poses) >= (1 - settings.max_refill_loss) * most:
            poses = self._filled(problem, poses)
        poses = balanced(problem, self._task, poses, self._boxes)
        kept = self._balanced(poses)
        value = self._value(kept)
        self._failures += 1
        if value > most:
            self._gains[0] += max(0.0, value + best.score[0])
            self._good, self._failures = kept, 0
            self._offer(problem, self._solution(kept))
        is_good = self._value(poses) >= (1 - settings.max_loss * self._choices.random()) * most
        self._current = poses if is_good else self._good
        if self._failures > settings.max_failures and not self._has_all:
            self._add_items(problem)

    def _add_items(self, problem: Problem) -> None:
        """Search for more items from now on, and put in those that fit; or begin again."""
        super()._add_items(problem)
        self._failures = 0
        self._good = self._within_limits(problem, self._filled(problem, self._good))
        self._offer(problem, self._solution(self._good))
        if self._has_all and self._has_time_again():
            self._begin_again(problem)
            return
        if self._has_all and self.best is not None:
            self._good = self.best.poses
        self._current = self._good

    def _begin_again(self, problem: Problem) -> None:
        """Arrange the most important items anew, from another construction."""
        assert self._budget is not None
        self._level = 0
        self._began = self._budget.progress
        self._offer(problem, self._constructed(problem))

    @property
    def _most_share(self) -> float:
        return self._task.settings.beginning

    def _has_time_again(self) -> bool:
        """Return whether there is time to arrange the most important items once more."""
        assert self._budget is not None
        now = self._budget.progress
        return now + (now - self._began) <= self._task.settings.beginning

    def _filled(self, problem: Problem, poses: Poses) -> Poses:
        items, budget = self._items, self._budget
        return filled(problem, self._task, poses, self._boxes, items, self._rng, budget)

    def _value(self, poses: Poses) -> float:
        return float(self._task.values[self._packed(poses)].sum())

    def _packed(self, poses: Poses) -> npt.NDArray[np.bool_]:
        """Return which items (n,) are inside."""
        return poses.inside[: self._task.count] > 0

    def _solution(self, poses: Poses) -> Solution:
        return Solution((-self._value(poses),), poses, self._boxes)

    def _exchanged(self, problem: Problem) -> Poses:
        """Replace a few random items by others at random poses, for a small gain in value."""
        settings = self._task.settings
        old = self._current
        out = self._items[self._fits[self._items] & (old.inside[self._items] == 0)]
        packed = np.flatnonzero(self._packed(old))
        values = self._task.values
        most, now = self._value(self._good), self._value(old)
        limits = self._task.limits
        left = limits.left(self._packed(old))
        least = np.inf
        comes, goes = out[: 0 if limits.count else 1], packed[:1]
        least_gain, enough = settings.exchange_gain
        for _ in range(settings.exchange_choices):
            some = self._choices.permutation(out)
            some = some[: 1 + self._choices.integers(settings.max_inserted)]
            others = self._choices.permutation(packed)
            others = others[: self._choices.integers(settings.max_removed + 1)]
            gain = now + values[some].sum() - values[others].sum() - most
            if least_gain * most < gain < least and limits.allow(left, some, others):
                comes, goes, least = some, others, gain
            if least < enough * most:
                break
        inside = old.inside.copy()
        inside[goes] = 0
        poses = Poses(inside, old.turned, old.places)
        return with_random_poses(
            problem, self._task, poses, comes.tolist(), self._boxes, self._choices
        )
