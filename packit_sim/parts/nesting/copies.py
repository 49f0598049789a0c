"""The search for the most copies of one item in a box: arrange a block of them, and stack it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.filling import filled, least_heights, tops
from packit_sim.parts.nesting.knapsacks import KnapsackSearch
from packit_sim.parts.nesting.problem import Problem
from packit_sim.parts.nesting.strips import StripSearch
from packit_sim.parts.nesting.tasks import Poses, SearchBudget, SearchTask, Solution

_BLOCK = 40
"""Copies of a block: fewer lose more between blocks, and more are arranged far more slowly."""

_LEAST_HEIGHT = 2.5
"""Least height of a block, in heights of the item when it lies as low as it can."""


class CopiesSearch(KnapsackSearch):
    """A search for the most copies of one item in a box: arrange a block of them, and stack it.

    One more copy has no space anywhere as long as the gaps between the others are spread over the
    box. So copies are searched for as in a strip: let all sink, and put one more on top once there
    is space. That takes long with a hundred copies. So the box is cut into blocks of about the same
    height, of which one is arranged; the others are equal to it, or have a copy less.

    In every second round copies are exchanged and rebuilt, as other items are.
    """

    def __init__(self, task: SearchTask, seed: int) -> None:
        super().__init__(task, seed)
        self._seed = seed
        self._count = 1
        self._block: _Block | None = None
        self._lower: Solution | None = None  # the block of a copy less
        self._is_stacking = False

    def advance(self, problem: Problem, budget: SearchBudget) -> None:
        self._is_stacking = not self._is_stacking
        while self._is_stacking and self._block and not self._is_over(budget):
            self._block.advance(problem, budget)
            self._stack(problem, self._block)
        super().advance(problem, budget)

    def adopt(self, problem: Problem, solution: Solution) -> None:
        """Take over a packing of more copies."""
        super().adopt(problem, solution)
        self._good = self._current = self._rebuilt = solution.poses

    def restart(self) -> None:
        super().restart()
        self._block = self._lower = None

    def _constructed(self, problem: Problem) -> Solution:
        solution = super()._constructed(problem)
        self._begin_blocks(problem, solution.poses)
        return solution

    def _begin_blocks(self, problem: Problem, poses: Poses) -> None:
        """Cut the box into blocks, and begin with the lowest copies of the first packing."""
        packed = np.flatnonzero(self._packed(poses))
        least = float(least_heights(problem, self._task).min())
        most = max(1, int(self._task.size[2] / (_LEAST_HEIGHT * least)))
        self._count = min(most, max(1, round(len(packed) / _BLOCK)))
        lowest = packed[np.argsort(tops(problem, self._task, poses)[packed], kind="stable")]
        some = lowest[: len(packed) // self._count]
        self._begin_block(problem, poses.turned[some], poses.places[some])

    def _begin_block(self, problem: Problem, turned: Ints, places: Floats) -> None:
        """Search for a block of given copies and one more, unless there are no more."""
        task, copies = self._task, len(turned) + 1
        self._block = None
        if (copies - 1) * self._count >= task.count:
            return
        x, y, height = task.size
        start = Poses(
            task.unplaced.inside[:copies], np.append(turned, 0), np.vstack((places, np.zeros(3)))
        ).changed(np.arange(copies - 1), 1)
        own = replace(
            task,
            numbers=task.numbers[:copies],
            volumes=task.volumes[:copies],
            values=task.values[:copies],
            sizes=((x, y, math.inf),),
            start=start,
        )
        gaps = (self._count - 1) * problem.lookup.clearance
        self._block = _Block(own, self._seed, (height - gaps) / self._count)

    def _stack(self, problem: Problem, block: _Block) -> None:
        """Offer the blocks on top of each other, as many of the larger ones as there is space."""
        larger, smaller, blocks = block.best, self._lower, self._count
        if larger is None:
            return
        gap = problem.lookup.clearance
        more = blocks if block.is_low else 0
        if smaller is not None:
            if not more:
                left = self._task.size[2] + gap - blocks * (smaller.score[0] + gap)
                more = int(left / (larger.score[0] - smaller.score[0]))
            more = min(more, self._task.count - blocks * len(smaller.poses.inside))
        if more == blocks or (more and smaller is not None):
            stacked = [larger] * more + ([smaller] if smaller else []) * (blocks - more)
            poses = self._with_more(problem, self._stacked(stacked, gap))
            self._offer(problem, self._solution(poses))
        if block.is_low:
            self._lower = larger
            self._begin_block(problem, larger.poses.turned, larger.poses.places)
        elif block.is_done:  # as low as is possible
            self._block = None

    def _stacked(self, blocks: list[Solution], gap: float) -> Poses:
        poses = self._task.unplaced
        first, height = 0, 0.0
        for block in blocks:
            own = slice(first, first + len(block.poses.inside))
            poses.inside[own], poses.turned[own] = 1, block.poses.turned
            poses.places[own] = block.poses.places + np.array((0.0, 0.0, height))
            first, height = own.stop, height + block.score[0] + gap
        return poses

    def _with_more(self, problem: Problem, poses: Poses) -> Poses:
        """Put in one copy after the other, as long as one fits."""
        while len(out := np.flatnonzero(~self._packed(poses))):
            more = filled(problem, self._task, poses, self._boxes, out[:1], self._rng, self._budget)
            if not more.inside[out[0]]:
                break
            poses = more
        return poses


class _Block(StripSearch):
    """A search for a low strip that ends once the strip is low enough."""

    def __init__(self, task: SearchTask, seed: int, enough: float) -> None:
        super().__init__(task, seed)
        self._enough = enough

    @property
    def is_low(self) -> bool:
        """True if the strip is low enough."""
        return self.best is not None and self.best.score[0] <= self._enough

    def adopt(self, problem: Problem, solution: Solution) -> None:
        super().adopt(problem, solution)
        self.is_done = self.is_done or self.is_low
