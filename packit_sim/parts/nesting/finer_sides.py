"""The sides of cells of one construction after the other, as long as there is time for finer ones.

A construction on finer cells is denser, and takes longer by about the third power of their number
along a side.
"""

from __future__ import annotations

import math

from packit_sim.parts.nesting.cell_filling import COST, cell_side
from packit_sim.parts.nesting.cells import least_side
from packit_sim.parts.nesting.problem import Problem
from packit_sim.parts.nesting.tasks import SearchTask

FINER = 0.6
"""Side of the cells of a further construction, as a share of those before, if there is time."""

LEAST_FINER = 0.85
"""The largest such share for which a construction is worth its time."""

STEP = 0.9
"""Sides are those of the first construction times powers of this: searches share their cells."""

FINEST = 0.45
"""Least side of the cells of a construction, as a share of the first one's."""


class FinerSides:
    """The sides of the cells of further constructions.

    Parameters
    ----------
    until : float
        The share of the search after which there is no further construction.
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
        self._until = until
        self._repeats = repeats
        self._share = 1.0  # cells of the last construction, as a share of the first one's
        self._spent = 0.0  # the share of the search that it took

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
        if self._spent > 0:
            left = max(self._until - progress, 1e-9)
            share = max(share, self._share * (self._spent / left) ** (1 / COST))
        side = cell_side(problem, self._task)
        least = least_side(problem, FINEST * side) / side
        share = max(STEP ** math.floor(math.log(share, STEP)), least)
        if share > LEAST_FINER * self._share:
            if not self._repeats or self._spent > self._until - progress:
                self.is_over = True
                return None
            share = self._share
        self._share = share
        return share * side

    def spend(self, share: float) -> None:
        """Note the share of the search that the last construction took."""
        self._spent = share
