"""The sides of cells of one construction after the other, as long as there is time for finer ones.

A construction on finer cells is denser, and takes longer: by the power `COST` of their number along
a side.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Ints
from packit_sim.parts.nesting.cell_filling import cell_side, filled_cells
from packit_sim.parts.nesting.cells import cells_of, least_side
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.tasks import SearchBudget, SearchTask

TRIED = 0.1
"""Share of the items after which the time of the first construction is estimated."""

GROWTH = 1.25
"""Power of the number of items by which that time grows: 1.12 of 1,000 parts, 1.28 of 5,000.

A first construction that takes less than estimated leaves time for a finer one.
"""

COST = 2.3
"""Power of the number of cells along a side by which the time of a construction grows."""

MOST_TIME = 0.25
"""Share of the time that is left which the first construction may take."""

SECOND_UNTIL = 0.9
"""Share of the search by which the second construction has to end: it gains most."""

FINER = 0.6
"""Side of the cells of a further construction, as a share of those before, if there is time."""

LEAST_FINER = 0.85
"""The largest such share for which a construction is worth its time."""

STEP = 0.9
"""Further sides are `cell_side` times powers of this: searches share their cells."""

FINEST = 0.45
"""Least side of the cells of a construction, as a share of `cell_side`."""


class FinerSides:
    """The sides of the cells of one construction after the other.

    Parameters
    ----------
    until : float
        The share of the search after which there is no third construction.
    repeats : bool
        Whether further constructions follow on cells of the same side when finer ones are not
        worth their time: orders that change at random differ by some percent.

    Attributes
    ----------
    is_over : bool
        Whether no further construction is worth its time.
    """

    def __init__(self, task: SearchTask, until: float, repeats: bool = False) -> None:
        self.is_over = False
        self._task = task
        self._until = max(until, SECOND_UNTIL)
        self._later = until
        self._repeats = repeats
        self._share = 1.0  # the side for the last construction, as a share of `cell_side`
        self._spent = 0.0  # the share of the search that it took

    def first(
        self,
        problem: Problem,
        order: Ints,
        rng: npt.NDArray[np.uint64],
        budget: SearchBudget,
    ) -> float:
        """Return `cell_side`, or a larger side for the first construction if there is little time.

        Items that are not tried cost more than finer cells gain.

        Parameters
        ----------
        order : ndarray of int64
            The items in the order of the construction; the first ones are placed for an estimate.
        rng : ndarray of uint64, shape (1,)
            The state of the kernels' generator.
        budget : SearchBudget
            How much time there is.

        Returns
        -------
        float
            The side.
        """
        task, side = self._task, cell_side(problem, self._task)
        self._share = 1.0
        if budget.seconds_left < math.inf:
            cells_of(problem, side)  # whose time is not that of the items
            before = budget.seconds_left
            some, boxes = order[: math.ceil(TRIED * len(order))], boxes_of([task.size])
            filled_cells(problem, task, task.unplaced, boxes, some, rng, budget, side)
            seconds = (before - budget.seconds_left) / TRIED**GROWTH
            self._share = max(1.0, seconds / max(MOST_TIME * before, 1e-9)) ** (1 / COST)
        return self._share * side

    def next(self, problem: Problem, progress: float) -> float | None:
        """Return the side for the next construction; None if there is not enough time.

        Parameters
        ----------
        progress : float
            The share of the search that is over.

        Returns
        -------
        float or None
            The side.
        """
        share = FINER * self._share
        left = max(self._until - progress, 1e-9)
        share = max(share, self._share * (self._spent / left) ** (1 / COST))
        side = cell_side(problem, self._task)
        least = least_side(problem, FINEST * side) / side
        share = max(STEP ** math.floor(math.log(share, STEP)), least)
        if share > LEAST_FINER * self._share:
            if not self._repeats or self._spent > left:
                self.is_over = True
                return None
            share = self._share
        self._share = share
        self._until = self._later
        return share * side

    def spend(self, share: float) -> None:
        """Note the share of the search that the last construction took."""
        self._spent = share
