"""Filtering of packings: parts are left out until the others meet the constraints."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from packit_sim.core.errors import ArgumentError
from packit_sim.parts.handling.broken import (
    BrokenConstraint,
    broken_by_geometry,
    broken_by_motion,
)
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.order import by_box, order_of
from packit_sim.parts.handling.sweeps import PartSweeps, sweeps_of
from packit_sim.parts.packings.packing import Packing


@dataclass(frozen=True)
class LeftOutPart:
    """A part that was left out of a packing.

    Attributes
    ----------
    part : int
        The number of its placement in the packing before.
    type : int
        The number of its type.
    reason : str
        The constraint that it broke, as a sentence.
    """

    part: int
    type: int
    reason: str


@dataclass(frozen=True, eq=False)
class FilteredPacking:
    """A packing that meets its constraints, since parts were left out.

    Attributes
    ----------
    packing : Packing
        The packing, its placements in an order of packing.
    kept : tuple of int
        The number of each of its placements in the packing before.
    """

    packing: Packing
    kept: tuple[int, ...]
    left_out: tuple[LeftOutPart, ...]


def filter_packing(packing: Packing, constraints: Constraints) -> FilteredPacking:
    """Leave parts out of a packing until it meets its constraints.

    Returns
    -------
    FilteredPacking
        The remaining packing, and the parts that were left out with the reasons.

    Raises
    ------
    ArgumentError
        If fixed parts break a constraint among themselves, or the constraints are about types
        or placements that the packing does not have.
    MissingPackageError
        If `stable` is required, and PyBullet is missing.

    Notes
    -----
    In each step the part is left out that has the least value for the number of broken
    constraints in which it takes part; then parts return, the most valuable first, that break
    nothing any more. After that, gravity decides stage by stage: if a part moves too far, the part
    that was put in last is left out. The result is not proven to be the most valuable one.
    """
    constraints.check_numbers(packing)
    sweeps = sweeps_of(packing)
    reasons: dict[int, BrokenConstraint] = {}
    kept = _met(sweeps, list(range(len(sweeps))), constraints, reasons)
    for part in sorted(reasons, key=lambda n: (-_value(packing, n), n)):
        more = sorted([*kept, part])
        if not broken_by_geometry(sweeps, more, constraints):
            kept = more
            del reasons[part]
    if constraints.stable is not None:
        kept = _stable(sweeps, kept, constraints, reasons)
    order = order_of(sweeps, kept, constraints)
    placements = tuple(packing.placements[n] for n in order)
    left_out = tuple(
        LeftOutPart(n, packing.placements[n].type, reasons[n].sentence) for n in sorted(reasons)
    )
    return FilteredPacking(replace(packing, placements=placements), order, left_out)


def _met(
    sweeps: PartSweeps,
    kept: list[int],
    constraints: Constraints,
    reasons: dict[int, BrokenConstraint],
) -> list[int]:
    """Return the parts that are left when no constraint is broken but stability."""
    kept = list(kept)
    while found := broken_by_geometry(sweeps, kept, constraints):
        count = Counter(
            n for one in found for n in (one.part, *one.others) if n not in constraints.fixed
        )
        if not count:
            raise ArgumentError(f"parts that are fixed break a constraint: {found[0].sentence}")
        part = min(count, key=lambda n: (_value(sweeps.packing, n) / count[n], n))
        kept.remove(part)
        reasons[part] = next(one for one in found if part in (one.part, *one.others))
    return kept


def _stable(
    sweeps: PartSweeps,
    kept: list[int],
    constraints: Constraints,
    reasons: dict[int, BrokenConstraint],
) -> list[int]:
    """Return the parts that are left when no part moves too far at any stage."""
    for box in sorted({sweeps.packing.placements[n].box for n in kept}):
        first = 1
        before: tuple[int, ...] = ()
        while own := _in_box(sweeps, kept, constraints, box):
            if own[: first - 1] != before[: first - 1]:
                first = 1
            found = next(broken_by_motion(sweeps, own, constraints, first), None)
            if found is None:
                break
            first, broken = found
            part = own[first - 1] if own[first - 1] not in constraints.fixed else broken.part
            reasons[part] = broken
            kept = _met(sweeps, [n for n in kept if n != part], constraints, reasons)
            before = own
    return kept


def _in_box(
    sweeps: PartSweeps, kept: list[int], constraints: Constraints, box: int
) -> tuple[int, ...]:
    """Return the order of packing of one box."""
    groups = by_box(sweeps.packing, order_of(sweeps, kept, constraints))
    placed = sweeps.packing.placements
    return next((own for own in groups if placed[own[0]].box == box), ())


def _value(packing: Packing, part: int) -> float:
    """Return the value of a placed part: by default its volume."""
    placement = packing.placements[part]
    item_type = packing.types[placement.type]
    volume = item_type.volume * placement.scale**3
    return volume if item_type.value is None else item_type.value
