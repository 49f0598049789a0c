"""The nester on the boxes of a task: in the space for parts inside the margins of the walls."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.balance import nest_balance
from packit_sim.parts.filling.shelves import Shelves
from packit_sim.parts.filling.stretching import StretchedTypes
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.nesting.nest import NestSettings, nest
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.limits import NO_LIMITS, Limits

_SECONDS = 0.05, 1e6
"""Seconds that a search gets, at least and at most."""


class BoxNesting:
    """The nester on the boxes of a task.

    Parameters
    ----------
    task : PackTask
        The task.
    stopped : threading.Event
        Ends a search when it is set.
    """

    def __init__(self, task: PackTask, stopped: threading.Event) -> None:
        self.task = task
        self._stopped = stopped
        self._known_bodies: dict[BoxType, tuple[ItemType, ...]] = {}
        self._known_shelves: dict[tuple[float, ...], Shelves] = {}

    def inner(self, box: BoxType, height: float | None = None) -> BoxContainer:
        """Return the space for parts inside a box, of another height if wanted."""
        margin = self.task.search_margin
        sides = (*box.size[:2], box.size[2] if height is None else height)
        x, y, z = (np.array(sides) - margin.lower - margin.upper).tolist()
        return BoxContainer((x, y, z), self.bodies(box), box.name)

    def bodies(self, box: BoxType) -> tuple[ItemType, ...]:
        """Return what is in a box and around it, in the coordinates of the inner container.

        A container that is no box is searched as its bounding box, and what is around it there as
        bodies that do not move.
        """
        if box not in self._known_bodies:
            task, margin = self.task, self.task.search_margin
            across = task.gap if form_of(box.container) == "cylinder" else task.least_gap
            walls = box.container.walls(margin, across)
            self._known_bodies[box] = tuple(
                replace(each, vertices=each.vertices - margin.lower, known_volume=each.volume)
                for each in (*task.container(box).obstacles, *walls)
            )
        return self._known_bodies[box]

    def shelves(self, box: BoxType) -> Shelves:
        """Return the shelves of a box, which those of the same size share."""
        if box.size not in self._known_shelves:
            self._known_shelves[box.size] = Shelves(self.task, box.size)
        return self._known_shelves[box.size]

    def nest(
        self,
        containers: BoxContainer | Sequence[BoxContainer],
        objective: str,
        counts: Mapping[int, int],
        seconds: float,
        better: Callable[[Packing], None],
        seed: int,
        start: Packing | None = None,
        limits: Limits = NO_LIMITS,
        by_volume: bool = False,
    ) -> None:
        """Nest some of the parts in inner containers.

        Parameters
        ----------
        counts : mapping of int to int
            How many of each part of the task.
        better : callable
            Called with each better packing, whose types are those of all parts.
        start : Packing, optional
            The contents of a box to begin with.
        limits : Limits
            What the box may hold.
        by_volume : bool
            Whether the volume of parts counts instead of what they are worth.

        Raises
        ------
        NestingError
            If no valid packing was found.
        """
        task, settings = self.task, self.task.settings
        numbers = sorted(counts)
        values = [each.volume for each in task.types] if by_volume else task.weights
        types = [task.types[n].changed(counts[n], value=values[n]) for n in numbers]
        first = None if start is None else self._start(start, types, numbers)
        sums = limits.sums([task.parts[n].mass for n in numbers])
        balance = nest_balance(task, limits, numbers, containers)
        stretched: StretchedTypes | None = None
        own, container = tuple(types), containers
        if task.stretch != 1:
            assert isinstance(containers, BoxContainer)
            stretched = StretchedTypes(types, task.stretch)
            own, container = stretched.types, stretched.container(containers)
            sums = stretched.limits(sums, [counts[n] for n in numbers])
            balance = balance and stretched.balance(balance)
            if first is not None:
                known = filter(None, map(stretched.stretched, first.placements))
                first = Packing(own, container, tuple(known), 0.0, "knapsack")

        def of_all(packing: Packing, _: float) -> None:
            found = packing.placements
            if stretched is not None:
                assert isinstance(containers, BoxContainer)
                found = tuple(map(stretched.unstretched, found))
                packing = replace(packing, container=containers)
            placements = [replace(one, type=numbers[one.type]) for one in found]
            better(replace(packing, types=task.types, placements=tuple(placements)))

        nest(
            own,
            container,
            objective,
            min(max(seconds, _SECONDS[0]), _SECONDS[1]),
            seed,
            task.gap,
            of_all,
            NestSettings(
                settings.workers,
                settings.backend,
                settings.address,
                settings.iterations,
                start=first,
                stop=self._stopped,
                limits=sums,
                balance=balance,
            ),
        )

    def _start(
        self, packing: Packing, types: Sequence[ItemType], numbers: Sequence[int]
    ) -> Packing:
        """Move the parts of a box into the inner container, as a packing of some types."""
        box = next(each for each in self.task.boxes if each.name == packing.container.name)
        inner_from_box = Motion.shift(-self.task.search_margin.lower)
        own = {number: n for n, number in enumerate(numbers)}
        placements = [
            replace(one, type=own[one.type], pose=inner_from_box @ one.pose, box=0)
            for one in packing.placements
            if one.type in own
        ]
        return Packing(tuple(types), self.inner(box), tuple(placements), 0.0, "knapsack")

    def in_boxes(self, packing: Packing, *types: BoxType) -> list[Packing]:
        """Move a packing from the inner containers into its boxes, which are of some types."""
        by_size = {self.inner(each).size: each for each in reversed(types)}
        box_from_inner = Motion.shift(self.task.search_margin.lower)
        found: dict[int, list[Placement]] = {}
        for one in packing.placements:
            moved = replace(one, pose=box_from_inner @ one.pose, box=0)
            found.setdefault(one.box, []).append(moved)
        return [
            self.task.packing(self.task.container(box), found[n])
            for n in sorted(found)
            for box in [by_size.get(packing.container_of(n).size, types[0])]
        ]
