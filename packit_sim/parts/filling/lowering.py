"""The search for the least height of all parts in one box."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from packit_sim.parts.filling.box_nesting import BoxNesting
from packit_sim.parts.filling.delivered_filling import ROUNDS, delivered_filling
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.boxes import BoxType

_STEPS = 0.08, 0.005
"""Shares by which a height is lowered at a time, at first and at last."""

_STEP_TIME = 0.25
"""Share of the time that is left for each."""


class Lowering:
    """A search for lower and lower packings of all parts.

    Parameters
    ----------
    counts : mapping of int to int
        How many of each part of the task.
    offer : callable
        Called with each lower packing in its box; returns the least height so far.
    left : callable
        Returns the seconds that are left.
    """

    def __init__(
        self,
        nesting: BoxNesting,
        box: BoxType,
        counts: Mapping[int, int],
        offer: Callable[[Packing], float],
        left: Callable[[], float],
    ) -> None:
        self._nesting, self._box, self._counts = nesting, box, counts
        self._offer, self._left = offer, left

    def run(self, packing: Packing, seed: int, start: Packing | None) -> None:
        """Search until the time is over.

        Parameters
        ----------
        packing : Packing
            A packing of all parts.
        start : Packing, optional
            What the nester begins with.
        """
        task = self._nesting.task
        is_strip = task.stretch == 1 and self._box.limits.balance is None and not task.stops
        if is_strip:
            self._lower_strip(seed, start)
        else:
            self._lower_box(packing.height, seed, start)

    def _lower_strip(self, seed: int, start: Packing | None) -> None:
        inner = self._nesting.inner(self._box)
        x, y, z = inner.size

        def better(packing: Packing) -> None:
            if packing.height <= z:
                packing = replace(packing, container=inner, objective="knapsack")
                self._offer(*self._nesting.in_boxes(packing, self._box))

        strip = BoxContainer((x, y, math.inf), inner.obstacles)
        self._nesting.nest(strip, "strip", self._counts, self._left(), better, seed, start)

    def _lower_box(self, height: float, seed: int, start: Packing | None) -> None:
        """Search for all parts in lower and lower boxes, where a strip is not possible."""
        margin, step = self._nesting.task.search_margin, _STEPS[0]
        while step >= _STEPS[1] and self._left() > 0:
            lower = height * (1 - step) + margin.top
            least = height

            def better(packing: Packing) -> None:
                nonlocal least
                if len(packing.placements) == sum(self._counts.values()):
                    least = self._offer(*self._nesting.in_boxes(packing, self._box))

            self._fill(lower, self._left() * _STEP_TIME, better, seed, start)
            step = step if least < height else step / 2
            height = least

    def _fill(
        self,
        height: float,
        seconds: float,
        better: Callable[[Packing], None],
        seed: int,
        start: Packing | None,
    ) -> None:
        """Fill the box up to a height."""
        box, counts = self._box, self._counts
        if not self._nesting.task.stops:
            inner = self._nesting.inner(box, height)
            self._nesting.nest(
                inner, "knapsack", counts, seconds, better, seed, start, limits=box.limits
            )
            return
        ordered = delivered_filling(self._nesting, box, counts, height)
        assert ordered is not None  # there are stops
        for number in range(ROUNDS):
            better(ordered.fill(seconds / ROUNDS, seed + number))
