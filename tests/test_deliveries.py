"""Doors at the side, and deliveries: no part of a later stop is in the way of an earlier one."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trimesh import creation

from packit_sim import PackedParts, PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.filling.candidates import candidate
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.handling.broken import broken_constraints
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.filtering import filter_packing
from packit_sim.parts.handling.order import order_faults, packing_order
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.results import exports
from packit_sim.parts.results.instructions import packing_instructions
from packit_sim.parts.results.resuming import items_of, resumed
from packit_sim.parts.results.summary import summary
from packit_sim.parts.results.verification import verify_record
from tests.packed_parts import cuboid, packed

DELIVERY = PackSettings(workers=1, iterations=3, door="x+", order="delivery")

BOX = (61.0, 31.0, 31.0)

Change = Callable[[dict[str, Any]], object]


def crates(stops: int = 3, count: int = 5, side: float = 9.0, **given: Any) -> list[Part]:
    """Blocks for several stops, which fill most of `BOX`, or of less."""
    mesh = creation.box((side, side, 2 * side))
    return [Part(f"{n}", mesh, count, stop=n, **given) for n in range(1, stops + 1)]


def blocked(found: PackedParts, axis: int, sign: int) -> list[tuple[int, int]]:
    """Return the stops of blocks of which the later one is between the earlier one and the door."""
    pairs = []
    for packing in found.packings:
        boxes = [packing.vertices(one) for one in packing.placements]
        stops = [found.part(one).part.stop or 0 for one in packing.placements]
        low = np.array([each.min(axis=0) for each in boxes])
        high = np.array([each.max(axis=0) for each in boxes])
        across = [d for d in range(3) if d != axis]
        for i, earlier in enumerate(stops):
            for j, later in enumerate(stops):
                depth = np.minimum(high[i], high[j]) - np.maximum(low[i], low[j])
                ahead = sign * (low[j] + high[j] - low[i] - high[i])[axis] > 0
                if earlier < later and ahead and (depth[across] > 0.1).all():
                    pairs.append((earlier, later))
    return pairs


def test_a_later_stop_may_not_stand_between_an_earlier_one_and_the_door() -> None:
    near_wall, near_door = cuboid((0, 0, 0), (20, 20, 20)), cuboid((40, 10, 0), (60, 30, 20))
    packing = packed(near_wall, near_door, names=("wall", "door"))
    first = Constraints(door="x+", stops={0: 1, 1: 2})
    assert [(one.constraint, one.sentence) for one in broken_constraints(packing, first)] == [
        ("delivery", "'wall' can't be taken straight out at stop 1: 'door' is in the way")
    ]
    filtered = filter_packing(packing, first)
    assert len(filtered.left_out) == 1 and "at stop 1" in filtered.left_out[0].reason
    for fine in (replace(first, stops={0: 2, 1: 1}), replace(first, stops={0: 1, 1: 1})):
        assert broken_constraints(packing, fine) == [] and packing_order(packing, fine) == (0, 1)
    other_side = replace(first, door="x-")
    assert broken_constraints(packing, other_side) == []
    assert packing_order(packing, other_side) == (1, 0)


def test_parts_of_one_stop_make_way_for_each_other() -> None:
    """The middle one, for stop 2, waits for the outer one; both wait for none of stop 3."""
    row = [cuboid((20 * n, 0, 0), (20 * n + 20, 20, 20)) for n in range(4)]
    constraints = Constraints(door="x+", stops={0: 3, 1: 2, 2: 2, 3: 1})
    assert broken_constraints(packed(*row), constraints) == []
    assert packing_order(packed(*row), constraints) == (0, 1, 2, 3)


def test_what_is_stuck_at_its_stop_holds_no_later_one() -> None:
    row = [cuboid((20 * n, 0, 0), (20 * n + 20, 20, 20)) for n in range(3)]
    constraints = Constraints(door="x-", stops={0: 3, 1: 1, 2: 2})
    found = broken_constraints(packed(*row), constraints)
    assert [(one.part, one.others) for one in found] == [(1, (0,)), (2, (0,))]


def test_the_order_of_placements_is_checked() -> None:
    row = [cuboid((20 * n, 0, 0), (20 * n + 20, 20, 20)) for n in range(3)]
    constraints = Constraints(door="x+", stops={0: 2, 1: 2, 2: 1})
    packing = packed(*row)
    assert order_faults(packing, constraints) == []
    turned = replace(packing, placements=tuple(packing.placements[n] for n in (0, 2, 1)))
    assert order_faults(turned, constraints) == [
        "part 3, 'part1', can't be put in straight past part 2, before it",
        "part 3, 'part1', is for stop 2, but comes after a part for stop 1",
    ]
    assert order_faults(turned, replace(constraints, fixed=frozenset({2}))) == []


@pytest.mark.parametrize("door", ["x-", "x+", "y-", "y+", "z+"])
def test_the_search_keeps_the_way_to_each_door_free(door) -> None:
    axis, sign = "xyz".index(door[0]), 1 if door[1] == "+" else -1
    size = np.roll(BOX, axis)
    settings = replace(DELIVERY, door=door, clearance=0.5, wall_clearance=0.25)
    found = pack(crates(), size.tolist(), settings=settings)
    assert found.count >= 12 and blocked(found, axis, sign) == []
    assert found.packings[0].problems() == []
    constraints = found.task.constraints
    assert broken_constraints(found.packings[0], constraints) == []
    assert order_faults(found.packings[0], constraints) == []
    stops = [found.part(one).part.stop or 0 for one in found.packings[0].placements]
    assert stops == sorted(stops, reverse=True)


def test_the_search_knows_the_stops() -> None:
    """Left out afterwards, parts of a packing without the order are many."""
    parts = [
        Part(f"{side} for {stop}", creation.box((side, side, 2 * side)), 2, stop=stop)
        for side in (6, 8, 10)
        for stop in (1, 2, 3)
    ]
    settings = replace(DELIVERY, clearance=0.2)
    free = pack(parts, BOX, settings=replace(settings, order=None, door="z+"))
    filtered = candidate(replace(free.task, settings=settings), free.packings)
    found = pack(parts, BOX, settings=settings)
    assert found.count > filtered.count and blocked(found, 0, 1) == []


def test_keep_outs_limits_and_several_boxes_go_with_stops() -> None:
    pillar = Part("pillar", cuboid((25, 10, -1), (35, 20, 32)))
    walls = WallClearance(sides=0.5)
    settings = replace(DELIVERY, keep_out=[pillar], boxes=2, wall_clearance=walls)
    found = pack(crates(2, 8, mass=10.0), f"{BOX[0]}x{BOX[1]}x{BOX[2]}mm", settings=settings)
    assert len(found.packings) >= 1 and blocked(found, 0, 1) == [] and found.count >= 10
    assert all(packing.problems() == [] for packing in found.packings)


def test_the_least_height_keeps_the_stops() -> None:
    whole = pack(crates(2, 4), BOX, settings=DELIVERY)
    found = pack(crates(2, 4), BOX, objective="height", settings=DELIVERY)
    assert found.count == whole.count == 8 and blocked(found, 0, 1) == []
    assert found.packings[0].problems() == []
    assert found.packings[0].height < 0.9 * whole.packings[0].height


@pytest.mark.slow
def test_the_search_knows_on_which_parts_nothing_may_rest() -> None:
    """Left out afterwards, four parts less are packed."""
    parts = [
        Part(f"{side} {fragile}", creation.box((side, side, 1.5 * side)), 4, no_stack=fragile)
        for side in (7, 9, 12)
        for fragile in (False, True)
    ]
    found = pack(parts, (31, 31, 31), settings=PackSettings(workers=1, iterations=5))
    assert found.count >= 12
    assert broken_constraints(found.packings[0], found.task.constraints) == []


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("packed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
        pack(crates(), BOX, settings=DELIVERY, out=folder)
    return folder / "packing.json"


def _swapped(record: dict[str, Any]) -> None:
    items = record["items"]
    items[0], items[-1] = items[-1], items[0]


def _stop(value: int | None) -> Change:
    def change(record: dict[str, Any]) -> None:
        part = next(each for each in record["request"]["parts"] if each["stop"] == 1)
        part["stop"] = value

    return change


def _door(door: str) -> Change:
    def change(record: dict[str, Any]) -> None:
        record["request"]["door"] = record["summary"]["door"] = door

    return change


FORGERIES: dict[str, tuple[Change, str]] = {
    "a later stop": (_stop(3), "taken straight out|comes after a part|'deliveries' is"),
    "no stop": (_stop(None), "needs a stop of each part: '1' has none"),
    "stop 0": (_stop(0), "stop 0 is not possible"),
    "another order of the items": (_swapped, "is for stop 3, but comes after a part for stop 1"),
    "another door": (_door("x-"), "can't be taken straight out at stop 1"),
    "the top as the door": (_door("z+"), "taken straight out|comes after|the summary's 'door'"),
    "another door than the summary's": (
        lambda record: record["request"].update(door="y-"),
        "taken straight out|can't be put in|the summary's 'door'",
    ),
    "no order": (lambda record: record["request"].update(order=None), "the summary's 'deliveries'"),
    "other numbers of the stops": (
        lambda record: record["summary"].update(deliveries="stop 1: 4, stop 2: 5, stop 3: 6"),
        "the summary's 'deliveries' is stop 1: 4",
    ),
}


@pytest.mark.parametrize("what", FORGERIES)
def test_forged_deliveries_are_refused(what: str, honest: Path) -> None:
    change, said = FORGERIES[what]
    record = json.loads(honest.read_text())
    change(record)
    forged = honest.with_name("forged.json")
    forged.write_text(json.dumps(record))
    found = [each.sentence for each in verify_record(forged).problems]
    assert any(re.search(said, sentence) for sentence in found), found


def test_a_right_record_verifies_and_resumes(honest: Path) -> None:
    assert verify_record(honest).problems == ()
    record = json.loads(honest.read_text())
    assert record["request"]["door"] == "x+" and record["request"]["order"] == "delivery"
    assert {each["stop"] for each in record["request"]["parts"]} == {1, 2, 3}


def test_parts_in_the_way_are_not_resumed() -> None:
    found = pack(crates(2, 2), BOX, settings=DELIVERY)
    items = items_of(found, "mm")
    same, faults = resumed(found.task, items, ["box"], 1)
    assert same.count == len(items) and faults == []
    behind = np.diag([1.0, 1, 1, 1]).tolist()
    moved = []
    for item in items:  # those of stop 1 to the wall, the others in front of them
        place = (5.0 if item.name == "1" else 45.0, 5.0 + 12 * len(moved) % 24, 10.0)
        pose = [[*row[:3], at] for row, at in zip(behind[:3], place, strict=True)]
        moved.append(type(item)(item.name, 0, (*map(tuple, pose), (0.0, 0.0, 0.0, 1.0))))
    again, faults = resumed(found.task, moved, ["box"], 1)
    assert again.count < len(items)
    assert any("taken straight out at stop 1" in fault for _, fault in faults)


def test_impossible_deliveries_are_one_clear_error() -> None:
    block = creation.box((5, 5, 5))
    with pytest.raises(ArgumentError, match="needs a stop of each part: 'b' has none"):
        pack([Part("a", block, stop=1), Part("b", block)], BOX, settings=DELIVERY)
    for stop in (0, -1, 1.5, 10_001):
        with pytest.raises(ArgumentError, match="part 'a': stop"):
            Part("a", block, stop=stop)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"door 'z-' is not possible: choose from x-, x\+"):
        PackSettings(door="z-")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="order 'random' is not possible: choose delivery"):
        PackSettings(order="random")  # type: ignore[arg-type]
    with pytest.raises(
        ArgumentError, match=r"door x\+ is not possible in 'cylinder', a cylinder: choose str"
    ):
        prepared_task(crates(), "cylinder:50x50mm", "volume", PackSettings(door="x+"))


def test_lists_of_parts_have_stops(tmp_path: Path) -> None:
    creation.box((1, 1, 1)).export(tmp_path / "a.stl")
    (tmp_path / "list.csv").write_text("file,Stop\na.stl,2\na.stl,1.0\na.stl,\n")
    parts = find_parts([tmp_path / "list.csv"]).parts
    assert [each.stop for each in parts] == [2, 1, None]
    assert len({each.digest for each in parts}) == 3


def test_summary_and_instructions_name_door_and_stops(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("PACKIT_RENDERER", "software")
    monkeypatch.setattr("packit_sim.parts.results.instructions.LARGE", (100, 72))
    monkeypatch.setattr("packit_sim.parts.results.instructions.SMALL", (50, 40))
    found = pack(crates(2, 1), BOX, settings=DELIVERY)
    texts = summary(found)
    assert texts["door"] == "x+" and texts["deliveries"] == "stop 1: 1, stop 2: 1"
    boxes = [("Box", found.contents[0])]
    file = packing_instructions(tmp_path / "a.html", boxes, constraints=found.task.constraints)
    page = file.read_text()
    assert "2 parts, put in through the right side" in page
    assert re.findall(r"step \d of 2, for stop \d", page) == [
        *("step 1 of 2, for stop 2", "step 2 of 2, for stop 1")
    ]
    assert page.count("Push it in through the right side.") == 2


def test_a_box_without_a_top_may_have_a_door() -> None:
    row = [cuboid((20 * n, 0, 0), (20 * n + 20, 20, 20)) for n in range(2)]
    packing = replace(packed(*row), container=BoxContainer((100, 100, np.inf)), objective="strip")
    constraints = Constraints(door="y-", removable=True, fixed=frozenset({1}))
    assert broken_constraints(packing, constraints) == []
