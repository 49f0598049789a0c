"""Checks that a task is possible, whatever the search finds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np

from packit_sim.core.choices import Goal
from packit_sim.core.errors import ArgumentError, about
from packit_sim.core.length_units import Unit
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.boxes import BoxType

GOALS: tuple[Goal, ...] = get_args(Goal)


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


def check_task(task: PackTask) -> None:
    """Raise ArgumentError if a task is not possible.

    Raises
    ------
    ArgumentError
        If the objective, the walls, limits, constraints, groups or stops ask for what the parts and
        boxes do not have, or exclude each other.
    """
    check_objective(task.objective, task.boxes)
    if task.objective == "value" and all(each.part.value is None for each in task.parts):
        with about("objective"):
            raise ArgumentError("the objective value needs parts with a value, from a manifest")
    with about("fixed"):
        _check_fixed(task)
    check_margin(task.margin, task.boxes, task.unit)
    if any(box.limits.max_mass is not None for box in task.boxes):
        with about("max_mass"):
            _check_masses(task, "limits on the mass in a box")
    masses = [each.mass is None for each in task.parts]
    if any(box.limits.balance is not None for box in task.boxes) and not all(masses):
        with about("balance"):
            _check_masses(task, "a balance by mass, since other parts have one,", "needs")
    if any(each.part.max_load is not None for each in task.all_parts):
        _check_masses(task, "load limits")
    if task.settings.even and task.is_constrained:
        with about("even"):
            raise ArgumentError("even is not possible with constraints: moved parts may break them")
    with about("powder"):
        _check_powder(task)
    for box in task.boxes:
        task.constraints.check_container(box.container)
    if task.settings.groups:
        with about("groups"):
            _check_groups(task)
    if task.settings.order is not None and (lacking := _without_stop(task)):
        with about("order"):
            raise ArgumentError(
                f"the order delivery needs a stop of each part: {lacking!r} has none; a "
                "manifest has the field 'stop'"
            )


def check_ways(task: PackTask, instructions: bool, film: bool) -> None:
    """Raise ArgumentError if instructions or films are not possible with its containers."""
    for name, asked in (("instructions", instructions), ("films", film)):
        for box in task.boxes:
            if asked and form_of(box.container) == "mesh":
                raise ArgumentError(
                    f"{name} are not possible for {box.name!r}, a mesh: choose a box"
                )


def _check_powder(task: PackTask) -> None:
    """Raise ArgumentError if a powder is asked for and not possible."""
    if task.settings.powder is None:
        return
    _check_masses(task, "a powder", "needs")
    for box in task.boxes:
        if form_of(box.container) == "mesh":
            raise ArgumentError(f"a powder needs a box or a cylinder, not {box.name!r}, a mesh")


def _check_fixed(task: PackTask) -> None:
    """Raise ArgumentError if the fixed parts can't be where they are."""
    if task.fixed and (len(task.boxes) > 1 or task.boxes[0].count != 1):
        raise ArgumentError("parts that are fixed need one box: choose a single one")
    container = task.boxes[0].container
    for each in task.fixed:
        name = f"fixed: part {each.part.name!r}"
        item = CheckedItem(name, each.item_type, Placement(0), container.longest, task.unit)
        for fault in container.faults(item, slack=task.tolerance):
            raise ArgumentError(f"{name} {fault}: choose a keep-out for what is not inside it")


def _check_groups(task: PackTask) -> None:
    """Raise ArgumentError if the rules of groups are not possible."""
    if not task.groups:
        raise ArgumentError(
            "rules of groups need parts with a group: a manifest has the field 'group'"
        )
    if "kit" not in task.settings.groups:
        return
    for group, numbers in task.groups.items():
        for n in numbers:
            if task.parts[n].part.as_many_as_fit:
                name = task.parts[n].part.name
                raise ArgumentError(f"the kit {group!r} needs a number of {name!r}, not max")
            if n in task.too_large:
                name, why = task.parts[n].part.name, task.too_large[n]
                raise ArgumentError(f"the kit {group!r} fits into no box: {name} of {why}")
        if not any(task.may_hold(box, numbers) for box in task.boxes):
            count = sum(task.parts[n].part.count for n in numbers)
            raise ArgumentError(
                f"the kit {group!r} fits into no box: its {count} parts are too many or too "
                "large together"
            )


def _check_masses(task: PackTask, what: str, verb: str = "need") -> None:
    """Raise ArgumentError if something needs masses that are not known."""
    for each in task.parts:
        if each.mass is None:
            raise ArgumentError(
                f"{what} {verb} masses: part {each.part.name!r} has no mass or density"
            )


def _without_stop(task: PackTask) -> str | None:
    """Return the name of a part that has no stop."""
    return next((each.part.name for each in task.parts if each.part.stop is None), None)
