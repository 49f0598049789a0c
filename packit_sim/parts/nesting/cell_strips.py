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

FINER_SIDE = 0.7
"""Side of the cells on which the others are filled in, as a share of the construction's."""

LEAST_SIDE = 0.45
"""The share below which the cells of separations do not become smaller."""

LEAST_GAIN = 5e-4
"""Share of the height by which a strip must be lower for cells of their side to be of use."""

MOST_MORE = 1
"""Most cells by which a strip may be higher on the grid: settling takes them back, and more."""


class CellStripSearch(NestSearch):
    """A search for the lowest strip of so many types that pairs of them have no fields.

    Algorithm: a greedy construction on a grid of cells. If that was quick, a quarter of its items,
    the hardest ones, are arranged alone; then the others go to the lowest places that they leave,
    and half of all are arranged, then all. Otherwise further constructions follow on finer grids,
    as far as there is time, before all items are arranged. To arrange items, they go to the nearest
    positions of a grid in a strip that is lower by some cells, are separated there
    (`CellSeparation`), and settle by their surfaces, off the grid, again and again. A gain makes
    the next strip lower by one cell more, a failure by less. At last, all items move at once
    (`compact`) where that gains nothing, and cells become smaller. The combination is our own.
    """

    def __init__(self, task: SearchTask, seed: int) -> None:
        super().__init__(task, seed)
        self._sides = FinerSides(task, task.settings.constructing)
        self._current: Solution | None = None  # of the items that are arranged now
        self._side = 0.0
        self._less = 0  # cells by which the next strip is lower on the grid
        self._compacted: Solution | None = None  # the last one of which all items moved at once
        self._failures = 0

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a lower strip."""
        self.best = solution
        if self._has_all:
            self._current = solution

    def _constructed(self, problem: Problem) -> Solution:
        assert self._budget is not None
        settings, before = self._task.settings, self._budget.progress
        order = self._order(problem, 0.0)
        side = self._sides.first(problem, order, self._rng, self._budget)
        given = problem, self._task, [self._task.size], self._rng, self._budget, order
        solution = self._solution(problem, constructed(*given, side, is_complete=True))
        spent = self._budget.progress - before
        self._sides.spend(spent)
        self._levels, self._level = [order], 0
        if self._task.start is None and spent < settings.first_construction:
            self._sides.is_over = True
            counts = [round(share * len(order)) for share in settings.first_arranged]
            self._levels[:0] = [order[:n] for n in counts if n >= settings.first_items]
        self._arrange(problem, solution)
        return solution

    def _arrange(self, problem: Problem, solution: Solution) -> None:
        """Arrange the items that are searched for from now on, as they are in a strip of all."""
        self._current = self._solution(problem, self._own(solution.poses))
        self._side = cell_side(problem, self._task)
        most = self._task.settings.shrink * self._current.score[0] / self._side
        self._less = 0 if self._has_all else round(most)
        self._failures = 0

    def _add_items(self, problem: Problem) -> None:
        """Let the others settle in the space that is left, and arrange more of them."""
        assert self._current is not None and self._budget is not None
        side = least_side(problem, FINER_SIDE * cell_side(problem, self._task))
        given = boxes_of([self._task.size]), self._levels[-1], self._rng, self._budget, side
        poses = filled_cells(problem, self._task, self._current.poses, *given)
        if poses.inside.all():
            solution = self._settled(problem, poses)
            self._offer(problem, solution)
            super()._add_items(problem)
            self._arrange(problem, self.best if self._has_all and self.best else solution)

    @property
    def _most_share(self) -> float:
        return self._task.settings.constructing

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
        assert self._current is not None
        return CellSeparation(self._task, self._current, self._side, self._less)

    def _end(self, problem: Problem, best: Solution, attempt: Attempt, is_apart: bool) -> None:
        assert self._current is not None
        before = self._current.score[0]
        if is_apart:
            self._take(problem, self._settled(problem, attempt.least))
        if self._current.score[0] < before * (1 - LEAST_GAIN):
            self._less += 1
            self._failures = 0
            return
        if self._has_all and self._current is not self._compacted:
            self._compact(problem)
            return
        self._less = max(self._less - max(1, self._less // 3), -MOST_MORE)
        self._failures += 1
        if self._failures < self._task.settings.cell_failures:
            return
        if not self._has_all:
            self._add_items(problem)
            return
        self._failures = 0
        least = least_side(problem, LEAST_SIDE * cell_side(problem, self._task))
        self._side = max(self._side * self._task.settings.smaller_cells, least)

    def _take(self, problem: Problem, solution: Solution) -> None:
        """Go on from a strip of the items that are arranged now, if it is lower."""
        assert self._current is not None
        if self._has_all:
            self._offer(problem, solution)
        elif solution.score < self._current.score:
            self._current = solution

    def _compact(self, problem: Problem) -> None:
        """Move all items of the lowest strip at once, which single ones did not make lower."""
        assert self._current is not None
        boxes, moves = boxes_of([self._task.size]), self._task.settings.compacting_moves
        poses = compacted(problem, self._task, self._current.poses, boxes, moves, self._budget)
        self._take(problem, self._solution(problem, poses))
        self._compacted = self._current

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
