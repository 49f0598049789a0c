"""The search for the fewest boxes."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.nesting.filling import constructed, fitting, with_random_poses
from packit_sim.nesting.pose_kernels import box_of
from packit_sim.nesting.problem import Problem, boxes_of
from packit_sim.nesting.search import NestSearch
from packit_sim.nesting.separation import Separation
from packit_sim.nesting.tasks import Poses, SearchTask, Solution

_ALL_AT_ONCE = 0.3
"""Probability of an attempt to empty a box at once, not by one item."""

_SMALLER = 0.5
"""Probability of an attempt with a smaller box, where there are several sizes."""


class BinsSearch(NestSearch):
    """A search for the fewest boxes: move items out of the emptiest box, and again.

    Where there are several sizes, it also tries to put the items of a box into a smaller one. Of
    packings of as many boxes, that of the least volume is the best, and then that with the least
    volume of items in a box.

    Parameters
    ----------
    task : SearchTask
        The task.
    seed : int
        The seed.
    """

    def __init__(self, task: SearchTask, seed: int) -> None:
        super().__init__(task, seed)
        self._emptied: int | None = None
        self._smaller: list[Floats] = []
        self._numbers: Ints = np.empty(0, dtype=np.int64)
        self._boxes: Floats = np.empty((0, 4))
        self._staying: Ints = np.empty(0, dtype=np.int64)

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a better packing."""
        self.best = solution
        self._attempt = None
        boxes = solution.boxes
        self._numbers = _box_numbers(solution.poses, boxes)
        fills = np.bincount(self._numbers, self._task.volumes, len(boxes)).astype(float)
        fits = fitting(problem, self._task, np.vstack((boxes, boxes_of(self._task.sizes))))
        self._emptied = self._to_empty(fills, fits[:, : len(boxes)])
        self._smaller = self._with_a_smaller_box(boxes, fills, fits[:, len(boxes) :])
        volume = float(self._task.volumes.sum()) / math.prod(self._task.size)
        is_fewest = self._emptied is None or len(boxes) <= math.ceil(volume - 1e-9)
        self.is_done = is_fewest and not self._smaller

    def _constructed(self, problem: Problem) -> Solution:
        """Fill boxes of the largest size, and others with what does not fit into these."""
        fits = fitting(problem, self._task, boxes_of(self._task.sizes))
        largest = np.bincount(fits.argmax(axis=1), minlength=len(self._task.sizes))
        sizes = np.repeat(self._task.sizes, largest, axis=0).tolist()
        poses = constructed(problem, self._task, sizes, self._rng)
        return self._solution(poses, boxes_of(sizes))

    def _begun(self, problem: Problem, best: Solution) -> Separation:
        if self._smaller and (self._emptied is None or self._choices.random() < _SMALLER):
            self._boxes = self._smaller[self._choices.integers(len(self._smaller))]
            self._staying = np.empty(0, dtype=np.int64)
            return self._attempted(best.poses, self._boxes)
        assert self._emptied is not None
        poses, self._boxes = best.poses, best.boxes
        own = self._choices.permutation(np.flatnonzero(self._numbers == self._emptied))
        moved = own if self._choices.random() < _ALL_AT_ONCE else own[:1]
        self._staying = own[len(moved) :]
        inside = poses.inside.copy()
        inside[own] = 0
        left = Poses(inside, poses.turned, poses.places)
        others = np.delete(self._boxes, self._emptied, axis=0)
        items = moved.tolist()
        mixed = with_random_poses(problem, self._task, left, items, others, self._choices)
        return self._attempted(mixed, others)

    def _attempted(self, poses: Poses, boxes: Floats) -> Separation:
        return Separation(self._task, poses, boxes, self._task.settings.patience)

    def _end(self, problem: Problem, best: Solution, attempt: Separation, is_apart: bool) -> None:
        if not is_apart:
            return
        new, old, own = attempt.least, best.poses, self._staying
        inside, turned, places = new.inside.copy(), new.turned.copy(), new.places.copy()
        inside[own], turned[own], places[own] = 1, old.turned[own], old.places[own]
        self._offer(problem, self._solution(Poses(inside, turned, places), self._boxes))

    def _solution(self, poses: Poses, boxes: Floats) -> Solution:
        """Return the solution in the boxes that are used."""
        numbers = _box_numbers(poses, boxes)
        fills = np.bincount(numbers, self._task.volumes, len(boxes))
        used = np.flatnonzero(fills > 0)
        widest = max(size[0] for size in self._task.sizes)
        left = boxes_of(boxes[used, 1:].tolist(), widest)
        places = poses.places.copy()
        places[:, 0] += left[np.searchsorted(used, numbers), 0] - boxes[numbers, 0]
        score = (float(len(used)), _volume(left), float(fills[used].min()))
        return Solution(score, Poses(poses.inside, poses.turned, places), left)

    def _to_empty(self, fills: Floats, fits: npt.NDArray[np.bool_]) -> int | None:
        """Return the emptiest box of which each item fits into another one.

        fills: (b,), the volume of items in each box; fits: (n, b), which items fit into which.
        """
        for k in np.argsort(fills, kind="stable").tolist():
            if np.delete(fits[self._numbers == k], k, axis=1).any(axis=1).all():
                return int(k)
        return None

    def _with_a_smaller_box(
        self, boxes: Floats, fills: Floats, fits: npt.NDArray[np.bool_]
    ) -> list[Floats]:
        """Return the boxes with one of them replaced by a smaller one that might do.

        fills: (b,), the volume of items in each box; fits: (n, s), which items fit into which size.
        """
        found = []
        for k, fill in enumerate(fills.tolist()):
            for n, size in enumerate(self._task.sizes):
                changed = boxes.copy()
                changed[k, 1:] = size
                is_smaller = _volume(changed) < _volume(boxes)
                if is_smaller and fill <= math.prod(size) and fits[self._numbers == k, n].all():
                    found.append(changed)
        return found


def _volume(boxes: Floats) -> float:
    """Return the volume of all boxes."""
    return plain_sum(boxes[:, 1:].prod(axis=1).tolist())


def _box_numbers(poses: Poses, boxes: Floats) -> Ints:
    """Return the number of each item's box."""
    return np.array([box_of(boxes, x) for x in poses.places[:, 0]])
