"""Attempts to move overlapping items apart."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.conflict_kernels import load
from packit_sim.parts.nesting.filling import loaded
from packit_sim.parts.nesting.problem import Problem, State
from packit_sim.parts.nesting.separation_kernels import separate
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask

GAIN = 0.98
"""Share of the least overlap below which a pass counts as a gain."""


NEARLY = 1.0
"""Total overlap, in voxels, below which the surfaces compute the fields of simple items."""


class Separation:
    """An attempt to move overlapping items apart, which can be interrupted.

    Parameters
    ----------
    task : SearchTask
        The task.
    poses : Poses
        Where the items are at first.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    patience : int
        Passes without a gain after which it gives up.
    later : sequence of ndarray of int64
        Items that are left out at first, and join one set after the other when the rest is apart.

    Attributes
    ----------
    least : Poses
        The poses of least overlap so far.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    """

    def __init__(
        self,
        task: SearchTask,
        poses: Poses,
        boxes: Floats,
        patience: int,
        later: Sequence[Ints] = (),
    ) -> None:
        self._later = [items[poses.inside[items] > 0] for items in later]
        self.least = poses.changed(np.concatenate(self._later), 0) if later else poses
        self.boxes = boxes
        self._task = task
        self._patience = patience
        self._idle = 0
        self._overlap = math.inf
        self._is_precise = False
        self._state: State | None = None

    def swap(self, i: int, j: int) -> None:
        """Let two items change places before the attempt begins."""
        places = self.least.places.copy()
        places[[i, j]] = places[[j, i]]
        self.least = Poses(self.least.inside, self.least.turned, places)

    def advance(
        self,
        problem: Problem,
        rng: npt.NDArray[np.uint64],
        budget: SearchBudget,
        is_precise: bool,
    ) -> bool | None:
        """Go on until the items are apart, or it gives up, or the budget is spent.

        Parameters
        ----------
        problem : Problem
            The problem.
        rng : ndarray of uint64, shape (1,)
            The state of the kernels' generator.
        budget : SearchBudget
            The budget.
        is_precise : bool
            Whether the surfaces compute the fields of simple items also while much overlaps.

        Returns
        -------
        bool or None
            Whether `least` has no conflict; None if that is still open.
        """
        exact = problem
        self._is_precise = self._is_precise or is_precise or not exact.refined
        if not self._is_precise:
            problem = exact._replace(refined=False)
        if self._state is None:
            self._state = loaded(problem, self._task, self.least, self.boxes)
        found = self._task.state()
        while self._idle < self._patience:
            if self._overlap == 0:
                least = self.least
                if not load(problem, self._state, least.turned, least.places, self.boxes, True):
                    if not self._later:
                        return True
                    self.least = least.changed(self._later.pop(0), 1)
                    self._state = loaded(problem, self._task, self.least, self.boxes)
                    self._idle = 0
                self._overlap = math.inf
            if budget.is_spent:
                return None
            passes = budget.take()
            overlap = separate(
                problem,
                self._state,
                found,
                self.boxes,
                self._task.settings.samples,
                passes,
                rng,
            )
            is_gain = overlap < GAIN * self._overlap < math.inf
            self._idle = 0 if is_gain else self._idle + passes
            if overlap < self._overlap:
                self._overlap = overlap
                self.least = Poses.of(found)
            if self._overlap < NEARLY and not self._is_precise:
                problem, self._is_precise = exact, True
                self._state = loaded(problem, self._task, self.least, self.boxes)
                self._overlap = math.inf
        for items in self._later:
            self.least = self.least.changed(items, 1)
        return False
