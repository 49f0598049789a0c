"""Evening: parts move until the packed area varies less from layer to layer."""

from __future__ import annotations

import time as clock
from dataclasses import replace

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.layers import COUNT, cut_area, layers, variation
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.validity import pair_problems

_CUTS = 100
"""Cuts through a part, between which areas are interpolated for a trial."""

_TRIES = 200
"""Trials for each part without a gain after which a box is left as it is."""

_ROUNDING = 1e-9
"""Rounding of distances from the walls, relative to the container's longest side."""

_SWAPS = 0.4
"""Probability that two parts exchange their places; else one part moves."""

_STRAIGHT = 0.5
"""Probability that a part only moves up or down."""


def evened(packed: PackedParts, seconds: float, seed: int) -> PackedParts:
    """Move the parts of each box, none above the highest one, so that layers have like areas.

    Algorithm: random descent. A part moves, or two exchange their places, if the coefficient of
    variation of the layers' areas falls and the packing stays valid.

    Parameters
    ----------
    seconds : float
        The time for all boxes.

    Returns
    -------
    PackedParts
        The same parts in the same boxes, with a note on the variation before and after.
    """
    if not packed.packings:
        return packed
    end = clock.perf_counter() + seconds
    boxes, notes = [], []
    for number, packing in enumerate(packed.packings, start=1):
        share = (end - clock.perf_counter()) / (len(packed.packings) - number + 1)
        box = _Evening(packed.task, packing, np.random.default_rng(seed + number))
        found = box.run(clock.perf_counter() + share)
        before, after = layers(packing).variation, layers(found).variation
        found, after = (found, after) if after < before else (packing, before)
        boxes.append(found)
        notes.append(
            f"box {number} is evened: the area of its layers varies by {after:.3f} of the mean, "
            f"before by {before:.3f}"
        )
    return replace(packed, packings=tuple(boxes), changes=tuple(notes))


class _Evening:
    """The descent for one box."""

    def __init__(self, task: PackTask, packing: Packing, rng: np.random.Generator) -> None:
        self._task, self._packing, self._rng = task, packing, rng
        container = packing.container
        self._unit = container.longest
        self._placed = list(packing.placements)
        self._items = [self._item(one) for one in self._placed]
        self._around = [
            CheckedItem(each.name, each, Placement(0), self._unit) for each in container.obstacles
        ]
        self._top = packing.height
        self._heights = (np.arange(COUNT) + 0.5) * self._top / COUNT
        known: dict[tuple[int, bytes], Floats] = {}
        self._cuts = []
        for one, item in zip(self._placed, self._items, strict=True):
            key = one.type, one.pose.rotation.tobytes()
            if key not in known:
                known[key] = _cuts(item)
            self._cuts.append(known[key])
        self._areas = np.array([self._profile(n, each) for n, each in enumerate(self._items)])

    def run(self, end: float) -> Packing:
        """Move parts until the time is over or nothing more is gained."""
        idle, count = 0, len(self._placed)
        is_counted = self._task.settings.iterations is not None
        stop = self._task.settings.stop
        least = variation(self._areas.sum(axis=0))
        while idle < _TRIES * count and (is_counted or clock.perf_counter() < end):
            if stop is not None and stop.is_set():
                break
            found = self._moved(self._trial(), least)
            idle = 0 if found < least else idle + 1
            least = found
        return replace(self._packing, placements=tuple(self._placed))

    def _trial(self) -> dict[int, Placement]:
        """Return other placements of one or two parts."""
        rng, limits = self._rng, self._task.limits(self._packing)
        n = int(rng.integers(len(self._placed)))
        item = self._items[n]
        is_straight = limits.balance is not None  # which parts that move aside may break
        if not is_straight and rng.random() < _SWAPS:
            m = int(rng.integers(len(self._placed)))
            way = (self._items[m].low + self._items[m].high - item.low - item.high) / 2
            return {n: self._shifted(n, way), m: self._shifted(m, -way)} if m != n else {}
        margin = self._task.margin
        high = np.array((*self._packing.container.size[:2], self._top))
        high -= (*margin.upper[:2], 0)
        place = margin.lower + rng.random(3) * np.maximum(
            high - margin.lower - (item.high - item.low), 0
        )
        way = place - item.low
        if is_straight or rng.random() < _STRAIGHT:
            way[:2] = 0
        return {n: self._shifted(n, way)}

    def _moved(self, trial: dict[int, Placement], least: float) -> float:
        """Move parts if that is better than the least variation so far; return the least one."""
        items = {n: self._item(one) for n, one in trial.items()}
        if not items or any(each.high[2] > self._top for each in items.values()):
            return least
        areas = self._areas.copy()
        for n, item in items.items():
            areas[n] = self._profile(n, item)
        found = variation(areas.sum(axis=0))
        if found >= least or not self._is_valid(items):
            return least
        self._areas = areas
        for n, item in items.items():
            self._items[n], self._placed[n] = item, trial[n]
        return found

    def _is_valid(self, items: dict[int, CheckedItem]) -> bool:
        """Return whether some parts may be where they are, with all others."""
        task, container = self._task, self._packing.container
        others = [each for n, each in enumerate(self._items) if n not in items] + self._around
        for item in items.values():
            if any(True for _ in container.faults(item, task.margin, _ROUNDING * self._unit)):
                return False
            for other in others:
                gaps = np.maximum(item.low, other.low) - np.minimum(item.high, other.high)
                if (gaps * (1, 1, task.stretch) > task.largest_gap).any():
                    continue
                if any(True for _ in pair_problems(other, item, task.gap, 0.0, task.stretch)):
                    return False
            others.append(item)
        return True

    def _shifted(self, number: int, way: Floats) -> Placement:
        one = self._placed[number]
        return replace(one, pose=Motion.shift(way) @ one.pose)

    def _item(self, one: Placement) -> CheckedItem:
        return CheckedItem("a part", self._task.types[one.type], one, self._unit)

    def _profile(self, number: int, item: CheckedItem) -> Floats:
        """Return the area of a part in each layer."""
        at = (self._heights - item.low[2]) / (item.high[2] - item.low[2]) * _CUTS - 0.5
        inside = (self._heights > item.low[2]) & (self._heights < item.high[2])
        return np.where(inside, np.interp(at, np.arange(_CUTS), self._cuts[number]), 0.0)


def _cuts(item: CheckedItem) -> Floats:
    """Return the areas of a part at evenly spaced heights of its own."""
    side = item.high[2] - item.low[2]
    heights = item.low[2] + (np.arange(_CUTS) + 0.5) * side / _CUTS
    triangles = item.vertices[item.item_type.faces]
    return np.array([cut_area(triangles, height) for height in heights.tolist()])
