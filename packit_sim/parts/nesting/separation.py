"""Attempts to move overlapping items apart: the separation step of every search.

A search makes its packing infeasible (a lower strip, other items, a box less) and asks a separation
to remove the overlaps. The kernels do the moves (`separation_kernels`); a separation decides how
long to try, when the surfaces take over from stored distances, and when the result is accepted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from packit_sim.core.debugging import is_checking
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.conflict_kernels import load
from packit_sim.parts.nesting.filling import loaded
from packit_sim.parts.nesting.problem import Problem, State
from packit_sim.parts.nesting.separation_kernels import separate
from packit_sim.parts.nesting.state_checks import StateCheck
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask


class Separation:
    """An attempt to move overlapping items apart, which can be interrupted.

    Algorithm: separation by guided local search. Overlap, weighted by pair, is minimised by moving
    one item at a time, and the weights of pairs that stay in overlap grow (Egeblad, Nielsen and
    Brazil, 2009; as a separation procedure in sparrow, Gardeyn, Vanden Berghe and Wauters, 2025).

    Parameters
    ----------
    poses : Poses
        The poses to begin with.
    boxes : ndarray of float64, shape (b, 4)
        The boxes.
    patience : int
        Passes without a gain after which it gives up, and conflicts that the surfaces find without
        an overlap by stored distances.
    later : sequence of ndarray of int64
        Sets of items that are left out at first; each joins when the items before it are apart.
    most_patience : int
        The patience until `patient_share` of the search has passed since the last gain.

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
        most_patience: int = 0,
    ) -> None:
        self._later = [items[poses.inside[items] > 0] for items in later]
        self.least = poses.changed(np.concatenate(self._later), 0) if later else poses
        self.boxes = boxes
        self._task = task
        self._patience = patience
        self._most_patience = max(patience, most_patience)
        self._gained = math.inf  # the share of the search that was over at the last gain
        self._idle = 0
        self._refusals = 0
        self._overlap = math.inf
        self._is_precise = False
        self._state: State | None = None

    def swap(self, i: int, j: int) -> None:
        """Exchange the positions of two items before the attempt begins."""
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
        """Continue as `search.Attempt.advance` says."""
        settings = self._task.settings
        check = StateCheck(problem, self._state) if is_checking() else None
        exact = problem
        self._is_precise = self._is_precise or is_precise or not exact.refined
        if not self._is_precise:
            problem = exact._replace(refined=False)
        if self._state is None:
            self._state = loaded(problem, self._task, self.least, self.boxes)
        found = self._task.state()
        self._gained = min(self._gained, budget.progress)
        while not self._gives_up(budget):
            if self._overlap == 0:
                # Stored distances see no overlap, but only the surfaces can accept the poses: a
                # conflict that they find gets a margin, so that the pair overlaps from now on.
                least = self.least
                if not load(problem, self._state, least.turned, least.places, self.boxes, True):
                    if not self._later:
                        return True
                    self.least = least.changed(self._later.pop(0), 1)
                    self._state = loaded(problem, self._task, self.least, self.boxes)
                    self._idle = self._refusals = 0
                else:
                    self._refusals += 1
                self._overlap = math.inf
            if budget.is_spent:
                return None
            passes = budget.take(settings.passes_at_once)
            weights = *settings.weight_growth, settings.weight_decay
            overlap = separate(
                problem, self._state, found, self.boxes, settings.samples, passes, weights, rng
            )
            if check is not None:
                check(problem, self._state, self.boxes)
            # The first overlap after a change of the measure (infinite before) is no gain, unless
            # nothing overlaps any more.
            is_gain = overlap == 0 or overlap < settings.gain * self._overlap < math.inf
            self._idle = 0 if is_gain else self._idle + passes
            if is_gain and overlap > 0:
                self._gained = budget.progress
            if overlap < self._overlap:
                self._overlap = overlap
                self.least = Poses.of(found)
            if self._overlap < settings.precise_overlap and not self._is_precise:
                # Overlaps by exact nodes are not comparable with those before: load again.
                problem, self._is_precise = exact, True
                self._state = loaded(problem, self._task, self.least, self.boxes)
                self._overlap = math.inf
        for items in self._later:
            self.least = self.least.changed(items, 1)
        return False

    def _gives_up(self, budget: SearchBudget) -> bool:
        """Return whether the last gain was too long ago."""
        idle = max(self._idle, self._refusals)
        is_long = budget.progress - self._gained >= self._task.settings.patient_share
        return idle >= (self._patience if is_long else self._most_patience)
