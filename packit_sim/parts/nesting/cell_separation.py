"""Attempts to move overlapping items apart on a grid of cells."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Ints
from packit_sim.parts.nesting.cell_separation_kernels import (
    CellState,
    put_on_grid,
    separate_cells,
)
from packit_sim.parts.nesting.cells import Cells, cells_of
from packit_sim.parts.nesting.filling import loaded
from packit_sim.parts.nesting.problem import Problem, State, boxes_of
from packit_sim.parts.nesting.settling_kernels import lift
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask, Solution


class CellSeparation:
    """An attempt to move the items of a strip apart on a grid of cells, which can be interrupted.

    Parameters
    ----------
    start : Solution
        The poses to begin with, and their height.
    side : float
        The side of a cell.
    more : int
        Cells by which the strip may be higher; below 0: by which it is lower.

    Attributes
    ----------
    least : Poses
        Poses without conflicts, once `advance` has returned True.
    """

    def __init__(self, task: SearchTask, start: Solution, side: float, more: int) -> None:
        self.least = start.poses
        self._task = task
        self._height = start.score[0]
        self._side = side
        self._more = more
        self._overlap = math.inf
        self._idle = 0
        self._begun: tuple[State, CellState, Ints] | None = None

    def advance(
        self,
        problem: Problem,
        rng: npt.NDArray[np.uint64],
        budget: SearchBudget,
        is_precise: bool,
    ) -> bool | None:
        """Continue as `search.Attempt.advance` says; items that stay in conflict are lifted."""
        settings = self._task.settings
        cells = cells_of(problem, self._side)
        if self._begun is None:
            self._begun = self.on_grid(cells)
        state, grid, size = self._begun
        weights = *settings.weight_growth, settings.weight_decay
        while self._overlap > 0 and self._idle < settings.cell_patience:
            if budget.is_spent:
                return None
            passes = budget.take(1)  # of hundreds of items, one may take a second
            samples = settings.cell_samples
            overlap = separate_cells(
                problem, cells, state, grid, size, passes, samples, weights, rng
            )
            is_gain = overlap < settings.gain * self._overlap
            self._idle = 0 if is_gain else self._idle + passes
            if overlap < self._overlap:
                self._overlap, self.least = overlap, Poses.of(state)
        self.least = self._lifted(problem, rng)
        return True

    def on_grid(self, cells: Cells) -> tuple[State, CellState, Ints]:
        """Return the poses on the grid, in a strip that is as high as it may be."""
        task = self._task
        height = math.ceil(self._height / cells.side) + self._more
        wide = [int(side / cells.side + 1e-9) for side in task.size[:2]]
        size = np.array([*wide, height], np.int64) + 2 * cells.margin
        state = task.state(has_weights=False)
        state.inside[:] = 1
        state.turned[:] = self.least.turned
        state.places[:] = self.least.places
        n = len(state.types)
        grid = CellState(
            np.full(3, -cells.margin * cells.side),
            np.zeros((6, n), np.int32).T,
            np.zeros((n, n), np.float32),
            np.zeros((n, n), np.float32),
            np.ones((n, n), np.float32),
            np.zeros(n, np.float32),
            np.zeros(n, np.uint8),
        )
        places = self.least.places.copy()
        places[: task.count, 2] *= height * cells.side / self._height
        put_on_grid(cells, state, grid, places, size)
        return state, grid, size

    def _lifted(self, problem: Problem, rng: npt.NDArray[np.uint64]) -> Poses:
        """Return the poses of least overlap, after items that are in conflict were lifted."""
        task = self._task
        state = loaded(problem, task, self.least, boxes_of([task.size]))
        order = np.argsort(state.bounds[: task.count, 2], kind="stable")
        step = task.settings.settling_steps[1] * self._side
        tries = 4 * task.settings.settling_tries
        lift(problem, state, boxes_of([task.size]), order, step, tries, rng)
        return Poses.of(state)
