"""Preparation: the task of packing some parts into some boxes, from what the user gave."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from packit_sim.core.choices import Goal
from packit_sim.core.errors import ArgumentError, MeshError, about
from packit_sim.core.length_units import Unit
from packit_sim.core.parallel import Threads
from packit_sim.core.plain_text import listed
from packit_sim.core.progress import Progress, unseen
from packit_sim.core.sums import plain_sum
from packit_sim.parts.filling.free_turns import with_free_turns
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.filling.task_checks import check_margin, check_objective, check_task
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.rotation_sets import FIXED
from packit_sim.parts.packings.turning import ANY_TURN
from packit_sim.parts.reading.box_lists import without_lists
from packit_sim.parts.reading.boxes import Boxes, BoxType, box_types, box_unit, unit_note
from packit_sim.parts.reading.files import UnreadFile, find_parts
from packit_sim.parts.reading.limits import Limits
from packit_sim.parts.reading.mesh_boxes import with_meshes
from packit_sim.parts.reading.named_containers import without_names
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

_LARGE = 200_000
"""Triangles of a mesh above which parts are prepared one at a time: it takes gigabytes."""

MAX_TRIANGLES = 20_000_000
"""Most triangles of all parts together, each counted once however many of it there are."""

_ROUNDING = 1e-6
"""Relative rounding of volumes, where copies of a part fill a box without a gap."""

_FEW = 3
"""Notes on different parts that are alike and yet given one by one."""

_NUMBER = re.compile(r"\d[\d.,]*(e[+-]?\d+)?")


def prepared_task(
    parts: Sequence[Part | Path | str],
    box: Boxes,
    objective: Goal,
    settings: PackSettings,
    progress: Progress = unseen,
) -> PackTask:
    """Read and prepare all parts of a task.

    Parameters
    ----------
    parts : sequence of Part, Path or str
        Parts, mesh files, folders, patterns of paths and manifests.
    box : str, BoxType, Container, or sequence of float, str, BoxType or Container
        A box, or several; a table (`box_lists`) has a box in each row.
    objective : str
        One of `GOALS`.
    progress : callable, optional
        Called with each step, and how much of it is done.

    Returns
    -------
    PackTask
        The task, with notes for the user.

    Raises
    ------
    ArgumentError
        If an argument is not possible, or no part can be read or fits.
    """
    with about("box"):
        box, listed_limits = without_lists(box)
        box, published = without_names(box)
    unit: Unit = settings.unit or box_unit(box) or "mm"
    accuracy = None if settings.accuracy is None else settings.accuracy * factor(unit, "mm")
    settings = replace(settings, unit=unit, reading=replace(settings.reading, accuracy=accuracy))
    boxes, outlines = prepared_boxes(box, objective, settings, unit, listed_limits)
    progress("reading", 0, 0)
    reading = find_parts(parts, settings.reading)
    _check_triangles(reading.parts)
    prepared, unread = [], list(reading.unread)
    ready = itertools.count(1)

    def one(part: Part) -> PreparedPart | UnreadFile:
        try:
            return prepare(part, unit, settings.accuracy)
        except MeshError as error:
            return UnreadFile(str(part.file or part.name), str(error))
        finally:
            progress("preparing", next(ready), len(reading.parts))

    is_large = any(len(each.mesh.faces) > _LARGE for each in reading.parts)
    own = settings.workers if settings.backend == "threads" else 0
    with Threads(1 if is_large else own) as threads:
        for found in threads.map(one, [(part,) for part in reading.parts]):
            unread.append(found) if isinstance(found, UnreadFile) else prepared.append(found)
    if not prepared:
        raise ArgumentError(f"no part can be packed: {unread[0].source}: {unread[0].reason}")
    boxes, limit_notes = _as_published(boxes, published, prepared)
    with about("keep_out"):
        keep_out = _in_place("keep-out", settings.keep_out, settings, unit)
    with about("fixed"):
        fixed = _in_place("fixed", settings.fixed, settings, unit)
    task = PackTask(
        tuple(_bounded(prepared, boxes)),
        boxes,
        objective,
        settings,
        keep_out,
        fixed,
        tuple(unread),
        inputs=reading.inputs,
        outlines=outlines,
    )
    check_task(task)
    task = _without_tiny(with_free_turns(task))
    _require_fit(task)
    note = unit_note(box)
    notes = [*reading.notes, *([note] if note else []), *limit_notes, *_notes(task)]
    return replace(task, notes=tuple(_joined(notes)))


def prepared_boxes(
    box: Boxes,
    objective: Goal,
    settings: PackSettings,
    unit: Unit,
    listed: Mapping[str, Limits] = MappingProxyType({}),
) -> tuple[tuple[BoxType, ...], Mapping[str, PreparedPart]]:
    """Read and prepare the boxes of a task.

    Parameters
    ----------
    box : str, BoxType, Container, or sequence of float, str, BoxType or Container
        A box, or several, without lists of boxes and names of containers.
    objective : str
        One of `GOALS`.
    unit : str
        The unit of the result.
    listed : mapping of str to Limits
        The limits in lists of boxes, by the names of boxes.

    Returns
    -------
    boxes : tuple of BoxType
        The boxes, with their limits.
    outlines : mapping of str to PreparedPart
        The meshes of those that are meshes, by their names.

    Raises
    ------
    ArgumentError
        If a box, a limit, the objective or a distance from the walls is not possible.
    """
    count = settings.boxes or (None if objective == "boxes" else 1)
    with about("box"):
        box, outlines = with_meshes(box, unit, settings.reading, count)
        boxes = box_types(box, unit, count)
    boxes = _limited(boxes, settings.limits, listed)
    check_objective(objective, boxes)
    check_margin(WallClearance.of(settings.wall_clearance), boxes, unit)
    return boxes, outlines


def _limited(
    boxes: Sequence[BoxType], limits: Limits | Mapping[str, Limits], listed: Mapping[str, Limits]
) -> tuple[BoxType, ...]:
    """Return boxes with the limits that they do not have themselves, also of lists of boxes."""
    known = {"": limits} if isinstance(limits, Limits) else limits
    names = [box.name for box in boxes]
    if strange := [name for name in known if name and name not in names]:
        with about("max_parts" if known[strange[0]].max_mass is None else "max_mass"):
            raise ArgumentError(
                f"there is no box {strange[0]!r} for limits: choose from {', '.join(names)}"
            )
    general = known.get("", Limits())
    found = []
    for box in boxes:
        named = known.get(box.name, Limits()).over(listed.get(box.name, Limits()))
        found.append(replace(box, limits=box.limits.over(named).over(general)))
    return tuple(found)


def _as_published(
    boxes: Sequence[BoxType], limits: Mapping[str, Limits], parts: Sequence[PreparedPart]
) -> tuple[tuple[BoxType, ...], list[str]]:
    """Return boxes with the limits of containers with a name, as far as masses are known."""
    unknown = next((each.part.name for each in parts if each.mass is None), None)
    found, notes = [], []
    for box in boxes:
        usual = limits.get(box.name, Limits())
        if usual.max_mass is not None and box.limits.max_mass is None and unknown is not None:
            notes.append(
                f"{box.name} may hold {usual.max_mass / 1000:g} kg, which is not considered: "
                f"part {unknown!r} has no mass or density"
            )
            usual = replace(usual, max_mass=None)
        found.append(replace(box, limits=box.limits.over(usual)))
    return tuple(found), notes


def _bounded(parts: Iterable[PreparedPart], boxes: Sequence[BoxType]) -> Iterator[PreparedPart]:
    """Yield parts: of those of which as many as fit are packed, no more than have space."""
    for each in parts:
        if each.part.as_many_as_fit:
            if endless := [box.name for box in boxes if box.count is None]:
                with about("boxes"):
                    raise ArgumentError(
                        f"part {each.part.name!r}: as many as fit needs a number of boxes: "
                        f"{endless[0]!r} has none"
                    )
            space = plain_sum(box.container.volume * (box.count or 0) for box in boxes)
            most = space / max(each.volume, 1e-300) * (1 + _ROUNDING)
            count = max(1, int(min(each.part.count, most)))
            kind = replace(each.item_type, demand=count)
            each = replace(each, part=replace(each.part, count=count), item_type=kind)
        yield each


def _check_triangles(parts: Sequence[Part]) -> None:
    """Raise ArgumentError if the meshes of all parts would take too much memory."""
    triangles = sum(len(each.mesh.faces) for each in parts)
    if triangles > MAX_TRIANGLES:
        raise ArgumentError(
            f"{len(parts):,} parts have {triangles:,} triangles: at most {MAX_TRIANGLES:,} "
            "together; pack fewer different parts, or reduce them first"
        )


def _in_place(
    name: str, sources: Sequence[Part | Path | str], settings: PackSettings, unit: Unit
) -> tuple[PreparedPart, ...]:
    """Read and prepare meshes that have a place in the box; any that can't be used is an error."""
    if not sources:
        return ()
    try:
        reading = replace(settings.reading, split=False, rotations=FIXED, turning=ANY_TURN)
        found = find_parts(sources, reading)
    except ArgumentError as error:
        raise ArgumentError(f"{name}: {error}") from None
    if found.unread:
        first = found.unread[0]
        raise ArgumentError(f"{name}: {first.source}: {first.reason}")
    for each in found.parts:
        if each.count > 1:
            raise ArgumentError(f"{name}: part {each.name!r} has one place, not {each.count}")
    parts = [replace(each, rotations=FIXED, turning=ANY_TURN) for each in found.parts]
    return tuple(prepare(each, unit, settings.accuracy) for each in parts)


def _without_tiny(task: PackTask) -> PackTask:
    """Return the task with boxes instead of the meshes of tiny parts, where these fit."""
    fitting = _fitting(task)
    if not fitting:
        return task
    least = least_side(fitting, task.largest_gap)
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


def _joined(notes: Sequence[str]) -> Iterator[str]:
    """Join more than a few notes "name: text" whose texts differ only in numbers."""
    alike: dict[str, list[str]] = {}
    for note in notes:
        _, found, text = note.partition(": ")
        alike.setdefault(_NUMBER.sub("0", text) if found else note, []).append(note)
    for own in alike.values():
        if len(own) <= _FEW:
            yield from own
        else:
            names = [note.partition(": ")[0] for note in own]
            yield f"{len(own)} parts ({listed(names)}), the first: {own[0].partition(': ')[2]}"


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
