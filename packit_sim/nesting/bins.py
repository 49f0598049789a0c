"""The search for the fewest boxes."""

from __future__ import annotations

import math

import numpy as np

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.nesting.filling import constructed, with_random_poses
from packit_sim.nesting.pose_kernels import box_of
from packit_sim.nesting.problem import Problem, boxes_of
from packit_sim.nesting.search import Search
from packit_sim.nesting.separation import Separation
from packit_sim.nesting.tasks import Poses, Solution, Task

_ALL_AT_ONCE = 0.3
"""Probability of an attempt to empty a box at once, not by one item."""


class BinsSearch(Search):
    """A search for the fewest boxes: move items out of the emptiest box, and again.

    Of packings of as many boxes, that with the least volume in a box is the best.

    Parameters
    ----------
    task : Task
        The task.
    seed : int
        The seed.
    """

    def __init__(self, task: Task, seed: int) -> None:
        super().__init__(task, seed)
        self._staying: Ints = np.empty(0, dtype=np.int64)

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a better packing."""
        self.best = solution
        volume = float(self._task.volumes.sum()) / math.prod(self._task.size)
        self.is_done = len(solution.boxes) <= math.ceil(volume - 1e-9)
        self._attempt = None

    def _constructed(self, problem: Problem) -> Solution:
        sizes = [self._task.size] * len(self._task.numbers)
        poses = constructed(problem, self._task, sizes, self._rng)
        return self._solution(poses, boxes_of(sizes))

    def _begun(self, problem: Problem, best: Solution) -> Separation:
        poses, boxes = best.poses, best.boxes
        numbers = _box_numbers(poses, boxes)
        emptiest = int(np.bincount(numbers, self._task.volumes, len(boxes)).argmin())
        own = self._choices.permutation(np.flatnonzero(numbers == emptiest))
        moved = own if self._choices.random() < _ALL_AT_ONCE else own[:1]
        self._staying = own[len(moved) :]
        inside = poses.inside.copy()
        inside[own] = 0
        others = np.delete(boxes, emptiest, axis=0)
        mixed = with_random_poses(
            problem,
            self._task,
            Poses(inside, poses.turned, poses.places),
            moved.tolist(),
            others,
            self._choices,
        )
        return Separation(self._task, mixed, others, self._task.settings.patience)

    def _end(self, problem: Problem, best: Solution, attempt: Separation, is_apart: bool) -> None:
        if not is_apart:
            return
        new, old, own = attempt.least, best.poses, self._staying
        inside, turned, places = new.inside.copy(), new.turned.copy(), new.places.copy()
        inside[own], turned[own], places[own] = 1, old.turned[own], old.places[own]
        found = self._solution(Poses(inside, turned, places), best.boxes)
        if found.score < best.score:
            self.adopt(problem, found)

    def _solution(self, poses: Poses, boxes: Floats) -> Solution:
        """Return the solution in the boxes that are used."""
        numbers = _box_numbers(poses, boxes)
        fills = np.bincount(numbers, self._task.volumes, len(boxes))
        used = np.flatnonzero(fills > 0)
        left = boxes_of([self._task.size] * len(used))
        places = poses.places.copy()
        places[:, 0] += left[np.searchsorted(used, numbers), 0] - boxes[numbers, 0]
        score = (float(len(used)), float(fills[used].min()))
        return Solution(score, Poses(poses.inside, poses.turned, places), left)


def _box_numbers(poses: Poses, boxes: Floats) -> Ints:
    """Return the number of each item's box."""
    return np.array([box_of(boxes, x) for x in poses.places[:, 0]])
