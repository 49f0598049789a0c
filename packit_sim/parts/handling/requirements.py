"""What a packing of parts must meet besides being valid, and which parts do not meet it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from packit_sim.core.checks import POSITIVE, Range, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.handling.packing_stages import stages
from packit_sim.parts.handling.part_sweeps import PartSweeps
from packit_sim.parts.handling.removal import MOVES, Removal, Route, removal_of
from packit_sim.parts.handling.supports import stacking_of
from packit_sim.parts.packings.packing import Packing
from packit_sim.physics.settings import PhysicsSettings

_MOST_NAMES = 3
"""Largest number of other parts that a sentence names."""

_ROUNDING = 1e-9
"""Relative error of a load."""


@dataclass(frozen=True)
class Requirements:
    """What a packing of parts must meet besides being valid.

    Parameters
    ----------
    removable : bool
        Whether every part can be taken out by straight moves (see `removal`).
    insertable : bool
        Whether every part can be put in straight down, in some order.
    sides : bool
        Whether parts may also leave through the sides of the box.
    stable : float, optional
        The largest distance that a part may move under gravity at any stage of packing, in the
        container's unit (see `packing_stages`).
    no_stack : frozenset of int
        The numbers of the types on which nothing may rest (see `stacking`).
    max_loads : mapping of int to float
        The largest mass in grams that may rest on a part, by the number of its type.
    masses : tuple of float, optional
        The grams of a part of each type.
    fixed : frozenset of int
        The numbers of placements that stay where they are, such as parts that belong to the box.
        They are in the way of others, and nobody has to take them out.
    metres : float
        The container's unit in metres, for `stable`.
    physics : PhysicsSettings, optional
        The simulated world, for `stable`; by default that of `packing_stages`.

    Raises
    ------
    ArgumentError
        If a number is out of range, or masses are missing.
    """

    removable: bool = False
    insertable: bool = False
    sides: bool = False
    stable: float | None = None
    no_stack: frozenset[int] = frozenset()
    max_loads: Mapping[int, float] = field(default_factory=lambda: MappingProxyType({}))
    masses: tuple[float, ...] | None = None
    fixed: frozenset[int] = frozenset()
    metres: float = 0.001
    physics: PhysicsSettings | None = None

    def __post_init__(self) -> None:
        if self.stable is not None:
            check_range("stable", self.stable, POSITIVE)
        check_range("metres", self.metres, POSITIVE)
        for load in self.max_loads.values():
            check_range("max_load", load, Range(0, ends="[)"))
        for mass in self.masses or ():
            check_range("mass", mass, Range(0, ends="[)"))
        if self.masses is None and (self.max_loads or self.stable is not None):
            raise ArgumentError("load limits and stability need masses: one for each type of parts")

    def masses_in(self, packing: Packing) -> list[float]:
        """Return the grams of each placed part; 0 if they are not known."""
        masses = self.masses or (0.0,) * len(packing.types)
        return [masses[placement.type] for placement in packing.placements]

    def check(self, packing: Packing) -> None:
        """Raise ArgumentError if it is about types or placements that a packing does not have."""
        for name, numbers, count in (
            ("no_stack", self.no_stack, len(packing.types)),
            ("max_loads", self.max_loads, len(packing.types)),
            ("fixed", self.fixed, len(packing.placements)),
        ):
            for number in numbers:
                if not 0 <= number < count:
                    raise ArgumentError(f"{name} has the number {number}: it must be below {count}")
        if self.masses is not None and len(self.masses) != len(packing.types):
            raise ArgumentError(
                f"{len(self.masses)} masses for {len(packing.types)} types of parts: one for each"
            )


@dataclass(frozen=True)
class Violation:
    """A requirement that a part does not meet.

    Attributes
    ----------
    rule : str
        The requirement: "removable", "insertable", "no_stack", "max_load" or "stable".
    part : int
        The number of the part's placement.
    others : tuple of int
        The numbers of the placements that have to do with it.
    sentence : str
        What is wrong.
    """

    rule: str
    part: int
    others: tuple[int, ...]
    sentence: str


def violations(packing: Packing, requirements: Requirements) -> list[Violation]:
    """Find the requirements that a packing does not meet.

    Parameters
    ----------
    packing : Packing
        The packing.
    requirements : Requirements
        What it must meet.

    Returns
    -------
    list of Violation
        The violations; empty if it meets all.

    Raises
    ------
    ArgumentError
        If the requirements are about types or placements that the packing does not have.
    MissingPackageError
        If `stable` is required, and PyBullet is missing.
    """
    requirements.check(packing)
    sweeps = PartSweeps(packing)
    kept = range(len(sweeps))
    found = geometric_violations(sweeps, kept, requirements)
    if requirements.stable is not None:
        order = order_of(sweeps, kept, requirements)
        for own in by_box(packing, order):
            found += [one for _, one in motions(sweeps, own, requirements)]
    return found


def packing_order(packing: Packing, requirements: Requirements | None = None) -> tuple[int, ...]:
    """Return an order in which the parts of a packing can be put in.

    Parameters
    ----------
    packing : Packing
        The packing.
    requirements : Requirements, optional
        What it meets: whether parts come straight down or through the sides, and which are fixed.

    Returns
    -------
    tuple of int
        The numbers of the placements, box after box; in each box first the fixed parts, then those
        that are stuck (see `removal`), then all others from the lowest on.
    """
    sweeps = PartSweeps(packing)
    return order_of(sweeps, range(len(sweeps)), requirements or Requirements())


def required_removal(
    sweeps: PartSweeps, kept: Sequence[int], requirements: Requirements
) -> Removal:
    """Search for the removal of some parts by the moves that are allowed (see `removal_of`)."""
    return removal_of(
        sweeps,
        kept,
        sides=requirements.sides,
        moves=1 if requirements.insertable else MOVES,
        fixed=requirements.fixed,
    )


def order_of(
    sweeps: PartSweeps, kept: Sequence[int], requirements: Requirements
) -> tuple[int, ...]:
    """Return an order in which some parts can be put in, as `packing_order`."""
    return ways_in(sweeps, kept, requirements)[0]


def ways_in(
    sweeps: PartSweeps, kept: Sequence[int], requirements: Requirements
) -> tuple[tuple[int, ...], dict[int, Route]]:
    """Return an order in which some parts can be put in, and the way out of each that has one."""
    removal = required_removal(sweeps, kept, requirements)
    order = (*sorted(requirements.fixed.intersection(kept)), *removal.packing_order)
    ordered = tuple(n for own in by_box(sweeps.packing, order) for n in own)
    return ordered, dict(zip(removal.order, removal.routes, strict=True))


def by_box(packing: Packing, order: Sequence[int]) -> list[tuple[int, ...]]:
    """Divide numbers of placements by their boxes; the order in each box stays."""
    boxes = [placement.box for placement in packing.placements]
    return [tuple(n for n in order if boxes[n] == box) for box in sorted({boxes[n] for n in order})]


def geometric_violations(
    sweeps: PartSweeps, kept: Sequence[int], requirements: Requirements
) -> list[Violation]:
    """Find what some parts of a packing violate, without simulations.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of the packing.
    kept : sequence of int
        The numbers of the parts that are in it.
    requirements : Requirements
        What they must meet.

    Returns
    -------
    list of Violation
        The violations.
    """
    found, packing, fixed = [], sweeps.packing, requirements.fixed
    if requirements.removable or requirements.insertable:
        rule = "insertable" if requirements.insertable else "removable"
        verb = "put in straight down" if requirements.insertable else "taken out"
        for stuck in required_removal(sweeps, kept, requirements).stuck:
            way = _subject(packing, stuck.by)
            sentence = f"{_name(packing, stuck.part)} can't be {verb}: {way} in the way"
            found.append(Violation(rule, stuck.part, stuck.by, sentence))
    if requirements.no_stack or requirements.max_loads:
        stacked = stacking_of(sweeps, kept, fixed=fixed)
        loads = stacked.loads(requirements.masses_in(packing))
        for part in kept:
            kind = packing.placements[part].type
            top, name = stacked.on_top(part), _name(packing, part)
            if kind in requirements.no_stack and top:
                sentence = f"{_subject(packing, top)} on {name}, which may carry nothing"
                found.append(Violation("no_stack", part, top, sentence))
            most = requirements.max_loads.get(kind)
            if most is not None and loads[part] > most * (1 + _ROUNDING):
                sentence = f"{name} carries {loads[part]:.4g} g: at most {most:.4g} g"
                found.append(Violation("max_load", part, top, sentence))
    return found


def motions(
    sweeps: PartSweeps, order: Sequence[int], requirements: Requirements, first: int = 1
) -> Iterator[tuple[int, Violation]]:
    """Find the stages of packing one box in which a part moves too far.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of the packing.
    order : sequence of int
        The numbers of the placements in the order of packing, all in one box.
    requirements : Requirements
        What they must meet; it has `stable`.
    first : int, default: 1
        The first stage that is simulated.

    Yields
    ------
    int
        The stage: the number of parts in the box.
    Violation
        The part that moves farthest.
    """
    most, packing = requirements.stable or 0.0, sweeps.packing
    masses = [mass / 1000 for mass in requirements.masses_in(packing)]
    settings, fixed = requirements.physics, requirements.fixed
    for stage, moved in stages(sweeps, order, masses, requirements.metres, settings, first, fixed):
        part = max(moved, key=lambda n: moved[n])
        if not moved[part] <= most:
            new = order[stage - 1]
            name, after = _name(packing, part), f" when {_name(packing, new)} is put in"
            sentence = f"{name} moves by {moved[part]:.3g}{after if new != part else ''}: "
            others = () if new == part else (new,)
            yield stage, Violation("stable", part, others, f"{sentence}at most {most:.3g}")


def _name(packing: Packing, part: int) -> str:
    return repr(packing.types[packing.placements[part].type].name)


def _subject(packing: Packing, parts: Sequence[int]) -> str:
    """Name parts as the subject of a sentence, with its verb."""
    names = [_name(packing, n) for n in parts[:_MOST_NAMES]]
    if len(parts) > _MOST_NAMES:
        names.append(f"{len(parts) - _MOST_NAMES} more")
    return ", ".join(names) + (" is" if len(parts) == 1 else " are")
