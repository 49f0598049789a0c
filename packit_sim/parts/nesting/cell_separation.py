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
from packit_sim.parts.nesting.problem import Problem, State
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask, Solution


class CellSeparation:
    """An attempt to move the items of a strip apart on a grid of cells, which can be interrupted.

    Parameters
    ----------
    start : Solution
        The poses to begin with, and their height; only items that are inside are moved.
    side : float
        The side of a cell.
    less : int
        Cells by which the strip is lower; below 0: by which it may be higher.

    Attributes
    ----------
    least : Poses
        The poses of least overlap; those at first until `advance` returns True or False.
    """

    def __init__(self, task: SearchTask, start: Solution, side: float, less: int) -> None:
        self.least = start.poses
        self._inside = np.flatnonzero(start.poses.inside)
        self._task = task.only(self._inside[self._inside < task.count])
        self._own = start.poses.only(self._inside)
        self._before = start.score[0]
        self._side = side
        self._cells = math.ceil(self._before / side) - less
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
        """Continue as `search.Attempt.advance` says."""
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
                self._overlap, self._own = overlap, Poses.of(state)
        self.least = self.least.moved(self._inside, self._own)
        return self._overlap == 0

    def on_grid(self, cells: Cells) -> tuple[State, CellState, Ints]:
        """Return the poses on the grid, in a strip that is as high as it may be."""
        task = self._task
        wide = [int(side / cells.side + 1e-9) for side in task.size[:2]]
        size = np.array([*wide, self._cells], np.int64) + 2 * cells.margin
        state = task.state(has_weights=False)
        state.inside[:] = 1
        state.turned[:] = self._own.turned
        state.places[:] = self._own.places
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
        places = self._own.places.copy()
        places[: task.count, 2] *= self._cells * cells.side / self._before
        put_on_grid(cells, state, grid, places, size)
        return state, grid, size
