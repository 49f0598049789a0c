"""Taking parts out of a packing until it meets its requirements."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from packit_sim.core.errors import ArgumentError
from packit_sim.parts.handling.part_sweeps import PartSweeps
from packit_sim.parts.handling.requirements import (
    Requirements,
    Violation,
    by_box,
    geometric_violations,
    motions,
    order_of,
)
from packit_sim.parts.packings.packing import Packing


@dataclass(frozen=True)
class DroppedPart:
    """A part that was taken out of a packing.

    Attributes
    ----------
    part : int
        The number of its placement in the packing before.
    type : int
        The number of its type.
    reason : str
        What could not be met with it.
    """

    part: int
    type: int
    reason: str


@dataclass(frozen=True, eq=False)
class Reduced:
    """A packing that meets its requirements.

    Attributes
    ----------
    packing : Packing
        The packing, its placements in an order of packing.
    kept : tuple of int
        The number of each of its placements in the packing before.
    dropped : tuple of DroppedPart
        The parts that were taken out.
    """

    packing: Packing
    kept: tuple[int, ...]
    dropped: tuple[DroppedPart, ...]


@dataclass(frozen=True)
class Dropping:
    """A constraint of a search: its packings meet requirements after parts were taken out.

    Parameters
    ----------
    requirements : Requirements
        What packings must meet.
    with_fixed : callable
        Adds the parts that the requirements have as fixed, which packings of the search lack, as
        the first placements.
    """

    requirements: Requirements
    with_fixed: Callable[[Packing], Packing]

    def taken_out(self, packing: Packing) -> Mapping[int, str]:
        """Choose the parts to take out of a packing, as `drop_violations`.

        Parameters
        ----------
        packing : Packing
            The packing.

        Returns
        -------
        mapping of int to str
            The reason for each part to take out, by the number of its placement.
        """
        found = drop_violations(self.with_fixed(packing), self.requirements)
        first = len(self.requirements.fixed)
        return {one.part - first: one.reason for one in found.dropped}


def drop_violations(packing: Packing, requirements: Requirements) -> Reduced:
    """Take parts out of a packing until it meets its requirements.

    Parameters
    ----------
    packing : Packing
        The packing.
    requirements : Requirements
        What it must meet.

    Returns
    -------
    Reduced
        The remaining packing, and why the other parts were taken out.

    Raises
    ------
    ArgumentError
        If fixed parts violate a requirement among themselves, or the requirements are about types
        or placements that the packing does not have.
    MissingPackageError
        If `stable` is required, and PyBullet is missing.

    Notes
    -----
    In each step the part is taken out that has the least value for the number of violations in
    which it takes part; then parts return, the most valuable first, that violate nothing any more.
    After that, gravity decides stage by stage: if a part moves too far, the part that was put in
    last is taken out. The result is not proven to be the most valuable one.
    """
    requirements.check(packing)
    sweeps = PartSweeps(packing)
    reasons: dict[int, Violation] = {}
    kept = _met(sweeps, list(range(len(sweeps))), requirements, reasons)
    for part in sorted(reasons, key=lambda n: (-_value(packing, n), n)):
        more = sorted([*kept, part])
        if not geometric_violations(sweeps, more, requirements):
            kept = more
            del reasons[part]
    if requirements.stable is not None:
        kept = _stable(sweeps, kept, requirements, reasons)
    order = order_of(sweeps, kept, requirements)
    placements = tuple(packing.placements[n] for n in order)
    dropped = tuple(
        DroppedPart(n, packing.placements[n].type, reasons[n].sentence) for n in sorted(reasons)
    )
    return Reduced(replace(packing, placements=placements), order, dropped)


def _met(
    sweeps: PartSweeps, kept: list[int], requirements: Requirements, reasons: dict[int, Violation]
) -> list[int]:
    """Return the parts that are left when nothing is violated but stability."""
    kept = list(kept)
    while found := geometric_violations(sweeps, kept, requirements):
        count = Counter(
            n for one in found for n in (one.part, *one.others) if n not in requirements.fixed
        )
        if not count:
            raise ArgumentError(f"parts that are fixed violate a requirement: {found[0].sentence}")
        part = min(count, key=lambda n: (_value(sweeps.packing, n) / count[n], n))
        kept.remove(part)
        reasons[part] = next(one for one in found if part in (one.part, *one.others))
    return kept


def _stable(
    sweeps: PartSweeps, kept: list[int], requirements: Requirements, reasons: dict[int, Violation]
) -> list[int]:
    """Return the parts that are left when no part moves too far at any stage."""
    for box in sorted({sweeps.packing.placements[n].box for n in kept}):
        first = 1
        before: tuple[int, ...] = ()
        while own := _in_box(sweeps, kept, requirements, box):
            if own[: first - 1] != before[: first - 1]:
                first = 1
            found = next(motions(sweeps, own, requirements, first), None)
            if found is None:
                break
            first, violation = found
            part = own[first - 1] if own[first - 1] not in requirements.fixed else violation.part
            reasons[part] = violation
            kept = _met(sweeps, [n for n in kept if n != part], requirements, reasons)
            before = own
    return kept


def _in_box(
    sweeps: PartSweeps, kept: list[int], requirements: Requirements, box: int
) -> tuple[int, ...]:
    """Return the order of packing of one box."""
    groups = by_box(sweeps.packing, order_of(sweeps, kept, requirements))
    placed = sweeps.packing.placements
    return next((own for own in groups if placed[own[0]].box == box), ())


def _value(packing: Packing, part: int) -> float:
    """Return the value of a placed part: by default its volume."""
    placement = packing.placements[part]
    item_type = packing.types[placement.type]
    volume = item_type.volume * placement.scale**3
    return volume if item_type.value is None else item_type.value
