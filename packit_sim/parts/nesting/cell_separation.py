"""Attempts to move overlapping items apart on a grid of cells, where they then settle."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Ints
from packit_sim.parts.nesting.cell_filling import settle_all
from packit_sim.parts.nesting.cell_separation_kernels import (
    CellState,
    put_on_grid,
    separate_cells,
)
from packit_sim.parts.nesting.cells import Cells, cells_of
from packit_sim.parts.nesting.problem import Problem, State
from packit_sim.parts.nesting.settling_kernels import count_conflicts
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
        Cells by which the strip may be higher.

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
        """Continue as `search.Attempt.advance` says; items that are apart settle."""
        settings = self._task.settings
        cells = cells_of(problem, self._side)
        if self._begun is None:
            self._begun = self._on_grid(cells)
        state, grid, size = self._begun
        weights = *settings.weight_growth, settings.weight_decay
        while self._idle < settings.cell_patience:
            if budget.is_spent:
                return None
            passes = budget.take(1)  # of hundreds of items, one may take a second
            samples = settings.cell_samples
            overlap = separate_cells(
                problem, cells, state, grid, size, passes, samples, weights, rng
            )
            if overlap == 0:
                settle_all(problem, self._task, state, rng, budget)
                self.least = Poses.of(state)
                # Obstacles are off the grid, so that their cells may be too few.
                return int(count_conflicts(problem, state)) == 0
            is_gain = overlap < settings.gain * self._overlap
            self._idle = 0 if is_gain else self._idle + passes
            self._overlap = min(self._overlap, overlap)
        return False

    def _on_grid(self, cells: Cells) -> tuple[State, CellState, Ints]:
        """Return the poses on the grid, in a strip that is as high as it may be."""
        task = self._task
        height = math.ceil(self._height / cells.side) + self._more
        wide = [int(side / cells.side + 1e-9) for side in task.size[:2]]
        size = np.array([*wide, height], np.int64) + 2 * cells.margin
        state = task.state()
        state.inside[:] = 1
        state.turned[:] = self.least.turned
        state.places[:] = self.least.places
        n = len(state.types)
        grid = CellState(
            np.full(3, -cells.margin * cells.side),
            np.zeros((n, 6), np.int64),
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
