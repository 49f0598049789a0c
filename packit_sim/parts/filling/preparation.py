"""Preparation: the task of packing some parts into some boxes, from what the user gave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from packit_sim.core.errors import ArgumentError, MeshError
from packit_sim.core.length_units import Unit
from packit_sim.parts.filling.task import (
    Goal,
    PackSettings,
    PackTask,
    check_margin,
    check_objective,
)
from packit_sim.parts.packings.rotation_sets import FIXED
from packit_sim.parts.reading.boxes import Boxes, box_types, box_unit, unit_note
from packit_sim.parts.reading.files import UnreadFile, find_parts
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.prepared import (
    PreparedPart,
    boxed,
    least_side,
    prepare,
    surface_notes,
)
from packit_sim.parts.reading.sizes import too_large, unit_notes
from packit_sim.parts.reading.units import factor


def prepared_task(
    parts: Sequence[Part | Path | str], box: Boxes, objective: Goal, settings: PackSettings
) -> PackTask:
    """Read and prepare all parts of a task.

    Parameters
    ----------
    parts : sequence of Part, Path or str
        Parts, mesh files, folders, patterns of paths and manifests.
    box : str, BoxType, or sequence of float, str or BoxType
        A box, or several.
    objective : str
        One of `GOALS`.

    Returns
    -------
    PackTask
        The task, with notes for the user.

    Raises
    ------
    ArgumentError
        If an argument is not possible, or no part can be read or fits.
    """
    unit: Unit = settings.unit or box_unit(box) or "mm"
    accuracy = None if settings.accuracy is None else settings.accuracy * factor(unit, "mm")
    settings = replace(settings, unit=unit, reading=replace(settings.reading, accuracy=accuracy))
    boxes = box_types(box, unit, settings.boxes or (None if objective == "boxes" else 1))
    check_objective(objective, boxes)
    check_margin(settings.wall_clearance, boxes, unit)
    reading = find_parts(parts, settings.reading)
    prepared, unread = [], list(reading.unread)
    for part in reading.parts:
        try:
            prepared.append(prepare(part, unit, settings.accuracy))
        except MeshError as error:
            unread.append(UnreadFile(str(part.file or part.name), str(error)))
    if not prepared:
        raise ArgumentError(f"no part can be packed: {unread[0].source}: {unread[0].reason}")
    task = PackTask(
        tuple(prepared),
        boxes,
        objective,
        settings,
        _in_place("keep-out", settings.keep_out, settings, unit),
        _in_place("fixed", settings.fixed, settings, unit),
        tuple(unread),
    )
    task = _without_tiny(task)
    _require_fit(task)
    note = unit_note(box)
    return replace(task, notes=(*reading.notes, *([note] if note else []), *_notes(task)))


def _in_place(
    name: str, sources: Sequence[Part | Path | str], settings: PackSettings, unit: Unit
) -> tuple[PreparedPart, ...]:
    """Read and prepare meshes that have a place in the box; any that can't be used is an error."""
    if not sources:
        return ()
    try:
        reading = replace(settings.reading, split=False, rotations=FIXED)
        found = find_parts(sources, reading)
    except ArgumentError as error:
        raise ArgumentError(f"{name}: {error}") from None
    if found.unread:
        first = found.unread[0]
        raise ArgumentError(f"{name}: {first.source}: {first.reason}")
    for each in found.parts:
        if each.count > 1:
            raise ArgumentError(f"{name}: part {each.name!r} has one place, not {each.count}")
    parts = [replace(each, rotations=FIXED) for each in found.parts]
    return tuple(prepare(each, unit, settings.accuracy) for each in parts)


def _without_tiny(task: PackTask) -> PackTask:
    """Return the task with boxes instead of the meshes of tiny parts, where these fit."""
    fitting = _fitting(task)
    if not fitting:
        return task
    least = least_side(fitting, task.gap)
    parts = []
    for each in task.parts:
        if each.item_type.extents.max() < least:
            box = boxed(each, least)
            each = each if too_large(box, task.boxes, task.margin, task.unit) else box
        parts.append(each)
    return replace(task, parts=tuple(parts))


def _require_fit(task: PackTask) -> None:
    """Raise ArgumentError if no part fits into a box."""
    if len(task.too_large) == len(task.parts):
        others = len(task.parts) - 1
        more = f" (and {others} other parts)" if others else ""
        first = task.parts[0].part.name
        raise ArgumentError(f"no part fits: {first} of {task.too_large[0]}{more}")


def _fitting(task: PackTask) -> list[PreparedPart]:
    return [each for n, each in enumerate(task.parts) if n not in task.too_large]


def _notes(task: PackTask) -> list[str]:
    """Return what the user should know about masses, meshes and sizes."""
    fitting, notes = _fitting(task), []
    if task.settings.stable is not None and any(each.mass is None for each in fitting):
        notes.append("parts without a mass or density count as 1 g/cm3 for the stability")
    notes += [
        f"{each.part.name}: {each.simplification}" for each in task.parts if each.simplification
    ]
    notes += surface_notes((*task.parts, *task.obstacles))
    return notes + unit_notes(fitting, task.boxes, task.margin, task.unit)
