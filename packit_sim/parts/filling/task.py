"""The task: prepared parts, boxes, the objective, and constraints."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from packit_sim.core.caches import cached_property
from packit_sim.core.choices import Goal
from packit_sim.core.length_units import UNITS_CM, Unit
from packit_sim.core.sums import plain_sum
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.packings import checked_items
from packit_sim.parts.packings.bounds import SUM_ROUNDING
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.distances import WallClearance, stretch
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.files import UnreadFile
from packit_sim.parts.reading.limits import NO_LIMITS, Limits
from packit_sim.parts.reading.prepared import PreparedPart, largest_sum
from packit_sim.parts.reading.sizes import fits, too_large


@dataclass(frozen=True, eq=False)
class PackTask:
    """Parts to pack, and the boxes for them.

    Attributes
    ----------
    objective : str
        See `core.choices.Goal`.
    keep_out : tuple of PreparedPart
        The volumes that stay free in every box.
    fixed : tuple of PreparedPart
        The parts that are in the box already.
    unread : tuple of UnreadFile
        The files that could not be read.
    notes : tuple of str
        How files were understood, and what is doubtful.
    inputs : tuple of Path
        The files that were read, or should have been.
    outlines : mapping of str to PreparedPart
        The meshes of the boxes that are meshes, by their names.
    """

    parts: tuple[PreparedPart, ...]
    boxes: tuple[BoxType, ...]
    objective: Goal
    settings: PackSettings
    keep_out: tuple[PreparedPart, ...] = ()
    fixed: tuple[PreparedPart, ...] = ()
    unread: tuple[UnreadFile, ...] = ()
    notes: tuple[str, ...] = ()
    inputs: tuple[Path, ...] = ()
    outlines: Mapping[str, PreparedPart] = field(default_factory=dict)

    @property
    def unit(self) -> Unit:
        """The unit of all lengths."""
        return self.settings.unit or "mm"

    @cached_property
    def types(self) -> tuple[ItemType, ...]:
        """The types of items, one for each part, with its worth as the value.

        Those of fixed parts follow.
        """
        found = (
            self._kept_apart(each).changed(value=weight)
            for each, weight in zip(self.parts, self.weights, strict=True)
        )
        return (*found, *map(self._kept_apart, self.fixed))

    def _kept_apart(self, part: PreparedPart) -> ItemType:
        """Return the type of a part, with the distance of collision meshes if it has its own."""
        if part.clearance is None:
            return part.item_type
        return part.item_type.changed(clearance=part.clearance + self._deviations)

    @property
    def all_parts(self) -> tuple[PreparedPart, ...]:
        """The parts, and then those that are fixed."""
        return (*self.parts, *self.fixed)

    @property
    def all_meshes(self) -> tuple[PreparedPart, ...]:
        """The meshes of all parts, of volumes that stay free, and of containers."""
        return (*self.all_parts, *self.keep_out, *self.outlines.values())

    @property
    def obstacles(self) -> tuple[PreparedPart, ...]:
        """Volumes that stay free, and fixed parts: all that the parts keep clear of."""
        return (*self.keep_out, *self.fixed)

    @cached_property
    def constraints(self) -> Constraints:
        """The built-in constraints on the parts of each box, `fixed` ones included."""
        settings = self.settings
        parts = [each.part for each in self.all_parts]
        max_loads = {n: one.max_load for n, one in enumerate(parts) if one.max_load is not None}
        centimetres = UNITS_CM[self.unit]
        return Constraints(
            removable=settings.removable,
            insertable=settings.insertable,
            separable=settings.separable,
            door=settings.door,
            stops=self.stops,
            stable=settings.stable,
            no_stack=frozenset(n for n, one in enumerate(parts) if one.no_stack),
            max_loads=max_loads,
            masses=tuple(
                each.volume * centimetres**3 if each.mass is None else each.mass
                for each in self.all_parts
            ),
            fixed=frozenset(range(len(self.fixed))),
            unit=self.unit,
        )

    @cached_property
    def stops(self) -> dict[int, int]:
        """The stop of each part, by its number, if they are delivered; else empty."""
        if self.settings.order is None:
            return {}
        return {n: each.part.stop for n, each in enumerate(self.parts) if each.part.stop}

    @cached_property
    def groups(self) -> dict[str, list[int]]:
        """The numbers of the parts of each group."""
        found: dict[str, list[int]] = {}
        for n, each in enumerate(self.parts):
            if each.part.group is not None:
                found.setdefault(each.part.group, []).append(n)
        return found

    def may_hold(self, box: BoxType, numbers: Sequence[int]) -> bool:
        """Return whether a box may hold all of some parts, by their volumes and its limits."""
        parts = [self.parts[n] for n in numbers]
        volume = plain_sum(each.volume * each.part.count for each in parts)
        masses = [each.mass for each in parts for _ in range(each.part.count)]
        limits = box.limits.faults(masses)
        is_small = volume <= box.container.volume * (1 + SUM_ROUNDING)
        return is_small and not limits and all(fits(each, box, self.margin) for each in parts)

    def limits(self, packing: Packing) -> Limits:
        """Return the limits of the box of a packing."""
        name = packing.container.name
        return next((box.limits for box in self.boxes if box.name == name), NO_LIMITS)

    def masses_in(self, packing: Packing) -> list[float | None]:
        """Return the grams of each part in a packing, without the fixed ones."""
        return [self.parts[one.type].mass for one in packing.placements]

    @cached_property
    def gravities(self) -> tuple[float, ...]:
        """The weight of each part in a balance: its mass, or its volume if no part has a mass."""
        return tuple(each.volume if each.mass is None else each.mass for each in self.parts)

    @property
    def is_constrained(self) -> bool:
        """True if there are constraints."""
        return not self.constraints.is_empty or len(self.settings.constraints) > 0

    @cached_property
    def too_large(self) -> dict[int, str]:
        """The numbers of the parts that fit into no box, with the reasons."""
        reasons = (too_large(each, self.boxes, self.margin, self.unit) for each in self.parts)
        return {n: reason for n, reason in enumerate(reasons) if reason}

    @cached_property
    def tolerance(self) -> float:
        """The largest depth by which the nester lets items reach into each other."""
        longest = max(max(box.size) for box in self.boxes)
        return max(
            (
                checked_items.tolerance(longest, float(each.item_type.extents.max()))
                for each in (*self.parts, *self.obstacles)
            ),
            default=0.0,
        )

    def container(self, box: BoxType) -> Container:
        """Return a box with what the parts keep clear of."""
        return box.container.with_obstacles(list(map(self._kept_apart, self.obstacles)))

    def packing(self, container: Container, placements: Sequence[Placement]) -> Packing:
        """Return a packing of this task in one of its boxes."""
        gap_z = None if self.stretch == 1 else self.gap / self.stretch
        return Packing(
            *(self.types, container, tuple(placements), self.gap, "knapsack"), clearance_z=gap_z
        )

    def with_fixed(self, packing: Packing) -> Packing:
        """Return a packing of this task with the fixed parts as its first placements."""
        first = len(self.parts)
        fixed = [Placement(first + n) for n in range(len(self.fixed))]
        container = packing.container.with_obstacles(())
        placements = (*fixed, *packing.placements)
        return replace(packing, container=container, placements=placements)

    @property
    def stretch(self) -> float:
        """By what lengths along z are multiplied before distances are measured."""
        return stretch(self.settings.clearance, self.settings.clearance_z)

    @cached_property
    def gap(self) -> float:
        """The distance of two collision meshes that keeps the clearance of the files' surfaces."""
        return self.settings.clearance + self._deviations

    @property
    def least_gap(self) -> float:
        """The same in the direction in which it is least."""
        return self.gap * min(1.0, 1 / self.stretch)

    @cached_property
    def _deviations(self) -> float:
        """How much less the distance of two files' surfaces may be."""
        return largest_sum((*self.parts, *self.obstacles)) * max(1.0, self.stretch)

    @cached_property
    def largest_gap(self) -> float:
        """The same for the part that keeps the largest distance."""
        every = map(self._kept_apart, (*self.parts, *self.obstacles))
        return max(self.gap, *(each.clearance or 0.0 for each in every))

    @cached_property
    def walls(self) -> WallClearance:
        """The distances of files' surfaces from the walls."""
        return WallClearance.of(self.settings.wall_clearance)

    @cached_property
    def margin(self) -> WallClearance:
        """The distances of collision meshes from the walls, for the same purpose."""
        deviation = max((each.deviation for each in self.parts), default=0.0)
        walls = max((each.deviation for each in self.outlines.values()), default=0.0)
        return self.walls.plus(deviation + walls)

    @cached_property
    def search_margin(self) -> WallClearance:
        """The same for the nester, which lets items reach beyond walls by the tolerance."""
        if self.stretch == 1 and not self.walls.largest:
            return self.margin
        return self.margin.plus(self.tolerance * max(self.stretch, 1 / self.stretch))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that decides which packing is better."""
        settings = self.settings
        numbers: tuple[object, ...] = (settings.clearance, settings.wall_clearance)
        numbers += () if settings.clearance_z is None else (settings.clearance_z,)
        numbers += (settings.accuracy, self.unit)
        numbers += (sorted(settings.groups),) if settings.groups else ()
        loading = settings.door, settings.order
        numbers += () if loading == ("z+", None) else loading
        boxes = [
            (box.name, box.size, box.count, *(() if box.limits.is_empty else (box.limits,)))
            for box in self.boxes
        ]
        asked = (settings.removable, settings.insertable, settings.separable, settings.stable)
        constraints = list(map(repr, settings.constraints))
        text = repr((self.objective, numbers, boxes, asked, constraints))
        sha = hashlib.sha256(text.encode())
        for each in (*self.parts, *self.obstacles):
            sha.update(each.part.digest.encode())
        sha.update(repr((len(self.keep_out), len(self.fixed))).encode())
        for box in self.boxes:
            if box.form is not None:
                sha.update(form_of(box.form).encode())
        for name in sorted(self.outlines):
            sha.update(self.outlines[name].part.digest.encode())
        return sha.hexdigest()

    @cached_property
    def worth(self) -> tuple[float, ...]:
        """The worth of one of each part by the objective, among parts of the same priority."""
        if self.objective == "count":
            return (1.0,) * len(self.parts)
        if self.objective == "value":
            values = (each.part.value for each in self.parts)
            return tuple(1.0 if value is None else value for value in values)
        return tuple(each.volume for each in self.parts)

    @cached_property
    def weights(self) -> tuple[float, ...]:
        """The same for all parts: one of a higher priority outweighs all those of lower ones."""
        found = [0.0] * len(self.parts)
        total = 0.0
        for level in sorted({each.part.priority for each in self.parts}):
            own = [n for n, each in enumerate(self.parts) if each.part.priority == level]
            least = min((self.worth[n] for n in own if self.worth[n] > 0), default=1.0)
            factor = max(1.0, 1.001 * total / least)
            for n in own:
                found[n] = factor * self.worth[n]
                total += found[n] * self.parts[n].part.count
        return tuple(found)

    def worth_by_priority(self, counts: Mapping[int, int]) -> tuple[float, ...]:
        """Sum the worth of parts, for each priority from the highest on."""
        levels = sorted({each.part.priority for each in self.parts}, reverse=True)
        return tuple(
            sum(self.worth[n] * k for n, k in counts.items() if self.parts[n].part.priority == one)
            for one in levels
        )
