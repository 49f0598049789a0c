"""The search for the fewest boxes: empty one box after the other."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.filling import (
    constructed,
    filled,
    fitting,
    repaired,
    with_random_poses,
)
from packit_sim.parts.nesting.pose_kernels import box_of
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.search import Attempt, NestSearch
from packit_sim.parts.nesting.separation import Separation
from packit_sim.parts.nesting.tasks import Poses, SearchTask, Solution


class BinsSearch(NestSearch):
    """A search for the fewest boxes: move items out of the emptiest box, and repeat.

    Algorithm (our own, from separations): one item of the emptiest box goes to a random place in
    another box, or to the place of smaller items, which then go where they fit, even into the
    emptiest box. All items of the other boxes are separated. Where there are several sizes, the
    search also tries to put the items of a box into a smaller one.

    Among packings with equally many boxes, the one with the least total volume of boxes is best,
    then the one whose emptiest box holds the least volume: it is nearest to losing that box.
    """

    def __init__(self, task: SearchTask, seed: int) -> None:
        super().__init__(task, seed)
        self._emptied: int | None = None
        self._smaller: list[Floats] = []
        self._numbers: Ints = np.empty(0, dtype=np.int64)
        self._boxes: Floats = np.empty((0, 4))
        self._is_smaller = False
        self._fits = np.zeros((task.count, 0), bool)  # items x boxes

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a better packing."""
        self.best = solution
        self._attempt = None
        boxes = solution.boxes
        self._numbers = _box_numbers(solution.poses, boxes)
        fills = np.bincount(self._numbers, self._task.volumes, len(boxes)).astype(float)
        fits = fitting(problem, self._task, np.vstack((boxes, boxes_of(self._task.sizes))))
        self._fits = fits[:, : len(boxes)]
        self._emptied = self._to_empty(fills)
        self._smaller = self._with_a_smaller_box(boxes, fills, fits[:, len(boxes) :])
        volume = float(self._task.volumes.sum()) / math.prod(self._task.size)
        is_fewest = self._emptied is None or len(boxes) <= math.ceil(volume - 1e-9)
        self.is_done = is_fewest and not self._smaller

    def _constructed(self, problem: Problem) -> Solution:
        """Fill boxes of the largest size, then other boxes with the items that do not fit."""
        fits = fitting(problem, self._task, boxes_of(self._task.sizes))
        largest = np.bincount(fits.argmax(axis=1), minlength=len(self._task.sizes))
        sizes = np.repeat(self._task.sizes, largest, axis=0).tolist()
        poses = constructed(problem, self._task, sizes, self._rng)
        return self._solution(poses, boxes_of(sizes))

    def _begun(self, problem: Problem, best: Solution) -> Separation:
        self._is_smaller = bool(self._smaller) and (
            self._emptied is None or self._choices.random() < self._task.settings.smaller_box
        )
        if self._is_smaller:
            self._boxes = self._smaller[self._choices.integers(len(self._smaller))]
            poses = best.poses
        else:
            assert self._emptied is not None
            self._boxes = np.delete(best.boxes, self._emptied, axis=0)
            poses = self._with_one_more(problem, best.poses)
        return Separation(self._task, poses, self._boxes, self._task.settings.patience)

    def _with_one_more(self, problem: Problem, poses: Poses) -> Poses:
        """Return poses in all boxes but the emptiest, with one of its items added to them."""
        settings = self._task.settings
        is_own = self._numbers == self._emptied
        own, others = np.flatnonzero(is_own), np.flatnonzero(~is_own)
        volumes = self._task.volumes
        left = poses.changed(own, 0)
        if self._choices.random() >= settings.swap_probability:
            items = [int(self._choices.choice(own))]
            return with_random_poses(problem, self._task, left, items, self._boxes, self._choices)
        item = int(self._choices.choice(own, p=volumes[own] / volumes[own].sum()))
        around = others[self._fits[item, self._numbers[others]]]
        place = poses.places[self._choices.choice(around)]
        ways = np.linalg.norm(poses.places[others] - place, axis=1)
        near = others[ways.argsort(kind="stable")][: settings.swap_neighbours]
        left = left.changed(self._smaller_ones(near, volumes[item]), 0)
        found = with_random_poses(problem, self._task, left, [item], self._boxes, self._choices)
        found.places[item] = place
        return found

    def _smaller_ones(self, items: Ints, volume: float) -> Ints:
        """Choose items in order while their total volume stays below a limit."""
        found = []
        for i in items.tolist():
            if self._task.volumes[i] < volume:
                found.append(i)
                volume -= self._task.volumes[i]
        return np.array(found, np.int64)

    def _end(self, problem: Problem, best: Solution, attempt: Attempt, is_apart: bool) -> None:
        if self._is_smaller:
            if is_apart:
                self._offer(problem, self._solution(attempt.least, self._boxes))
            return
        poses, old = attempt.least, best.poses
        if not is_apart:
            poses = repaired(problem, self._task, poses, self._boxes)
        poses = filled(problem, self._task, poses, self._boxes, self._task.order, self._rng)
        # Items of the emptiest box that found no place in the others stay where they were; those
        # that made space for another item may join them there.
        stays = (self._numbers == self._emptied) & (poses.inside == 0)
        poses = Poses(
            np.where(stays, old.inside, poses.inside),
            np.where(stays, old.turned, poses.turned),
            np.where(stays[:, None], old.places, poses.places),
        )
        poses = filled(problem, self._task, poses, best.boxes, self._task.order, self._rng)
        if poses.inside.all():
            self._offer(problem, self._solution(poses, best.boxes))

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

    def _to_empty(self, fills: Floats) -> int | None:
        """Return the emptiest box, by the volumes (b,) in each, whose items all fit into others."""
        for k in np.argsort(fills, kind="stable").tolist():
            if np.delete(self._fits[self._numbers == k], k, axis=1).any(axis=1).all():
                return int(k)
        return None

    def _with_a_smaller_box(
        self, boxes: Floats, fills: Floats, fits: npt.NDArray[np.bool_]
    ) -> list[Floats]:
        """Return all ways to replace one box by a smaller one that its items might fit into.

        fills: (b,), the volume of items in each box; fits: (n, s), True where an item fits a size.
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
