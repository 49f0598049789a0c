"""Packing people's own parts into boxes at their real sizes."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from packit_sim.core.checks import POSITIVE, Range, as_integer, check_range
from packit_sim.core.errors import ArgumentError, MeshError
from packit_sim.core.length_units import Unit
from packit_sim.parts.filling.answers import Answer
from packit_sim.parts.filling.packing_search import PackingSearch
from packit_sim.parts.filling.task import Goal, PackSettings, PackTask
from packit_sim.parts.packings.rotation_sets import FIXED
from packit_sim.parts.reading.box_types import BoxType, box_types
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.part_files import Reading, UnreadFile, find_parts
from packit_sim.parts.reading.part_sizes import too_large, unit_notes
from packit_sim.parts.reading.prepared import PreparedPart, boxed, least_side, prepare
from packit_sim.parts.reading.units import unit_of
from packit_sim.parts.results.packed import LeftOut, PackedParts
from packit_sim.parts.results.packing_record import Earlier, own_folder, read_earlier

Boxes = str | BoxType | Sequence[float] | Sequence[str | BoxType]


def pack(
    parts: Sequence[Part | Path | str],
    box: Boxes,
    objective: Goal = "volume",
    time: float = 60.0,
    seed: int = 0,
    out: Path | str | None = None,
    callback: Callable[[PackedParts, float], object] | None = None,
    settings: PackSettings | None = None,
) -> PackedParts:
    """Pack parts into boxes at their real sizes.

    Parameters
    ----------
    parts : sequence of Part, Path or str
        Parts, mesh files ("bracket.stl=4" is four of it), folders, patterns of paths and manifests.
    box : str, BoxType, or sequence of float, str or BoxType
        A box, such as "300x200x150mm", (300, 200, 150), or several sizes of boxes.
    objective : str
        "volume", "count" or "value": most of it; "height": all parts, lowest; "boxes": all parts,
        fewest boxes.
    time : float
        Seconds of the search, from the call on.
    seed : int
        The seed.
    out : Path or str, optional
        A folder to export to. If it has a packing of the same task, the search starts with it, and
        only a better one replaces it.
    callback : callable, optional
        Called with each better packing and the seconds since the call.
    settings : PackSettings, optional
        Clearances, how files are read, and how the search runs.

    Returns
    -------
    PackedParts
        The best packing. Ctrl-C ends the search early.

    Raises
    ------
    ArgumentError
        If an argument is not possible, or no part can be read or fits.
    BusyError
        If another process packs into the same folder.
    NestingError
        If no valid packing was found.
    """
    start = clock.perf_counter()
    check_range("time", time, POSITIVE)
    check_range("seed", as_integer("seed", seed), Range(0))
    settings = settings or PackSettings()
    settings = replace(settings, unit=settings.unit or _unit(box) or "mm")
    task, reading = _task(parts, box, objective, settings)
    left_out = [
        LeftOut(each.part.name, each.part.count, reason)
        for each in task.parts
        if (reason := _too_large(task, each))
    ]
    if len(left_out) == len(task.parts):
        first = left_out[0]
        more = f" (and {len(left_out) - 1} other parts)" if len(left_out) > 1 else ""
        raise ArgumentError(f"no part fits: {first.name} of {first.reason}{more}")
    gone = {each.name for each in left_out}
    fitting = [each for each in task.parts if each.part.name not in gone]
    if task.settings.stable is not None and any(each.mass is None for each in fitting):
        unknown = "parts without a mass or density count as 1 g/cm3 for the stability"
        reading = replace(reading, notes=(*reading.notes, unknown))
    notes = [
        *reading.notes,
        *_mesh_notes(task),
        *unit_notes(fitting, task.boxes, task.margin, task.unit),
    ]

    def search(earlier: Earlier | None = None) -> PackedParts:
        searches = 1 if earlier is None else earlier.searches + 1

        def packed(answer: Answer) -> PackedParts:
            missing = tuple(left_out + _not_placed(task, answer, gone))
            unread = reading.problems
            return PackedParts(task, answer.boxes, missing, unread, tuple(notes), searches)

        def better(answer: Answer) -> None:
            if callback is not None:
                callback(packed(answer), clock.perf_counter() - start)

        found = PackingSearch(task, start + time, seed + searches - 1, callback=better)
        if earlier is not None:
            found.best = Answer.of(task, earlier.boxes)
            better(found.best)
        return packed(found.run().in_order(task))

    if out is None:
        return search()
    with own_folder(Path(out)):
        found = search(read_earlier(Path(out), task))
        found.export(out)
    return found


def _unit(box: Boxes) -> Unit | None:
    """Return the unit of the first box that has one."""
    texts = [box] if isinstance(box, str) else [] if isinstance(box, BoxType) else box
    units = (unit_of(each) for each in texts if isinstance(each, str))
    return next((unit for unit in units if unit is not None), None)


def _task(
    parts: Sequence[Part | Path | str], box: Boxes, objective: Goal, settings: PackSettings
) -> tuple[PackTask, Reading]:
    """Read and prepare all parts."""
    unit: Unit = settings.unit or "mm"
    count = settings.boxes or (None if objective == "boxes" else 1)
    boxes = box_types(box, unit, count)
    PackTask((), boxes, objective if objective != "value" else "volume", settings)  # checks both
    reading = find_parts(parts, settings.reading)
    prepared, problems = [], list(reading.problems)
    for part in reading.parts:
        try:
            prepared.append(prepare(part, unit, settings.accuracy))
        except MeshError as error:
            problems.append(UnreadFile(str(part.file or part.name), str(error)))
    if not prepared:
        raise ArgumentError(f"no part can be packed: {problems[0].source}: {problems[0].reason}")
    reading = replace(reading, problems=tuple(problems))
    keep_out = _in_place("keep-out", settings.keep_out, settings, unit)
    fixed = _in_place("fixed", settings.fixed, settings, unit)
    task = PackTask(tuple(prepared), boxes, objective, settings, keep_out, fixed)
    return _without_tiny(task), reading


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
    if found.problems:
        first = found.problems[0]
        raise ArgumentError(f"{name}: {first.source}: {first.reason}")
    for each in found.parts:
        if each.count > 1:
            raise ArgumentError(f"{name}: part {each.name!r} has one place, not {each.count}")
    parts = [replace(each, rotations=FIXED) for each in found.parts]
    return tuple(prepare(each, unit, settings.accuracy) for each in parts)


def _without_tiny(task: PackTask) -> PackTask:
    """Return the task with boxes instead of the meshes of tiny parts, where these fit."""
    fitting = [each for each in task.parts if not _too_large(task, each)]
    if not fitting:
        return task
    least = least_side(fitting, task.gap)
    parts = []
    for each in task.parts:
        if each.item_type.extents.max() < least and not _too_large(task, boxed(each, least)):
            each = boxed(each, least)
        parts.append(each)
    return replace(task, parts=tuple(parts))


def _too_large(task: PackTask, part: PreparedPart) -> str | None:
    return too_large(part, task.boxes, task.margin, task.unit)


def _mesh_notes(task: PackTask) -> list[str]:
    """Return what the user should know about meshes."""
    notes = [
        f"{each.part.name}: {each.simplification}" for each in task.parts if each.simplification
    ]
    if opened := [each.part.name for each in task.parts if not each.is_closed]:
        names = ", ".join(opened)
        notes.append(f"solid by voxels, since open or self-intersecting: {names}")
    return notes


def _not_placed(task: PackTask, answer: Answer, gone: set[str]) -> list[LeftOut]:
    """Return the parts that fit into a box but are not in one, with the reasons."""
    placed = answer.counts(task)
    found = []
    for n, each in enumerate(task.parts):
        left = each.part.count - placed.get(n, 0)
        if each.part.name in gone or left == 0:
            continue
        reasons: dict[str, int] = {}
        for number, why in answer.dropped:
            if number == n and left > 0:
                reasons[why] = reasons.get(why, 0) + 1
                left -= 1
        if left:
            reasons["no space was found"] = left
        found += [LeftOut(each.part.name, count, why) for why, count in reasons.items()]
    return found
