"""The filling of one box with parts for several stops, those of the last stop deepest.

One stop after the other, the nester fills the box up to a distance from the wall behind, but for
the space behind parts that are there. Then each part is pushed straight in until it meets another
one or the wall: it can go straight out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import trimesh

from packit_sim.core.choices import Door
from packit_sim.core.sums import plain_sum
from packit_sim.parts.filling.box_nesting import BoxNesting
from packit_sim.parts.filling.shelf_filling import allowed
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.handling.removal import removal_of
from packit_sim.parts.handling.sweeps import AXES, INTO, OUT, PartSweeps
from packit_sim.parts.nesting.nest import NestingError
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.validity import pair_problems
from packit_sim.parts.reading.boxes import BoxType

_DENSITY = 0.3
"""Density at which a slab is filled at first, if there is space."""

_DENSER, _LOOSER = 1.15, 0.95
"""Factors of that density after a slab that took all parts of its stop, and after one that did
not."""

_FULL = 0.6
"""Share of the box's volume that the parts fill for which slabs are planned."""

_LEAST_TIME = 0.05
"""Share of the time that a stop gets at least."""

_STEPS = 40
"""Largest number of steps by which a part is moved back, until it keeps its distance."""

ROUNDS = 4
"""Times that a box is filled, at least if there is time."""

Nest = Callable[[BoxContainer, Mapping[int, int], float, int], Packing | None]
"""Nests some parts in a container, in some seconds and with a seed."""


class DeliveredFilling:
    """The filling of one box, in rounds that learn how thick slabs must be.

    Parameters
    ----------
    task : PackTask
        The task, with stops.
    inner : BoxContainer
        The space for parts inside the box.
    counts : mapping of int to int
        How many of each part may be in it.
    nest : callable
        See `Nest`.
    stops : mapping of int to int
        The stop of each part.
    door : str
        The side of the door.
    """

    def __init__(
        self,
        task: PackTask,
        inner: BoxContainer,
        counts: Mapping[int, int],
        nest: Nest,
        stops: Mapping[int, int],
        door: Door,
    ) -> None:
        self._task, self._inner, self._counts, self._nest = task, inner, counts, nest
        self._stop_of, self._door = stops, door
        self._axis, self._sign = AXES[OUT[door]]
        self._depth = inner.size[self._axis]
        self._area = inner.volume / self._depth
        self._gap = task.largest_gap * max(1.0, 1 / task.stretch)
        self._stops = sorted({stops[n] for n in counts}, reverse=True)
        self._planned = self._plan()
        self._densities = dict.fromkeys(self._stops, _DENSITY)

    def fill(self, seconds: float, seed: int) -> Packing:
        """Fill the box once.

        Returns
        -------
        Packing
            Parts in an order of packing, in the coordinates of the space for parts.
        """
        placed: list[Placement] = []
        total = plain_sum(self._planned.values())
        share = needed = 0.0
        for stop in self._stops:
            own = {n: k for n, k in self._counts.items() if self._stop_of[n] == stop}
            share += self._planned[stop] / total
            needed += self._planned[stop] / (self._area * self._densities[stop])
            end = max(min(needed, share * self._depth), self._thickest(own))
            end = self._depth if stop == self._stops[-1] else min(end, self._depth)
            time = seconds * max(self._planned[stop] / total, _LEAST_TIME)
            placed, left = self._filled(placed, own, end, time, seed)
            self._densities[stop] *= _LOOSER if left else _DENSER
        placed, _ = self._filled(placed, left, end, time, seed)  # pushing in left space
        return self._packing(placed)

    def _plan(self) -> dict[int, float]:
        """Return the volume for which each stop gets space, of the most valuable parts."""
        parts, weights = self._task.parts, self._task.weights
        left = _FULL * self._inner.volume
        found = dict.fromkeys(self._stops, 0.0)
        for n in sorted(self._counts, key=lambda n: -weights[n] / max(parts[n].volume, 1e-300)):
            volume = min(left, self._counts[n] * parts[n].volume)
            found[self._stop_of[n]] += volume
            left -= volume
        return found

    def _thickest(self, counts: Mapping[int, int]) -> float:
        """Return the thickness of a slab that each of some parts fits into."""
        least = (self._task.parts[n].sides[:, self._axis].min() for n in counts)
        return float(max(least, default=0.0)) * (1 + 1e-6)

    def _reach(self, placement: Placement) -> float:
        """Return how far a part reaches towards the door."""
        side = self._task.types[placement.type].vertices
        along = placement.apply(side)[:, self._axis]
        return float(along.max() if self._sign > 0 else self._depth - along.min())

    def _packing(self, placed: Sequence[Placement]) -> Packing:
        return self._task.packing(self._inner, placed)

    def _filled(
        self,
        placed: list[Placement],
        counts: Mapping[int, int],
        end: float,
        seconds: float,
        seed: int,
    ) -> tuple[list[Placement], dict[int, int]]:
        """Fill the box up to an end; return all parts in it, and how many are left."""
        if not counts:
            return placed, {}
        size, shift = list(self._inner.size), np.zeros(3)
        size[self._axis] = end
        shift[self._axis] = 0.0 if self._sign > 0 else self._depth - end
        bodies = [
            replace(each, vertices=each.vertices - shift, known_volume=each.volume)
            for each in (*self._inner.obstacles, *map(self._shadow, placed))
        ]
        slab = BoxContainer((size[0], size[1], size[2]), tuple(bodies), self._inner.name)
        own = {n: k for n, k in counts.items() if slab.has_space(self._task.parts[n], 0.0)}
        found = self._nest(slab, own, seconds, seed) if own else None
        if found is None:
            return placed, dict(counts)
        new = [replace(each, pose=each.pose.shifted(shift)) for each in found.placements]
        pushed = self._pushed(placed, new)
        packed = Counter(each.type for each in pushed[len(placed) :])
        left = {n: k - packed[n] for n, k in counts.items() if k > packed[n]}
        return pushed, left

    def _shadow(self, placement: Placement) -> ItemType:
        """Return a convex body around a part and all behind it, where it is in the way."""
        own = self._task.types[placement.type]
        corners = placement.apply(own.vertices)
        wall = corners.copy()
        wall[:, self._axis] = 0.0 if self._sign > 0 else self._depth
        hull = trimesh.convex.convex_hull(np.concatenate((corners, wall)))
        return ItemType(own.name, hull.vertices, hull.faces, clearance=own.clearance)

    def _pushed(self, placed: list[Placement], new: list[Placement]) -> list[Placement]:
        """Push parts in behind each other; those that can't go straight out are left out."""
        sweeps = PartSweeps(self._packing([*placed, *new]))
        order = self._order(sweeps, range(len(placed), len(placed) + len(new)))
        if self._inner.obstacles:  # they may be passed, but not be reached
            return [*placed, *(new[n - len(placed)] for n in order)]
        found, pushed = list(placed), dict.fromkeys(range(len(placed)), 0.0)
        items = [self._item(each) for each in placed]
        for n in order:
            distance = self._distance(sweeps, n, pushed) - self._gap
            clear = self._clear(new[n - len(placed)], distance, items)
            if clear is not None:
                pushed[n], placement = clear
                found.append(placement)
                items.append(self._item(placement))
        return found

    def _order(self, sweeps: PartSweeps, numbers: Sequence[int]) -> list[int]:
        """Return an order of loading, of which as little as needed is left out."""
        kept = list(numbers)
        while stuck := (found := removal_of(sweeps, kept, door=self._door, moves=1)).stuck:
            blocking = Counter(n for one in stuck for n in one.by)
            placed = sweeps.packing.placements
            kept.remove(
                min(blocking, key=lambda n: self._task.weights[placed[n].type] / blocking[n])
            )
        return list(reversed(found.order))

    def _distance(self, sweeps: PartSweeps, part: int, pushed: Mapping[int, float]) -> float:
        """Return how far a part can be pushed in, where others were pushed before it."""
        into = INTO[self._door]
        unit, axis = sweeps.unit, self._axis
        behind = sweeps.low[part] if self._sign > 0 else self._depth / unit - sweeps.high[part]
        found = float(behind[axis]) * unit + self._gap  # the wall needs no gap
        for other, _ in sweeps.in_the_way(part, pushed, into):
            gap = sweeps.distance(part, other, into) - sweeps.drawn_in(part, other)
            found = min(found, gap * unit + pushed[other])
        return found

    def _clear(
        self, placement: Placement, distance: float, items: Sequence[CheckedItem]
    ) -> tuple[float, Placement] | None:
        """Return the largest distance up to one at which a part is in no conflict."""
        slack = self._task.tolerance
        step = max(self._gap / 4, 2 * slack)
        keep = self._task.gap + slack if self._task.gap else 0.0
        shift = np.zeros(3)
        for _ in range(_STEPS):
            shift[self._axis] = -self._sign * distance
            moved = replace(placement, pose=placement.pose.shifted(shift))
            item = self._item(moved)
            conflicts = (
                problem
                for other in items
                for problem in pair_problems(other, item, keep, slack, self._task.stretch)
            )
            if self._reach(moved) > self._depth + slack:
                return None
            if next(conflicts, None) is None:
                return distance, moved
            distance -= step
        return None

    def _item(self, placement: Placement) -> CheckedItem:
        own = self._task.types[placement.type]
        return CheckedItem(own.name, own, placement, self._inner.longest)


def delivered_filling(
    nesting: BoxNesting, box: BoxType, counts: Mapping[int, int], height: float | None = None
) -> DeliveredFilling | None:
    """Return the filling of a box, up to a height if wanted, with as many parts as it may hold.

    Parts on which nothing may rest are filled in like parts of a first stop below a door at the
    top, after all others.

    Returns
    -------
    DeliveredFilling or None
        The filling; None if no order of the parts matters.
    """

    def fill(
        slab: BoxContainer, some: Mapping[int, int], seconds: float, seed: int
    ) -> Packing | None:
        found: list[Packing] = []
        with suppress(NestingError):
            nesting.nest(slab, "knapsack", some, seconds, found.append, seed)
        return found[-1] if found else None

    task, own = nesting.task, allowed(nesting.task, box, counts)
    stops, door = task.stops, task.settings.door
    if not stops:
        fragile = task.constraints.no_stack
        stops, door = {n: 1 if n in fragile else 2 for n in own}, "z+"
        if len(set(stops.values())) < 2:
            return None
    return DeliveredFilling(task, nesting.inner(box, height), own, fill, stops, door)
