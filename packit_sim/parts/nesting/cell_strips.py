"""The search for the lowest strip of many types: separate items as cells, and let them settle."""

from __future__ import annotations

from packit_sim.geometry.arrays import Ints
from packit_sim.parts.nesting.cell_filling import cell_side, filled_cells, settle_all
from packit_sim.parts.nesting.cell_orders import hardest_first
from packit_sim.parts.nesting.cell_separation import CellSeparation
from packit_sim.parts.nesting.cells import least_side
from packit_sim.parts.nesting.compaction import compacted
from packit_sim.parts.nesting.filling import constructed, loaded
from packit_sim.parts.nesting.finer_sides import FinerSides
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.search import Attempt, NestSearch
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask, Solution

SHUFFLE = 0.02
"""Standard deviation of the logarithms of sizes in the order of a further construction."""

NEAR = 0.03
"""Share of the least height by which poses may be higher for their items to settle."""

FIRST_SIDE = 0.9
"""Side of the cells of the first separations, as a share of the first construction's."""

LEAST_SIDE = 0.45
"""The share below which they do not become smaller."""

LEAST_GAIN = 5e-4
"""Share of the height by which a strip must be lower for cells of their side to be of use."""

MOST_MORE = 1
"""Most cells by which a strip may be higher on the grid: settling takes them back, and more."""


class CellStripSearch(NestSearch):
    """A search for the lowest strip of so many types that pairs of them have no fields.

    Algorithm: greedy constructions on finer and finer grids of cells, as far as there is time; then
    a move of all items at once (`compact`); then, again and again, all items go to the nearest
    positions of a fine grid in a strip that is lower by some cells, are separated there
    (`CellSeparation`), and settle by their surfaces, off the grid. A gain makes the next strip
    lower by one cell more, a failure by one less. Where several gain nothing, cells become smaller.
    The combination is our own.
    """

    def __init__(self, task: SearchTask, seed: int) -> None:
        super().__init__(task, seed)
        self._sides = FinerSides(task, task.settings.constructing)
        self._side = 0.0
        self._more = 0  # cells by which a strip may be higher on the grid
        self._compacted: Poses | None = None  # the last ones of which all items moved at once
        self._failures = 0

    def _constructed(self, problem: Problem) -> Solution:
        self._side = FIRST_SIDE * cell_side(problem, self._task)
        assert self._budget is not None
        before = self._budget.progress
        order = self._order(problem, 0.0)
        side = self._sides.first(problem, order, self._rng, self._budget)
        given = problem, self._task, [self._task.size], self._rng, self._budget, order
        poses = constructed(*given, side, is_complete=True)
        self._sides.spend(self._budget.progress - before)
        return self._solution(problem, poses)

    def _rebuild(self, problem: Problem, budget: SearchBudget) -> None:
        """Construct on a finer grid, as often as there is time; then move all items at once."""
        if self._sides.is_over:
            return
        task, before = self._task, budget.progress
        side = self._sides.next(problem, before)
        if side is None:
            self._compact(problem)
            return
        order, boxes = self._order(problem, SHUFFLE), boxes_of([task.size])
        poses = filled_cells(problem, task, task.unplaced, boxes, order, self._rng, budget, side)
        if poses.inside.all():
            self._offer(problem, self._solution(problem, poses))
        budget.take(task.settings.passes_at_once)
        self._sides.spend(budget.progress - before)

    def _begun(self, problem: Problem, best: Solution) -> CellSeparation:
        return CellSeparation(self._task, best, self._side, self._more)

    def _end(self, problem: Problem, best: Solution, attempt: Attempt, is_apart: bool) -> None:
        height = self._solution(problem, attempt.least).score[0]
        if height < best.score[0] * (1 + NEAR):
            solution = self._settled(problem, attempt.least)
            self._offer(problem, solution)
            height = solution.score[0]
        if height < best.score[0] * (1 - LEAST_GAIN):
            self._more -= 1
            self._failures = 0
            return
        if best.poses is not self._compacted:
            self._compact(problem)
            return
        self._more = min(self._more + 1, MOST_MORE)
        self._failures += 1
        if self._failures == self._task.settings.cell_failures:
            self._failures = 0
            least = least_side(problem, LEAST_SIDE * cell_side(problem, self._task))
            self._side = max(self._side * self._task.settings.smaller_cells, least)

    def _compact(self, problem: Problem) -> None:
        """Move all items of the best strip at once, which single ones did not make lower."""
        assert self.best is not None
        boxes, moves = boxes_of([self._task.size]), self._task.settings.compacting_moves
        poses = compacted(problem, self._task, self.best.poses, boxes, moves, self._budget)
        self._offer(problem, self._solution(problem, poses))
        self._compacted = self.best.poses

    def _order(self, problem: Problem, shuffle: float) -> Ints:
        """Return the hardest items first, with sizes that change at random."""
        change = self._choices.normal(0, shuffle, self._task.count)
        return hardest_first(problem, self._task, change)

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
