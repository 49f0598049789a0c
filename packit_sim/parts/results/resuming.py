"""The record of an earlier packing, from which the search resumes."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct, field

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackFormatError, PackItError
from packit_sim.core.plain_text import plain_logger
from packit_sim.libraries.data_files import read_bytes
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.lengths import PoseRows
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.results.record import RECORD

_log = plain_logger(__name__)


class _RecordedTask(Struct):
    task: str


class _RecordedPart(Struct):
    name: str
    box: Annotated[int, Meta(ge=0)]
    pose: PoseRows


class _RecordedBoxes(Struct):
    """The fields from which the search resumes; others are ignored."""

    items: Annotated[tuple[_RecordedPart, ...], Meta(min_length=1)]
    box_names: tuple[str, ...] = field(name="box names")
    searches: Annotated[int, Meta(ge=0, le=10**9)]


def read_earlier(folder: Path, task: PackTask) -> PackedParts | None:
    """Read the packing of the same task in a folder.

    Returns
    -------
    PackedParts or None
        The packing; None if there is none of this task, or it is not valid.

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
        record = typed_json.decode(data, _RecordedBoxes, PackFormatError, "a packing")
        return PackedParts(task, _packings(record, task), searches=record.searches)
    except PackItError as error:
        _log.warning("%s is not used: %s", file, error)
        return None


def _packings(record: _RecordedBoxes, task: PackTask) -> tuple[Packing, ...]:
    """Return the packings of a record; raise PackFormatError if they are not of the task."""
    numbers = {each.part.name: n for n, each in enumerate(task.parts)}
    types = {box.name: box for box in task.boxes}
    parts = Counter(item.name for item in record.items)
    boxes = Counter(record.box_names)
    strange = [repr(name) for name in parts if name not in numbers]
    strange += [repr(name) for name in boxes if name not in types]
    if strange:
        raise PackFormatError(f"the task has no {strange[0]}")
    if any(k > task.parts[numbers[name]].part.count for name, k in parts.items()):
        raise PackFormatError("it has more parts than there are")
    if any(box.count is not None and boxes[box.name] > box.count for box in task.boxes):
        raise PackFormatError("it has more boxes than there are")
    if {item.box for item in record.items} != set(range(len(record.box_names))):
        raise PackFormatError(f"its parts are not in each of its {len(record.box_names)} boxes")
    file_from_user = [np.linalg.inv(each.part.matrix(each.unit)) for each in task.parts]
    placements: list[list[Placement]] = [[] for _ in record.box_names]
    for item in record.items:
        n = numbers[item.name]
        placements[item.box].append(
            Placement.from_matrix(n, np.array(item.pose) @ file_from_user[n])
        )
    found = []
    for name, own in zip(record.box_names, placements, strict=True):
        container = task.container(types[name])
        packing = Packing(task.types, container, tuple(own), task.gap, "knapsack")
        if problems := packing.problems():
            raise PackFormatError(problems[0])
        found.append(packing)
    return tuple(found)
