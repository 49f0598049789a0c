"""The check of the record of a packing: by its meshes, and by what it says was asked for."""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct, field

from packit_sim.core import typed_json
from packit_sim.core.check_reports import FileProblem, Report
from packit_sim.core.errors import MeshError, PackFormatError, PackItError, located
from packit_sim.core.files import digest_of
from packit_sim.core.plain_text import listed
from packit_sim.libraries.data_files import read_bytes
from packit_sim.parts.filling.balance import balance_fault, off_middle
from packit_sim.parts.filling.groups import group_faults
from packit_sim.parts.filling.packed import PackedParts, packed_of
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.handling.broken import broken_constraints
from packit_sim.parts.handling.order import order_faults
from packit_sim.parts.handling.separability import links_of_items
from packit_sim.parts.packings import validity
from packit_sim.parts.packings.bounds import PoseRows
from packit_sim.parts.packings.container_files import RecordedForm
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.mesh_paths import file_inside
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.results.check import Check, check
from packit_sim.parts.results.own_files import is_export
from packit_sim.parts.results.record import outline_pose
from packit_sim.parts.results.request import Request, RequestedBox
from packit_sim.parts.results.resuming import (
    RecordedItem,
    container_named,
    placed_items,
    sentences,
)
from packit_sim.parts.results.summary import summary

REQUEST = (
    "what was asked for: parts, counts, sizes, boxes, walls, rotations, constraints, summary; "
    "digests of files"
)
"""The statements that a file without a request lacks."""

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

_DIGITS = {"volume": 6, "height": 5, "mass": 5, "limits": 5}
"""Digits of the numbers of the summary; the others have 4."""

_SAME = 1e-6
"""Relative rounding of volumes and masses."""


class _Item(RecordedItem):
    mesh: str
    clearance: float | None = None


class _Obstacle(Struct):
    name: str
    mesh: str
    pose: PoseRows
    is_part: bool = field(name="is part")
    clearance: float | None = None


class _LeftOut(Struct):
    name: str
    count: int


class _Part(Struct):
    name: str
    count: int
    volume: float
    mass: float | None


class _Record(Struct, rename=lambda name: name.replace("_", " ")):
    """The fields that are compared with the request; others are ignored."""

    request: Request
    items: tuple[_Item, ...]
    obstacles: tuple[_Obstacle, ...]
    box: tuple[float, float, float]
    boxes: tuple[tuple[float, float, float], ...]
    box_names: tuple[str, ...]
    unit: str
    objective: str
    clearance: float
    wall_clearance: float | WallClearance
    left_out: tuple[_LeftOut, ...]
    parts: tuple[_Part, ...]
    summary: dict[str, str]
    files: dict[str, str]
    containers: tuple[RecordedForm | None, ...] = ()  # earlier versions had only boxes
    clearance_z: float | None = None


class _Asked(Struct):
    request: Any = None


def verify_record(file: Path | str) -> Report:
    """Check a packing by its meshes, and by what was asked for if its file says so.

    Parameters
    ----------
    file : Path or str
        The JSON file, as `verify_packing` reads it. A record of `packit pack` has a `request`.

    Returns
    -------
    Report
        The problems, and what could not be checked.

    Raises
    ------
    PackFormatError
        If the file is not of this form; the message names the file and the field.

    Notes
    -----
    The task is prepared again from the request and the meshes. Each part must have its size, a
    rotation of its set, and its distance to the walls; no part and no box is there more often than
    asked for, and each part is packed or left out. If all this is right, the original meshes are
    compared (see `check`), and so are the constraints and the summary. The files of the result
    must have the recorded digests; exports that are missing, or not recorded, are not checked.
    """
    file = Path(file)
    report = verify_packing(file)
    data = read_bytes(file)
    with located(file, PackFormatError):
        if typed_json.decode(data, _Asked, PackFormatError).request is None:
            return replace(report, unchecked=(REQUEST,), linked=_linked(file, report))
        record = typed_json.decode(data, _Record, PackFormatError, "a packing")
    changed, not_compared = _files(record, file.parent)
    found = [*changed, *_compared(record, file.parent, report.is_valid)]
    problems = [FileProblem(file, None, sentence) for sentence in found]
    request = record.request
    unchecked = [f"the constraint {text}" for text in request.constraints]
    if request.stable is not None:
        unchecked.append(f"that parts move by at most {request.stable:g} {request.unit}")
    if not_compared:
        unchecked.append(listed(not_compared))
    report = replace(report, problems=(*report.problems, *problems), unchecked=tuple(unchecked))
    stated = record.summary.get("linked pairs")  # compared, if the packing is valid
    return replace(report, linked=stated if stated and report.is_valid else _linked(file, report))


def _linked(file: Path, report: Report) -> str:
    """Name the linked pairs of a valid packing."""
    if not report.is_valid:
        return ""
    return links_of_items(Packing.read(file))


def _files(record: _Record, folder: Path) -> tuple[list[str], list[str]]:
    """Compare the digests of the result's files, but for those of meshes that the request has.

    Returns
    -------
    list of str
        The problems.
    list of str
        What can't be compared.
    """
    request = record.request
    outlines = [box.outline for box in request.boxes if box.outline is not None]
    meshes = (*request.parts, *request.keep_out, *request.fixed, *outlines)
    known = {(each.mesh, each.sha256) for each in meshes}
    problems, unchecked = [], []
    for name, digest in record.files.items():
        if (name, digest) in known:
            continue
        try:
            own = file_inside(folder, name)
        except MeshError as error:
            problems.append(str(error))
            continue
        if not os.path.lexists(own):
            unchecked.append(f"{name!r} (missing)")
        elif not own.is_file() or digest_of(own) != digest:
            problems.append(f"{name!r} is another file than was written, by its SHA-256")
    exports = sorted(each.name for each in folder.iterdir() if is_export(each.name))
    unchecked += [f"{name!r} (not recorded)" for name in exports if name not in record.files]
    return problems[: validity.MAX_PROBLEMS], unchecked


def _compared(record: _Record, folder: Path, is_valid: bool) -> list[str]:
    """Return what is not as it was asked for in a packing that may be valid."""
    found = [*_settings(record), *_counts(record)]
    try:
        task = record.request.task(folder)
    except PackItError as error:
        return [*found, f"what was asked for can't be checked: {error}"]
    placed, faults = placed_items(task, record.items, record.box_names)
    found += _own_clearances(record, task)
    found += [*_obstacles(record, task), *_outlines(record, task)]
    found += sentences(faults)[: validity.MAX_PROBLEMS]
    if found or not is_valid:
        return found
    packings = [
        task.packing(container_named(task, name), own)
        for name, own in zip(record.box_names, placed, strict=True)
    ]
    packed = PackedParts(task, tuple(packings))
    checked = check(packed)
    found += checked.problems
    for number, packing in enumerate(packings, start=1):
        limits = task.limits(packing)
        found += [f"box {number} {fault}" for fault in limits.faults(task.masses_in(packing))]
        if fault := balance_fault(limits, off_middle(task, packing)):
            found.append(f"box {number}: {fault}")
    found += _groups(record)
    constraints = replace(task.constraints, stable=None)
    if not constraints.is_empty:
        for contents in packed.contents:
            broken = [one.sentence for one in broken_constraints(contents, constraints)]
            is_ordered = constraints.is_straight and not broken
            found += order_faults(contents, constraints) if is_ordered else broken
    return found or [*_masses(record, task), *_summary(record, packed, checked)]


def _settings(record: _Record) -> Iterator[str]:
    """Compare settings, boxes, names of meshes and obstacles."""
    request = record.request
    for name in ("unit", "objective", "clearance", "clearance_z", "wall_clearance"):
        stated, asked = getattr(record, name), getattr(request, name)
        if stated != asked:
            yield f"field {name.replace('_', ' ')!r} is {stated!r}, but {asked!r} was asked for"
    sizes = {box.name: box.size for box in request.boxes}
    if record.boxes != tuple(sizes.get(name) for name in record.box_names):
        yield "the boxes are not those that were asked for"
    asked = {box.name: _asked_form(box) for box in request.boxes}
    stated = [
        ("box", None) if each is None else (each.form, each.mesh)
        for each in record.containers or (None,) * len(record.boxes)
    ]
    if stated != [asked.get(name) for name in record.box_names]:
        yield "the containers are not those that were asked for"
    if record.boxes[:1] != (record.box,):
        yield "field 'box' is not the first of 'boxes'"
    meshes = {each.name: each.mesh for each in request.parts}
    for name, mesh in dict.fromkeys((item.name, item.mesh) for item in record.items):
        if name in meshes and meshes[name] != mesh:
            yield f"the mesh of {name!r} is {mesh!r}, but {meshes[name]!r} was asked for"


def _own_clearances(record: _Record, task: PackTask) -> Iterator[str]:
    """Compare the clearances that parts have of their own."""
    asked = {each.part.name: each.clearance for each in (*task.parts, *task.obstacles)}
    recorded = [(each.name, each.clearance) for each in record.items]
    recorded += [(each.name, each.clearance) for each in record.obstacles]
    for name, stated in dict.fromkeys(recorded):
        true = asked.get(name, stated)
        if (stated is None) != (true is None) or not math.isclose(stated or 0, true or 0):
            yield f"the clearance of {name!r} is said to be {stated}, but {true} was asked for"


def _asked_form(box: RequestedBox) -> tuple[str, str | None]:
    return box.form, None if box.outline is None else box.outline.mesh


def _outlines(record: _Record, task: PackTask) -> Iterator[str]:
    """Compare the poses of the meshes that are containers."""
    for name, form in zip(record.box_names, record.containers, strict=False):
        if form is None or form.pose is None or name not in task.outlines:
            continue
        if not np.allclose(form.pose, outline_pose(task.outlines[name]), _SAME, 1e-9):
            yield f"the container {name!r} is not where it was asked for"


def _obstacles(record: _Record, task: PackTask) -> Iterator[str]:
    """Compare the volumes that stay free and the fixed parts, which have one place."""
    request = record.request
    asked = zip((*request.keep_out, *request.fixed), task.obstacles, strict=True)
    places = [
        (one.name, one.mesh, each in task.fixed, each.part.matrix(task.unit)) for one, each in asked
    ]
    is_same = len(places) == len(record.obstacles) and all(
        (one.name, one.mesh, one.is_part) == asked[:3] and np.allclose(one.pose, asked[3], _SAME, 0)
        for one, asked in zip(record.obstacles, places, strict=True)
    )
    if not is_same:
        yield "the obstacles are not those that were asked for"


def _counts(record: _Record) -> Iterator[str]:
    """Compare how many parts are packed and left out with how many were asked for."""
    asked = [(each.name, each.count) for each in record.request.parts]
    if [(each.name, each.count) for each in record.parts] != asked:
        yield "field 'parts' has other parts, or other counts, than were asked for"
    packed = Counter(item.name for item in record.items)
    left = Counter[str]()
    for each in record.left_out:
        left[each.name] += each.count
    for name, count in asked:
        if packed[name] + left[name] != count or left[name] < 0:
            yield (
                f"{packed[name]} of {name!r} are packed and {left[name]} left out, "
                f"but {count} were asked for"
            )
    if strange := [name for name in left if name not in dict(asked)]:
        yield f"{strange[0]!r} is left out, but was not asked for"


def _groups(record: _Record) -> list[str]:
    """Compare the boxes with the rules of groups."""
    parts = record.request.parts
    boxes = [Counter[str]() for _ in record.box_names]
    for item in record.items:
        boxes[item.box][item.name] += 1
    groups = {each.name: each.group for each in parts}
    asked = {each.name: each.count for each in parts}
    return group_faults(record.request.groups, groups, asked, boxes)


def _masses(record: _Record, task: PackTask) -> Iterator[str]:
    """Compare the volume and the mass of one of each part that is packed."""
    stated = {each.name: each for each in record.parts}
    for each in task.parts:
        own = stated[each.part.name]
        for name, value, true in (
            ("volume", own.volume, each.volume),
            ("mass", own.mass, each.mass),
        ):
            if value != true and not (value and true and abs(value / true - 1) <= _SAME):
                yield f"the {name} of {each.part.name!r} is said to be {value}, but is {true}"


def _summary(record: _Record, packed: PackedParts, checked: Check) -> Iterator[str]:
    """Compare the texts of the summary, whose numbers may differ by one in the last digit."""
    stated, true = dict(record.summary), summary(packed, checked)
    true["packed"] = packed_of(packed.count, record.request.parts)
    if stated.pop("check", "") == "not done" and "smallest distance" not in stated:
        true.pop("smallest distance", None)
    if "linked pairs" not in stated:  # of an earlier version
        true.pop("linked pairs", None)
    del true["check"]
    longest = max(max(box.size) for box in packed.task.boxes)
    for name in dict.fromkeys((*true, *stated)):
        if not _is_same(name, stated.get(name), true.get(name), longest):
            yield (
                f"the summary's {name!r} is {stated.get(name, 'missing')}, "
                f"but should be {true.get(name, 'missing')}"
            )


def _is_same(name: str, stated: str | None, true: str | None, longest: float) -> bool:
    if stated is None or true is None:
        return False
    if stated == true:
        return True
    is_exact = name in ("packed", "linked pairs", "deliveries")
    if is_exact or _NUMBER.sub("0", stated) != _NUMBER.sub("0", true):
        return False
    for one, other in zip(_NUMBER.findall(stated), _NUMBER.findall(true), strict=True):
        size = abs(float(other))
        last = 10.0 ** (math.floor(math.log10(size)) + 1 - _DIGITS.get(name, 4)) if size else 0.0
        last = max(last, 1e-3 if name == "density" else _SAME * longest)
        if not abs(float(one) - float(other)) <= 1.01 * last:
            return False
    return True
