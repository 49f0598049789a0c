"""The record of an earlier packing, from which the search resumes.

A record may be old, damaged or forged: each part in it is held to the rules of a new packing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct, field

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackFormatError
from packit_sim.core.length_units import Unit
from packit_sim.core.plain_text import listed, plain_logger
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import ROTATION_SLACK, Motion, matrix_fault, motion_and_scale
from packit_sim.libraries.data_files import read_bytes
from packit_sim.parts.filling.candidates import candidate
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings import rotation_sets
from packit_sim.parts.packings.bounds import PoseRows
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.validity import pair_problems
from packit_sim.parts.reading.units import factor
from packit_sim.parts.results.record import RECORD

ROUNDING = 1e-7
"""Rounding of distances, relative to the box's longest side."""

_log = plain_logger(__name__)


class RecordedItem(Struct):
    """A packed part: its name, the number of its box, and the matrix from its file to the box."""

    name: str
    box: Annotated[int, Meta(ge=0)]
    pose: PoseRows


class _RecordedTask(Struct):
    task: str


class _Recorded(Struct):
    """The fields from which the search resumes; others are ignored."""

    items: Annotated[tuple[RecordedItem, ...], Meta(min_length=1)]
    box_names: tuple[str, ...] = field(name="box names")
    searches: Annotated[int, Meta(ge=0, le=10**9)]


def read_earlier(folder: Path, task: PackTask) -> PackedParts | None:
    """Read the packing of the same task in a folder.

    Parts that break a rule of the task are left out, and a warning names them.

    Returns
    -------
    PackedParts or None
        The packing; None if there is none of this task.

    Raises
    ------
    ArgumentError
        If the folder has a file of this name that is something else: it would be replaced.
    """
    file = folder / RECORD
    if not file.exists():
        return None
    data = read_bytes(file)
    try:
        digest = typed_json.decode(data, _RecordedTask, PackFormatError, "a packing").task
    except PackFormatError:
        raise ArgumentError(f"{file} is not of `packit pack`: choose another folder") from None
    if digest != task.digest:
        _log.info("%s is of another task: it will be replaced", file)
        return None
    try:
        record = typed_json.decode(data, _Recorded, PackFormatError, "a packing")
    except PackFormatError as error:
        _log.warning("%s is not used: %s", file, error)
        return None
    packed, faults = resumed(task, record.items, record.box_names, record.searches)
    if faults:
        _log.warning(
            "%s: %d of %d parts are not used: %s",
            *(file, len(faults), len(record.items), listed(sentences(faults))),
        )
    return packed if packed.packings else None


def items_of(packed: PackedParts, unit: Unit) -> list[RecordedItem]:
    """Return the items of a packing as a record in a unit of length has them."""
    scale = np.array([factor(packed.task.unit, unit)] * 3 + [1.0])[:, None]
    return [
        RecordedItem(packed.part(one).part.name, box, (packed.pose(one) * scale).tolist())
        for box, packing in enumerate(packed.packings)
        for one in packing.placements
    ]


def resumed(
    task: PackTask, items: Sequence[RecordedItem], box_names: Sequence[str], searches: int
) -> tuple[PackedParts, list[tuple[str, str]]]:
    """Return the packing of a task from which a search resumes, by the items of an earlier one.

    Parameters
    ----------
    box_names : sequence of str
        The name of each box of the earlier packing.
    searches : int
        How many searches led to it.

    Returns
    -------
    packed : PackedParts
        The items that break no rule of the task.
    faults : list of (str, str)
        The name of each other item, and the rule that it breaks.
    """
    placed, faults = placed_items(task, items, box_names)
    packings = []
    for name, own in zip(box_names, placed, strict=True):
        if own:
            container = container_named(task, name)
            kept, conflicts = _without_conflicts(task, container, own)
            packings.append(task.packing(container, kept))
            faults += conflicts
    packed = candidate(task, packings, searches)
    faults += [(task.parts[n].part.name, reason) for n, reason in packed.rejected]
    return packed, faults


def placed_items(
    task: PackTask, items: Sequence[RecordedItem], box_names: Sequence[str]
) -> tuple[list[list[Placement]], list[tuple[str, str]]]:
    """Place the items of a record that keep the rules that are about one item.

    Parameters
    ----------
    box_names : sequence of str
        The name of each box of the record.

    Returns
    -------
    placed : list of list of Placement
        The placements in each box, with the exact rotations of their sets.
    faults : list of (str, str)
        The name of each other item, and the rule that it breaks.
    """
    numbers = {each.part.name: n for n, each in enumerate(task.parts)}
    left = {n: each.part.count for n, each in enumerate(task.parts)}
    boxes = {box.name: box for box in task.boxes}
    used = Counter[str]()
    containers: list[Container | None] = []
    for name in box_names:
        used[name] += 1
        box = boxes.get(name)
        is_one = box is not None and (box.count is None or used[name] <= box.count)
        containers.append(container_named(task, name) if is_one else None)
    placed: list[list[Placement]] = [[] for _ in box_names]
    faults = []
    for item in items:
        n = numbers.get(item.name)
        if n is None:
            fault = "the task has no such part"
        elif left[n] == 0:
            fault = f"there are only {task.parts[n].part.count}"
        elif item.box >= len(containers) or (container := containers[item.box]) is None:
            fault = f"the task has no box {item.box} for it"
        else:
            placement = _placement(task, n, np.array(item.pose), container)
            if not isinstance(placement, str):
                placed[item.box].append(placement)
                left[n] -= 1
                continue
            fault = placement
        faults.append((item.name, fault))
    return placed, faults


def sentences(faults: Sequence[tuple[str, str]]) -> list[str]:
    """Return a sentence for each kind of fault: the name of the parts, the rule, and how many."""
    counted = Counter(f"{name}: {fault}" for name, fault in faults)
    return [each + (f" ({k} times)" if k > 1 else "") for each, k in counted.items()]


def container_named(task: PackTask, name: str) -> Container:
    """Return the container of a box of the task, by its name."""
    return task.container(next(box for box in task.boxes if box.name == name))


def _placement(task: PackTask, number: int, pose: Floats, container: Container) -> Placement | str:
    """Return the placement of a part at a pose in a box, or the rule that it breaks."""
    prepared = task.parts[number]
    if fault := matrix_fault(pose):
        return f"its pose {fault}"
    motion, scale = motion_and_scale(pose)
    if abs(scale / prepared.scale - 1) > ROTATION_SLACK:
        return f"its size is {scale / prepared.scale:.6g} times the part's"
    rotation = motion.rotation @ prepared.part.user_from_file.rotation.T
    if prepared.part.rotations != rotation_sets.FREE:
        known = rotation_sets.matrices(prepared.part.rotations)
        errors = np.abs(known - rotation).max(axis=(1, 2))
        if errors.min() > ROTATION_SLACK:
            return f"its rotation is none of {prepared.part.rotations}"
        rotation = known[errors.argmin()]
    if fault := prepared.part.turning.fault(rotation):
        return fault
    placement = Placement(number, Motion(rotation, motion.translation))
    name, longest = prepared.part.name, container.longest
    item = CheckedItem(name, prepared.item_type, placement, longest, task.unit)
    margin = task.walls.plus(prepared.deviation)
    slack = ROUNDING * longest if task.walls.largest else item.tolerance
    fault = next(container.faults(item, margin, slack), None)
    return f"it {fault}" if fault else placement


def _without_conflicts(
    task: PackTask, container: Container, placements: Sequence[Placement]
) -> tuple[tuple[Placement, ...], list[tuple[str, str]]]:
    """Return the placements in a box without those in conflict with more valuable ones.

    Also returns the name of each of these, and the conflict.
    """
    unit, gap = container.longest, task.gap
    around = [CheckedItem(each.name, each, Placement(0), unit) for each in container.obstacles]
    low, high = np.empty((2, len(around) + len(placements), 3))
    low[: len(around)] = [each.low for each in around] or np.empty((0, 3))
    high[: len(around)] = [each.high for each in around] or np.empty((0, 3))
    kept, faults = [], []
    for n in sorted(range(len(placements)), key=lambda n: -task.weights[placements[n].type]):
        name = task.parts[placements[n].type].part.name
        item = CheckedItem("it", task.types[placements[n].type], placements[n], unit, task.unit)
        end = len(around)
        gaps = np.maximum(low[:end], item.low) - np.minimum(high[:end], item.high)
        gaps *= (1, 1, task.stretch)
        near = np.flatnonzero((gaps <= task.largest_gap).all(axis=1)).tolist()
        how = gap, ROUNDING * unit, task.stretch
        conflicts = (each for m in near for each in pair_problems(around[m], item, *how))
        if conflict := next(conflicts, None):
            faults.append((name, conflict))
            continue
        kept.append(n)
        low[end], high[end] = item.low, item.high
        item.name = f"another {name}"
        around.append(item)
    return tuple(placements[n] for n in sorted(kept)), faults
