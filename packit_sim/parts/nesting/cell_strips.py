"""The search for the lowest strip of many types: separate items as cells, and let them settle."""

from __future__ import annotations

import math

import numpy as np

from packit_sim.geometry.arrays import Ints
from packit_sim.parts.nesting.cell_filling import cell_side, filled_cells, settle_all
from packit_sim.parts.nesting.cell_separation import CellSeparation
from packit_sim.parts.nesting.filling import constructed, loaded
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.search import Attempt, NestSearch
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask, Solution

THICK = 0.5, 1.5
"""Powers of an item's volume and of its shortest side whose product orders a construction."""

SHUFFLE = 0.04
"""Standard deviation of the logarithm of that product in the order of a further construction."""

NEAR = 0.01
"""Share of the least height by which a construction may be higher for its items to settle."""

FINER = 0.8
"""Factor of the side of cells from one construction to the next, if there is time for it."""

COST = 4
"""Power of the number of cells along a side by which the time of a construction grows."""

LEAST_SIDE = 0.3
"""Share of the side that cells have at first below which they do not become smaller."""

LEAST_GAIN = 5e-4
"""Share of the height by which a strip must be lower for cells of their side to be of use."""

MORE_SPACE = 1, 0
"""Cells by which a strip may be higher on the grid: settling takes them back, and more."""


class CellStripSearch(NestSearch):
    """A search for the lowest strip of so many types that pairs of them have no fields.

    Algorithm: greedy constructions on grids of cells, ever finer ones for some of the time; then,
    again and again, all items go to the nearest positions of a grid, are separated there
    (`CellSeparation`), and settle by their surfaces, off the grid. Separating changes the
    arrangement, and settling gains more than cells waste. Where that gains nothing, cells become
    smaller. The combination is our own.
    """

    def __init__(self, task: SearchTask, seed: int) -> None:
        super().__init__(task, seed)
        self._side = 0.0
        self._failures = 0
        self._least = math.inf  # the height of a construction
        self._fill_side = self._spent = 0.0  # the side of its cells, and its share of the search

    def _constructed(self, problem: Problem) -> Solution:
        task = self._task
        self._side = self._fill_side = cell_side(problem, task)
        order = self._order(problem, 0.0)
        poses = constructed(problem, task, [task.size], self._rng, order=order)
        solution = self._solution(problem, poses)
        self._least = solution.score[0]
        return solution

    def _rebuild(self, problem: Problem, budget: SearchBudget) -> None:
        """Construct again, in smaller cells or at least in another order, while there is time."""
        task, settings = self._task, self._task.settings
        if self._spent == 0 and self.best is not None:  # at first, let the construction settle
            before = budget.progress
            self._offer(problem, self._settled(problem, self.best.poses))
            budget.take(settings.passes_at_once)
            self._spent = budget.progress - before
        while not self._is_over(budget):
            for factor in (FINER, 1.0):
                if budget.progress + self._spent / factor**COST <= settings.constructing:
                    break
            else:
                return
            self._fill_side *= factor
            before = budget.progress
            order = self._order(problem, SHUFFLE)
            empty, boxes = task.unplaced, boxes_of([task.size])
            side = self._fill_side
            poses = filled_cells(problem, task, empty, boxes, order, budget, side)
            height = self._solution(problem, poses).score[0]
            if poses.inside.all() and height < self._least * (1 + NEAR):
                self._least = min(self._least, height)
                self._offer(problem, self._settled(problem, poses))
            budget.take(settings.passes_at_once)
            self._spent = budget.progress - before

    def _begun(self, problem: Problem, best: Solution) -> CellSeparation:
        more = MORE_SPACE[self._failures % len(MORE_SPACE)]
        return CellSeparation(self._task, best, self._side, more)

    def _end(self, problem: Problem, best: Solution, attempt: Attempt, is_apart: bool) -> None:
        height = best.score[0]
        if is_apart:
            solution = self._solution(problem, attempt.least)
            height = solution.score[0]
            self._offer(problem, solution)
        self._failures += 1
        if height < best.score[0] * (1 - LEAST_GAIN):
            self._failures = 0
        elif self._failures == self._task.settings.cell_failures:
            self._failures = 0
            side = self._side * self._task.settings.smaller_cells
            self._side = max(side, LEAST_SIDE * cell_side(problem, self._task))

    def _order(self, problem: Problem, shuffle: float) -> Ints:
        """Return the items, the large and thick ones first: they find no place later."""
        task = self._task
        own = task.numbers[: task.count]
        boxes = problem.lookup.boxes[own, problem.allowed[own, 0]]
        shortest = (boxes[:, 3:] - boxes[:, :3]).min(axis=1)
        sizes = THICK[0] * np.log(task.volumes) + THICK[1] * np.log(shortest)
        return np.argsort(self._choices.normal(0, shuffle, task.count) - sizes, kind="stable")

    def _settled(self, problem: Problem, poses: Poses) -> Solution:
        """Return the solution of poses after all items have settled."""
        state = loaded(problem, self._task, poses, boxes_of([self._task.size]))
        settle_all(problem, self._task, state, self._rng, self._budget)
        return self._solution(problem, Poses.of(state))

    def _solution(self, problem: Problem, poses: Poses) -> Solution:
        tops = poses.places[:, 2] + problem.lookup.boxes[self._task.numbers, poses.turned, 5]
        own = slice(self._task.count)
        height = float(tops[own][poses.inside[own] > 0].max(initial=0.0))
        x, y, _ = self._task.size
        return Solution((height,), poses, boxes_of([(x, y, height)]))
