"""The task: prepared parts, boxes, the objective, and constraints."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np

from packit_sim.core.caches import cached_property
from packit_sim.core.checks import as_integer, check_range
from packit_sim.core.choices import Door, Goal, LoadingOrder, SearchBackend
from packit_sim.core.errors import ArgumentError, about
from packit_sim.core.length_units import UNITS_CM, Unit
from packit_sim.core.parallel import check_search_workers
from packit_sim.core.sums import plain_sum
from packit_sim.parts.filling.groups import GROUP_RULES
from packit_sim.parts.handling.constraints import Constraints, CustomConstraint
from packit_sim.parts.handling.sweeps import check_door
from packit_sim.parts.packings import checked_items
from packit_sim.parts.packings.bounds import (
    COUNTS,
    DISTANCES,
    ITERATIONS,
    LENGTHS,
    SUM_ROUNDING,
)
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.distances import WallClearance, stretch
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.files import ReadSettings, UnreadFile
from packit_sim.parts.reading.limits import NO_LIMITS, Limits
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.powder import Powder
from packit_sim.parts.reading.prepared import PreparedPart, largest_sum
from packit_sim.parts.reading.sizes import fits, too_large
from packit_sim.parts.reading.units import check_unit

GOALS: tuple[Goal, ...] = get_args(Goal)


@dataclass(frozen=True)
class PackSettings:
    """Settings for reading and packing parts.

    Parameters
    ----------
    clearance : float
        Smallest distance between two parts, unless one of them has a larger one.
    wall_clearance : float or WallClearance
        Smallest distance to the walls.
    accuracy : float, optional
        Largest deviation of a collision mesh from its file; by default 0.002 of its diagonal.
    boxes : int, optional
        How many boxes there are of a size that does not say so; by default 1, or for the objective
        "boxes" as many as are needed.
    unit : str, optional
        The unit of clearances and results, and of boxes if none of them names a unit; by default
        the first unit that a box names, or else mm.
    reading : ReadSettings
        How files are read.
    removable : bool
        Whether every part can be taken out of its box by straight moves, in some order.
    insertable : bool
        Whether every part can be put in by one straight move, in some order.
    stable : float, optional
        The largest distance that a part may move under gravity at any stage of packing.
    keep_out : sequence of Part, Path or str
        Volumes that stay free in every box, as meshes in the box's coordinates: parts keep the
        clearance from them.
    fixed : sequence of Part, Path or str
        Parts that are in the box already, as meshes in its coordinates. Others keep the clearance
        from them and may rest on them.
    constraints : sequence of CustomConstraint
        Further constraints on the parts in each box; parts that break one are left out.
    workers : int
        The number of searches at a time; 0: one per core.
    backend : str
        Where they run: "threads" of this process, or processes of a "ray" cluster.
    address : str, optional
        The address of the Ray cluster's head.
    iterations : int, optional
        Passes over the parts of each search, instead of the time: a repeatable search.
    stop : threading.Event, optional
        Ends the search early when another thread sets it, as Ctrl-C does.
    separable : bool
        Whether every part can be moved out without turning, in some order and round corners, as if
        the box had no walls: no parts interlock.
    limits : Limits or mapping of str to Limits
        What one box may hold, where a box does not say so; or the same by the name of the boxes,
        with those of all others by the name "".
    clearance_z : float, optional
        Smallest distance of two parts of which one is straight above the other; by default the
        same as `clearance`. Between, an ellipsoid with these half axes decides (see Notes).
    groups : sequence of str
        Rules for the parts of each group: "together": all that are packed share a box; "kit": they
        are packed whole, into one box, or not at all; "apart": no box has parts of two groups.
    powder : Powder, optional
        The powder of the bed, of which the summary has how much a build takes.
    even : bool
        Whether parts move after the search, none above the highest one, until the packed area
        varies less over the height.
    door : str
        The side through which parts come in and leave: "x-", "x+", "y-", "y+", or "z+", the top.
    order : str, optional
        "delivery": every part has a stop. The parts of each stop can go straight out through the
        door, one after another, while those of all later stops are in place.

    Raises
    ------
    ArgumentError
        If a number is out of bounds.
    WorkersError
        If the search can't have such workers.

    Notes
    -----
    With `clearance_z`, distances are measured after all lengths along z are multiplied by
    `clearance / clearance_z`, and must be at least the clearance then. A clearance of a part is
    stretched in the same way.

    Examples
    --------
    >>> from packit_sim import PackSettings
    >>> settings = PackSettings(clearance=1.0, wall_clearance=2.0, unit="mm", removable=True)
    >>> settings.clearance
    1.0
    >>> PackSettings(clearance=-1.0)
    Traceback (most recent call last):
        ...
    packit_sim.core.errors.ArgumentError: clearance -1.0 is not possible: 0 to 1e+30
    """

    clearance: float = 0.0
    wall_clearance: float | WallClearance = 0.0
    accuracy: float | None = None
    boxes: int | None = None
    unit: Unit | None = None
    reading: ReadSettings = field(default_factory=ReadSettings)
    removable: bool = False
    insertable: bool = False
    stable: float | None = None
    keep_out: Sequence[Part | Path | str] = ()
    fixed: Sequence[Part | Path | str] = ()
    constraints: Sequence[CustomConstraint] = ()
    workers: int = 0
    backend: SearchBackend = "threads"
    address: str | None = None
    iterations: int | None = None
    stop: threading.Event | None = None
    separable: bool = False
    limits: Limits | Mapping[str, Limits] = NO_LIMITS
    clearance_z: float | None = None
    groups: Sequence[str] = ()
    powder: Powder | None = None
    even: bool = False
    door: Door = "z+"
    order: LoadingOrder | None = None

    def __post_init__(self) -> None:
        with about("clearance"):
            check_range("clearance", self.clearance, DISTANCES)
        with about("clearance_z"):
            stretch(self.clearance, self.clearance_z)
        if not isinstance(self.wall_clearance, WallClearance):
            with about("wall_clearance"):
                check_range("wall clearance", self.wall_clearance, DISTANCES)
        for name in ("accuracy", "stable"):
            if getattr(self, name) is not None:
                with about(name):
                    check_range(name, getattr(self, name), LENGTHS)
        for name, valid in (("boxes", COUNTS), ("iterations", ITERATIONS)):
            value = getattr(self, name)
            if value is not None:
                check_range(name, as_integer(name, value), valid)
        if self.unit is not None:
            check_unit(self.unit)
        for rule in self.groups:
            known = f"choose from {', '.join(GROUP_RULES)}"
            with about("groups"):
                check_range("rule of groups", rule, (rule in GROUP_RULES, known))
        with about("door"):
            check_door(self.door)
        with about("order"):
            check_range("order", self.order, (self.order in (None, "delivery"), "choose delivery"))
        check_search_workers(self.workers, self.backend, self.address)


def check_objective(objective: Goal, boxes: Sequence[BoxType]) -> None:
    """Raise ArgumentError if an objective is not known, or not possible with some boxes."""
    with about("objective"):
        if objective not in GOALS:
            raise ArgumentError(
                f"objective {objective!r} is not known: choose from {', '.join(GOALS)}"
            )
        if objective == "height" and (len(boxes) > 1 or boxes[0].count != 1):
            raise ArgumentError("the objective height needs one box: choose boxes for several")


def check_margin(margin: WallClearance, boxes: Sequence[BoxType], unit: Unit) -> None:
    """Raise ArgumentError if distances from the walls are not possible in a box."""
    with about("wall_clearance"):
        for box in boxes:
            if not margin.is_even and form_of(box.container) == "mesh":
                raise ArgumentError(
                    f"box {box.name!r} is a mesh: choose one distance from all of its walls"
                )
            if (np.array(box.size) <= margin.lower + margin.upper).any():
                raise ArgumentError(f"box {box.name!r}: {margin.text(unit)} leave no space in it")


@dataclass(frozen=True, eq=False)
class PackTask:
    """Parts to pack, and the boxes for them.

    Attributes
    ----------
    objective : str
        One of `GOALS`.
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

    def __post_init__(self) -> None:
        check_objective(self.objective, self.boxes)
        if self.objective == "value" and all(each.part.value is None for each in self.parts):
            with about("objective"):
                raise ArgumentError("the objective value needs parts with a value, from a manifest")
        with about("fixed"):
            self._check_fixed()
        check_margin(self.margin, self.boxes, self.unit)
        if any(box.limits.max_mass is not None for box in self.boxes):
            with about("max_mass"):
                self._check_masses("limits on the mass in a box")
        masses = [each.mass is None for each in self.parts]
        if any(box.limits.balance is not None for box in self.boxes) and not all(masses):
            with about("balance"):
                self._check_masses("a balance by mass, since other parts have one,", "needs")
        if self.settings.even and self.is_constrained:
            with about("even"):
                raise ArgumentError(
                    "even is not possible with constraints, which parts that move break"
                )
        with about("powder"):
            self._check_powder()
        for box in self.boxes:
            self.constraints.check_container(box.container)
        if self.settings.groups:
            with about("groups"):
                self._check_groups()
        if self.settings.order is not None and (lacking := self._without_stop()):
            with about("order"):
                raise ArgumentError(
                    f"the order delivery needs a stop of each part: {lacking!r} has none; a "
                    "manifest has the field 'stop'"
                )

    def _check_powder(self) -> None:
        """Raise ArgumentError if a powder is asked for and not possible."""
        if self.settings.powder is None:
            return
        self._check_masses("a powder", "needs")
        for box in self.boxes:
            if form_of(box.container) == "mesh":
                raise ArgumentError(f"a powder needs a box or a cylinder, not {box.name!r}, a mesh")

    def _check_fixed(self) -> None:
        """Raise ArgumentError if the fixed parts can't be where they are."""
        if self.fixed and (len(self.boxes) > 1 or self.boxes[0].count != 1):
            raise ArgumentError("parts that are fixed need one box: they are only in that one")
        container = self.boxes[0].container
        for each in self.fixed:
            name = f"fixed: part {each.part.name!r}"
            item = CheckedItem(name, each.item_type, Placement(0), container.longest)
            for fault in container.faults(item, slack=self.tolerance):
                raise ArgumentError(
                    f"{name} {fault}, in {self.unit}: choose a keep-out for what is not inside it"
                )

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

    def check_ways(self, instructions: bool, film: bool) -> None:
        """Raise ArgumentError if instructions or films are not possible with its containers."""
        for name, asked in (("instructions", instructions), ("films", film)):
            for box in self.boxes:
                if asked and form_of(box.container) == "mesh":
                    raise ArgumentError(
                        f"{name} are not possible for {box.name!r}, a mesh: choose a box"
                    )

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
        if max_loads:
            self._check_masses("load limits")
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
            metres=centimetres / 100,
        )

    @cached_property
    def stops(self) -> dict[int, int]:
        """The stop of each part, by its number, if they are delivered; else empty."""
        if self.settings.order is None:
            return {}
        return {n: each.part.stop for n, each in enumerate(self.parts) if each.part.stop}

    def _without_stop(self) -> str | None:
        """Return the name of a part that has no stop."""
        return next((each.part.name for each in self.parts if each.part.stop is None), None)

    def _check_groups(self) -> None:
        """Raise ArgumentError if the rules of groups are not possible."""
        if not self.groups:
            raise ArgumentError(
                "rules of groups need parts with a group: a manifest has the field 'group'"
            )
        if "kit" not in self.settings.groups:
            return
        for group, numbers in self.groups.items():
            for n in numbers:
                if self.parts[n].part.as_many_as_fit:
                    name = self.parts[n].part.name
                    raise ArgumentError(f"the kit {group!r} needs a number of {name!r}, not max")
                if n in self.too_large:
                    name, why = self.parts[n].part.name, self.too_large[n]
                    raise ArgumentError(f"the kit {group!r} fits into no box: {name} of {why}")
            if not any(self.may_hold(box, numbers) for box in self.boxes):
                count = sum(self.parts[n].part.count for n in numbers)
                raise ArgumentError(
                    f"the kit {group!r} fits into no box: its {count} parts are too many or too "
                    "large together"
                )

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

    def _check_masses(self, what: str, verb: str = "need") -> None:
        """Raise ArgumentError if something needs masses that are not known."""
        for each in self.parts:
            if each.mass is None:
                raise ArgumentError(
                    f"{what} {verb} masses: part {each.part.name!r} has no mass or density"
                )

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
