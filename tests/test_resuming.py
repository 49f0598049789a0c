"""Resuming from a record: each part in it is held to the rules of a new packing."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trimesh import creation

from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.candidates import in_order
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.turning import Turning
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.limits import Limits
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results.check import check
from packit_sim.parts.results.record import write_record
from packit_sim.parts.results.resuming import read_earlier
from packit_sim.parts.results.verification import verify_record

Record = dict[str, Any]

SETTINGS = PackSettings(clearance=1.0, wall_clearance=2.0)

PLACES = ((22.0, 17, 12), (63.0, 17, 12), (22.0, 48, 12))


def packed(settings: PackSettings = SETTINGS, **given: Any) -> PackedParts:
    """Three blocks of four, at 1 from each other and 2 from the walls."""
    block = Part("a", creation.box((40, 30, 20)), **{"count": 4, "rotations": "cube", **given})
    box = BoxType((100, 100, 60))
    task = prepared_task([block], [box], "volume", settings)
    places = tuple(Placement(0, Motion.shift(place)) for place in PLACES)
    packing = Packing(task.types, task.container(box), places, task.gap, "knapsack")
    return PackedParts(task, (packing,))


def resumed(folder: Path, earlier: PackedParts, change: Callable[[Record], object]) -> PackedParts:
    """Write a record, change it, and resume."""
    write_record(earlier, None, folder, {})
    file = folder / "packing.json"
    record = json.loads(file.read_text())
    change(record)
    file.write_text(json.dumps(record))
    return read_earlier(folder, earlier.task) or PackedParts(earlier.task)


def posed(number: int, *matrix: Any) -> Callable[[Record], object]:
    """Return a change of the pose of an item: a linear map and a place, or only a place."""

    def change(record: Record) -> None:
        pose = np.array(record["items"][number]["pose"])
        if len(matrix) == 2:
            pose[:3, :3] = matrix[0]
        pose[:3, 3] = matrix[-1]
        record["items"][number]["pose"] = pose.tolist()

    return change


def scaled(record: Record) -> None:
    """Make all parts smaller, about their middles: they are farther apart than before."""
    for item in record["items"]:
        pose = np.array(item["pose"])
        pose[:3, :3] *= 0.4
        item["pose"] = pose.tolist()


def yaw(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def item(**changed: Any) -> Callable[[Record], object]:
    return lambda record: record["items"][0].update(changed)


def twice(record: Record) -> None:
    record["items"] *= 2


RULES: dict[str, tuple[Callable[[Record], object], int, str]] = {
    "unchanged": (lambda record: None, 3, ""),
    "all smaller": (scaled, 0, "a: its size is 0.4 times the part's (3 times)"),
    "one larger": (posed(0, 1.00001 * np.eye(3), PLACES[0]), 2, "its size is 1.00001 times"),
    "mirrored": (posed(0, np.diag([1.0, 1, -1]), PLACES[0]), 2, "its pose mirrors the mesh"),
    "sheared": (posed(0, np.eye(3) + 0.01 * np.eye(3, k=1), PLACES[0]), 2, "its pose shears"),
    "a last row": (item(pose=[[0] * 4] * 4), 2, "its pose has the last row"),
    "turned": (posed(2, yaw(30), (50, 70, 40)), 2, "its rotation is none of cube"),
    "in the clearance of a wall": (
        posed(0, (21.9, 17, 12)),
        2,
        "it is 1.9 mm from the box's left wall: less than the clearance of 2 mm",
    ),
    "in a wall": (posed(0, (0, 17, 12)), 2, "it reaches 20 mm beyond the box's left wall"),
    "far away": (posed(0, (1e29, 17, 12)), 2, "it reaches 1e+29 mm beyond"),
    "too close": (
        posed(1, (62.99, 17, 12)),
        2,
        "it is 0.99 mm from another a: less than the clear",
    ),
    "too close by less than the tolerance": (posed(1, (62.998, 17, 12)), 2, "it is 0.998 mm from"),
    "overlapping": (posed(1, (60, 17, 12)), 2, "it crosses another a"),
    "inside another": (posed(1, PLACES[0]), 2, "another a"),
    "unknown": (item(name="b"), 2, "b: the task has no such part"),
    "of no name": (item(name=""), 2, "the task has no such part"),
    "in no box": (item(box=1), 2, "the task has no box 1 for it"),
    "in a box of no name": (lambda r: r.update({"box names": ["B"]}), 0, "the task has no box 0"),
    "in one box more": (
        lambda r: (r["box names"].append("box"), r["items"][0].update(box=1)),
        2,
        "the task has no box 1 for it",
    ),
    "a box without items": (lambda r: r.update({"box names": ["box"] * 2}), 3, ""),
    "too many": (lambda r: r.update(items=r["items"] * 5_000), 3, "there are only 4"),
    "twice": (twice, 3, ""),
}


@pytest.mark.parametrize("what", RULES)
def test_parts_that_break_a_rule_are_not_resumed(what: str, tmp_path: Path, caplog: Any) -> None:
    change, count, warning = RULES[what]
    found = resumed(tmp_path, packed(), change)
    assert found.count == count and check(found).problems == ()
    assert all(one.scale == 1 for _, one in found.placements)
    assert warning in caplog.text and len(caplog.records) == bool(caplog.text)
    if warning:
        assert "parts are not used: " in caplog.text


@pytest.mark.parametrize("degrees", [0, 90, 180])
def test_only_the_rotations_of_a_part_are_resumed(degrees: float, tmp_path: Path) -> None:
    change = posed(2, yaw(degrees), (30, 60, 12))
    for rotations, counts in {"fixed": {0}, "yaw-2": {0, 180}, "yaw-4": {0, 90, 180}}.items():
        earlier = packed(rotations=rotations)
        assert resumed(tmp_path, earlier, change).count == 2 + (degrees in counts)
    assert resumed(tmp_path, packed(rotations="free"), posed(2, yaw(30), (50, 70, 40))).count == 3


def test_units_and_up_axes_of_files_are_no_violation(tmp_path: Path) -> None:
    for given in ({"unit": "in"}, {"up": "x"}, {"up": "y", "unit": "cm"}, {"unit_cm": 0.3}):
        part = Part("a", creation.box((0.5, 1, 0.8)), rotations="fixed", **given)
        task = prepared_task([part], [BoxType((100, 100, 100))], "volume", PackSettings())
        place = Placement(0, Motion.shift((50, 50, 50)))
        packing = Packing(task.types, task.container(task.boxes[0]), (place,), 0.0, "knapsack")
        earlier = PackedParts(task, (packing,))
        assert resumed(tmp_path, earlier, lambda record: None).count == 1


def test_parts_in_a_keep_out_or_a_fixed_part_are_not_resumed(tmp_path: Path, caplog: Any) -> None:
    there = Part("there", creation.box(bounds=[(60, 0, 0), (100, 20, 10)]))
    for name in ("keep_out", "fixed"):
        earlier = packed(replace(SETTINGS, **{name: [there]}))
        assert resumed(tmp_path, earlier, lambda record: None).count == 2
        assert "it crosses there" in caplog.text


def test_parts_that_break_a_constraint_are_not_resumed(tmp_path: Path, caplog: Any) -> None:
    for given in ({"no_stack": True}, {"max_load": 1.0, "mass": 2.0}):
        settings = PackSettings(wall_clearance=2.0)
        assert resumed(tmp_path, packed(settings, **given), posed(1, (22, 17, 32))).count == 2
    hook = creation.box(bounds=[(20, 2, 44), (40, 28, 50)])
    settings = replace(SETTINGS, insertable=True, fixed=[Part("shelf", hook)])
    assert resumed(tmp_path, packed(settings), lambda record: None).count == 2
    assert "can't be put in straight down" in caplog.text


def test_many_items_are_checked_in_linear_time(tmp_path: Path) -> None:
    """Items at one place are compared with those that are kept alone."""
    block = Part("a", creation.box((1, 1, 1)), count=500)
    task = prepared_task([block], [BoxType((10, 10, 10))], "volume", PackSettings())
    places = tuple(Placement(0, Motion.shift((5, 5, 5))) for _ in range(500))
    packing = Packing(task.types, task.container(task.boxes[0]), places, 0.0, "knapsack")
    assert resumed(tmp_path, PackedParts(task, (packing,)), lambda record: None).count == 1


def test_tiny_meshes_may_be_turned_freely() -> None:
    wedge = creation.box((1e-8, 2e-8, 3e-8))
    part = Part(
        "a", wedge.apply_transform(Motion.from_wxyz((0.8, 0.6, 0, 0)).matrix), rotations="free"
    )
    task = prepared_task([part], [BoxType((1, 1, 1))], "volume", PackSettings())
    assert task.parts[0].sides.min() < 1.1e-8


def test_parts_keep_the_distance_to_the_floor_when_they_are_lowered() -> None:
    found = in_order(packed(PackSettings(wall_clearance=2.0, stable=100.0)))
    assert check(found).problems == ()


@pytest.fixture(autouse=True)
def _warnings(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    with caplog.at_level("WARNING", "packit_sim"):
        yield


OTHER_TASKS: dict[str, dict[str, Any]] = {
    "the same": {},
    "clearance": {"clearance": 2.0},
    "clearance along z": {"clearance_z": 0.5},
    "walls": {"wall_clearance": 3.0},
    "accuracy": {"accuracy": 0.5},
    "unit": {"unit": "cm"},
    "removable": {"removable": True},
    "insertable": {"insertable": True},
    "separable": {"separable": True},
    "stable": {"stable": 1.0},
    "limits": {"limits": Limits(max_parts=2)},
    "groups": {"groups": ["kit"]},
    "other groups": {"groups": ["together"]},
    "door": {"door": "x+"},
    "order": {"order": "delivery"},
    "keep out": {"keep_out": [Part("c", creation.box((5, 5, 5)))]},
    "fixed": {"fixed": [Part("c", creation.box(bounds=((9, 9, 9), (14, 14, 14))))]},
    "objective": {"objective": "count"},
    "box": {"box": BoxType((100, 100, 61))},
    "count of boxes": {"box": BoxType((100, 100, 60), count=2)},
    "name of the box": {"box": BoxType((100, 100, 60), "b")},
    "cylinder of that name": {"box": CylinderContainer(100, 60, name="b")},
    "count of parts": {"part": {"count": 4}},
    "rotations": {"part": {"rotations": "fixed"}},
    "mesh": {"part": {"mesh": creation.box((41, 30, 20))}},
    "value": {"part": {"value": 2.0}},
    "clearance of a part": {"part": {"clearance": 3.0}},
    "group": {"part": {"group": "h"}},
    "stop": {"part": {"stop": 2}},
    "mass": {"part": {"mass": 2.0}},
    "priority": {"part": {"priority": 1}},
    "nothing on it": {"part": {"no_stack": True}},
    "load": {"part": {"max_load": 5.0}},
    "tilt": {"part": {"turning": Turning(max_tilt=20.0)}},
    "sides down": {"part": {"turning": Turning(down=("z-",))}},
    "up": {"part": {"up": "x"}},
}


SAME_BOX = BoxType((100, 100, 60))


def digest(
    box: Any = SAME_BOX,
    objective: Any = "volume",
    part: dict[str, Any] | None = None,
    **settings: Any,
) -> str:
    own = {"mesh": creation.box((40, 30, 20)), "group": "g", "stop": 1, "mass": 1.0, **(part or {})}
    given = {"clearance": 1.0, "wall_clearance": 2.0, "unit": "mm", **settings}
    return prepared_task([Part("a", **own)], [box], objective, PackSettings(**given)).digest


def test_only_a_packing_of_the_same_task_is_resumed() -> None:
    """Each change of what decides which packing is better is another task; others are not."""
    digests = {name: digest(**change) for name, change in OTHER_TASKS.items()}
    names = list(digests)
    same = [(a, b) for n, a in enumerate(names) for b in names[:n] if digests[a] == digests[b]]
    assert same == []
    for change in ({"workers": 2}, {"iterations": 7}, {"even": True}):
        assert digest(**change) == digests["the same"]


@pytest.mark.parametrize("scale", [0.01, 1.0, 1000.0])
@pytest.mark.parametrize(
    ("gap", "count"), [(1.0, 0), (0.6, 0), (0.4, 1), (0.01, 1), (-0.2, 2), (-4.0, 2)]
)
def test_the_check_is_the_same_in_all_lengths(scale: float, gap: float, count: int) -> None:
    block = Part("a", creation.box(np.array((4.0, 3, 2)) * scale), 3)
    box = BoxType((20 * scale, 10 * scale, 5 * scale))
    task = prepared_task([block], [box], "volume", PackSettings(clearance=0.5 * scale, unit="mm"))
    middles = (3, 4, 2), (16, 4, 2), (3 + 4 + gap, 4, 2)
    places = tuple(Placement(0, Motion.shift(scale * np.array(each))) for each in middles)
    packing = Packing(task.types, task.container(box), places, task.gap, "knapsack")
    found = check(PackedParts(task, (packing,)))
    assert len(found.problems) == count
    assert found.distance == pytest.approx(max(gap, 0.0) * scale)


DIGITS = {"volume": 6, "height": 5, "mass": 5, "centre of gravity": 4}


@pytest.mark.parametrize("name", DIGITS)
@pytest.mark.parametrize(("steps", "is_wrong"), [(1, False), (-1, False), (3, True), (-3, True)])
def test_a_summary_may_differ_by_one_in_the_last_digit(
    name: str, steps: int, is_wrong: bool, tmp_path: Path
) -> None:
    write_record(packed(mass=1234.56), None, tmp_path, {})
    file = tmp_path / "packing.json"
    record = json.loads(file.read_text())
    text = record["summary"][name]
    (number, *_) = re.findall(r"\d[\d.]*(?:e[-+]?\d+)?", text)
    step = 10 ** (math.floor(math.log10(float(number))) + 1 - DIGITS[name])
    record["summary"][name] = text.replace(number, f"{float(number) + steps * step:.9g}", 1)
    file.write_text(json.dumps(record))
    problems = [each.sentence for each in verify_record(file).problems]
    assert any(f"summary's {name!r}" in each for each in problems) == is_wrong, problems
