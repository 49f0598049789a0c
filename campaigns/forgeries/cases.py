"""The right records that are forged: convex parts at places that are known without a search."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from packit_sim.core.files import digest_of
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.turning import Turning
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.limits import Limits
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.powder import Powder
from packit_sim.parts.results.check import check
from packit_sim.parts.results.record import update_record, write_record

EXPORTS = ("packing.3mf", "packing.html", "packing.png")
"""The exports of each case, which nobody opens."""

_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


@dataclass(frozen=True, eq=False)
class Case:
    """A right packing, the folder with its record, and that record."""

    packed: PackedParts
    folder: Path
    record: dict[str, Any]


def cases(folder: Path) -> list[Case]:
    """Write the records of five packings."""
    given = {
        "walls": _walls(),
        "touching": _touching(),
        "inches": _inches(),
        "stops": _stops(),
        "limits": _limits(),
    }
    return [_case(folder / name, *each) for name, each in given.items()]


def _case(
    folder: Path,
    parts: Sequence[Part],
    boxes: Sequence[BoxType],
    settings: PackSettings,
    places: Sequence[Sequence[tuple[int, Motion]]],
) -> Case:
    task = prepared_task(parts, boxes, "volume", settings)
    packings = [
        Packing(
            task.types,
            task.container(box),
            tuple(Placement(n, motion) for n, motion in own),
            task.gap,
            "knapsack",
        )
        for box, own in zip((*boxes, boxes[-1]), places, strict=False)
    ]
    packed = PackedParts(task, tuple(packings))
    found = check(packed)
    assert not found.problems, found.problems
    folder.mkdir(parents=True)
    files = write_record(packed, found, folder, {})
    for each in EXPORTS:
        (folder / each).write_text(each)
    update_record(packed, found, folder, files | {n: digest_of(folder / n) for n in EXPORTS})
    return Case(packed, folder, json.loads((folder / "packing.json").read_text()))


def _block(*sides: float) -> trimesh.Trimesh:
    return trimesh.creation.box(sides)


def _wedge(size: float) -> trimesh.Trimesh:
    points = np.array([[0.0, 0, 0], [size, 0, 0], [0, size, 0], [0, 0, size]])
    return trimesh.Trimesh(points, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], process=False)


def _at(*place: float, turn: Any = None) -> Motion:
    return Motion(np.eye(3) if turn is None else turn, np.array(place, float))


def _walls() -> Any:
    """Blocks and wedges with clearances, a volume that stays free, and a part that is left out."""
    free = Part("free", trimesh.creation.box(bounds=[(0, 0, 50), (10, 10, 60)]))
    parts = [
        Part("block", _block(40, 30, 20), 4, density=2.0, rotations="yaw-4"),
        Part("wedge", _wedge(2.4), 2, unit="cm", mass=5.0),
        Part("long", _block(200, 1, 1)),
    ]
    settings = PackSettings(clearance=1.0, wall_clearance=2.0, keep_out=[free])
    places = [(0, _at(22, 17, 12)), (0, _at(63, 17, 12)), (0, _at(17, 53, 12, turn=_TURN))]
    places += [(1, _at(40, 40, 2)), (1, _at(70, 40, 2))]
    return parts, [BoxType((100, 100, 60))], settings, [places]


def _touching() -> Any:
    """Parts that touch each other and the walls, in two boxes of two sizes."""
    parts = [
        Part("block", _block(10, 10, 10), 9, rotations="fixed", density=1.0),
        Part("slab", _block(20, 20, 4), 2, density=7.8),
    ]
    cubes = [(0, _at(5 + 10 * x, 5 + 10 * y, 5)) for x in (0, 1) for y in (0, 1)]
    one = [*cubes, (1, _at(10, 10, 12)), (1, _at(10, 10, 16))]
    boxes = [BoxType((20, 20, 20), "A"), BoxType((30, 10, 10), "B", 2)]
    return parts, boxes, PackSettings(), [one, [(0, _at(5, 5, 5)), (0, _at(20, 5, 5))]]


def _inches() -> Any:
    """Parts of files in millimetres with x up, at any rotation, beside a fixed part."""
    shelf = Part("shelf", trimesh.creation.box(bounds=[(8, 0, 0), (10, 6, 1)]), unit="in")
    parts = [
        Part("wedge", _wedge(50), 3, rotations="free", up="x", turning=Turning(max_tilt=20)),
        Part("bar", _block(100, 20, 10), up="y", mass=12.0, turning=Turning(down=("z-", "z+"))),
    ]
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    places = [(0, _at(1.5, 0.5, 0.5)), (0, _at(5, 1, 1, turn=turn)), (1, _at(3, 5, 3))]
    settings = PackSettings(clearance=0.05, unit="in", fixed=[shelf])
    return parts, [BoxType((10, 6, 4))], settings, [places]


def _stops() -> Any:
    """Parts of three stops behind a door at the side, each touching the one before it."""
    parts = [
        Part("first", _block(20, 40, 20), 2, stop=1, rotations="yaw-4"),
        Part("second", _block(30, 20, 20), 2, stop=2, turning=Turning(max_tilt=90)),
        Part("last", _wedge(20), 2, stop=3, rotations="yaw-4", turning=Turning(down=("z-",))),
    ]
    places = [(2, _at(0, 0, 0)), (2, _at(0, 40, 0, turn=_TURN.T)), (1, _at(35, 10, 10))]
    places += [(1, _at(35, 30, 10)), (0, _at(60, 20, 10)), (0, _at(60, 20, 30))]
    settings = PackSettings(door="x+", order="delivery")
    return parts, [BoxType((80, 40, 40), "van")], settings, [places]


def _limits() -> Any:
    """Two boxes of a size with limits, a balance and groups, in a bed of powder."""
    parts = [
        Part("a", _block(20, 20, 10), 3, group="A", density=1.0, rotations="yaw-4"),
        Part("b", _block(30, 20, 10), 3, group="B", density=2.0),
        Part("c", _block(20, 10, 10), 2, group="A", mass=3.0),
    ]
    limits = Limits(max_mass=40.0, max_parts=5, balance=0.1)
    one = [(0, _at(20, 20, 5)), (0, _at(42, 42, 5)), (0, _at(20, 42, 5))]
    one += [(2, _at(43, 16, 5)), (2, _at(30, 30, 15.5))]
    other = [(1, _at(30, 19, 5)), (1, _at(30, 40, 5)), (1, _at(30, 30, 16))]
    settings = PackSettings(groups=("apart", "kit"), powder=Powder(0.45, 0.2))
    return parts, [BoxType((60, 60, 40), "bed", 2, limits=limits)], settings, [one, other]
