"""The constraints that a packing does not meet, each with the parts that break it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.order import by_box, order_of, removal_for
from packit_sim.parts.handling.separability import separability_of
from packit_sim.parts.handling.stability import stages
from packit_sim.parts.handling.supports import stacking_of
from packit_sim.parts.handling.sweeps import PartSweeps, sweeps_of
from packit_sim.parts.packings.packing import Packing

_MOST_NAMES = 3
"""Largest number of other parts that a sentence names."""

_ROUNDING = 1e-9
"""Relative error of a load."""


@dataclass(frozen=True)
class BrokenConstraint:
    """A constraint that a part does not meet.

    Attributes
    ----------
    constraint : str
        Its name: "removable", "insertable", "delivery", "separable", "no_stack", "max_load" or
        "stable".
    part : int
        The number of the part's placement.
    others : tuple of int
        The numbers of the other placements that take part in it.
    sentence : str
        What is wrong.
    """

    constraint: str
    part: int
    others: tuple[int, ...]
    sentence: str


def broken_constraints(packing: Packing, constraints: Constraints) -> list[BrokenConstraint]:
    """Find the constraints that a packing does not meet.

    Returns
    -------
    list of BrokenConstraint
        Those that are broken; empty if the packing meets all.

    Raises
    ------
    ArgumentError
        If the constraints are about types or placements that the packing does not have.
    MissingPackageError
        If `stable` is required, and PyBullet is missing.
    """
    constraints.check_numbers(packing)
    sweeps = sweeps_of(packing)
    kept = range(len(sweeps))
    found = broken_by_geometry(sweeps, kept, constraints)
    if constraints.stable is not None:
        order = order_of(sweeps, kept, constraints)
        for own in by_box(packing, order):
            found += [one for _, one in broken_by_motion(sweeps, own, constraints)]
    return found


def broken_by_geometry(
    sweeps: PartSweeps, kept: Sequence[int], constraints: Constraints
) -> list[BrokenConstraint]:
    """Find the constraints that some parts of a packing break, without simulations.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of the packing.
    kept : sequence of int
        The numbers of the parts that are in it.

    Returns
    -------
    list of BrokenConstraint
        Those that are broken.
    """
    found, packing, fixed = [], sweeps.packing, constraints.fixed
    if constraints.removable or constraints.is_straight:
        for stuck in removal_for(sweeps, kept, constraints).stuck:
            name, verb = _move(packing, stuck.part, constraints)
            way = _subject(packing, stuck.by)
            sentence = f"{_name(packing, stuck.part)} can't be {verb}: {way} in the way"
            found.append(BrokenConstraint(name, stuck.part, stuck.by, sentence))
    elif constraints.separable:  # weaker than those
        for stuck in separability_of(sweeps, kept, fixed=fixed).stuck:
            verb = "can't be moved out" if stuck.is_proven else "was not moved out"
            way = _subject(packing, stuck.by)
            sentence = f"{_name(packing, stuck.part)} {verb} without turning: {way} in the way"
            found.append(BrokenConstraint("separable", stuck.part, stuck.by, sentence))
    if constraints.no_stack or constraints.max_loads:
        stacked = stacking_of(sweeps, kept, fixed=fixed)
        loads = stacked.loads(constraints.masses_in(packing))
        for part in kept:
            kind = packing.placements[part].type
            top, name = stacked.on_top(part), _name(packing, part)
            if kind in constraints.no_stack and top:
                sentence = f"{_subject(packing, top)} on {name}, which may carry nothing"
                found.append(BrokenConstraint("no_stack", part, top, sentence))
            most = constraints.max_loads.get(kind)
            if most is not None and loads[part] > most * (1 + _ROUNDING):
                sentence = f"{name} carries {loads[part]:.4g} g: at most {most:.4g} g"
                found.append(BrokenConstraint("max_load", part, top, sentence))
    return found


def broken_by_motion(
    sweeps: PartSweeps, order: Sequence[int], constraints: Constraints, first: int = 1
) -> Iterator[tuple[int, BrokenConstraint]]:
    """Find the stages of packing one box in which a part moves too far.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of the packing.
    order : sequence of int
        The numbers of the placements in the order of packing, all in one box.
    constraints : Constraints
        What they must meet; they have `stable`.
    first : int, default: 1
        The first stage that is simulated.

    Yields
    ------
    int
        The stage: the number of parts in the box.
    BrokenConstraint
        The part that moves farthest.
    """
    most, packing = constraints.stable or 0.0, sweeps.packing
    masses = [mass / 1000 for mass in constraints.masses_in(packing)]
    settings, fixed = constraints.physics, constraints.fixed
    for stage, moved in stages(sweeps, order, masses, constraints.metres, settings, first, fixed):
        part = max(moved, key=lambda n: moved[n])
        if not moved[part] <= most:
            new = order[stage - 1]
            name, after = _name(packing, part), f" when {_name(packing, new)} is put in"
            sentence = f"{name} moves by {moved[part]:.3g} {constraints.unit}"
            sentence += f"{after if new != part else ''}: at most {most:.3g} {constraints.unit}"
            others = () if new == part else (new,)
            yield stage, BrokenConstraint("stable", part, others, sentence)


def _move(packing: Packing, part: int, constraints: Constraints) -> tuple[str, str]:
    """Return the constraint on the moves of a part, and what it asks for."""
    stop = constraints.stops.get(packing.placements[part].type)
    if stop is not None:
        return "delivery", f"taken straight out at stop {stop}"
    if not constraints.insertable:
        return "removable", "taken out"
    is_top = constraints.door == "z+"
    way = "straight down" if is_top else f"straight through the door {constraints.door}"
    return "insertable", f"put in {way}"


def _name(packing: Packing, part: int) -> str:
    return repr(packing.types[packing.placements[part].type].name)


def _subject(packing: Packing, parts: Sequence[int]) -> str:
    """Name parts as the subject of a sentence, with its verb."""
    names = [_name(packing, n) for n in parts[:_MOST_NAMES]]
    if len(parts) > _MOST_NAMES:
        names.append(f"{len(parts) - _MOST_NAMES} more")
    return ", ".join(names) + (" is" if len(parts) == 1 else " are")
