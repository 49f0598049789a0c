"""Limits of a box: the search keeps them, the record has them, and the check recomputes them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from trimesh import creation

from packit_sim import BoxType, ItemType, Limits, NestSettings, PackSettings, Part, nest, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts import summary
from packit_sim.parts.filling.candidates import candidate
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.shelf_filling import allowed
from packit_sim.parts.nesting.limits import ItemLimits
from packit_sim.parts.nesting.settings import SearchSettings
from packit_sim.parts.reading.limits import grams, read_limits
from packit_sim.parts.results import exports
from packit_sim.parts.results.verification import verify_record

QUICK = PackSettings(workers=1, iterations=20)


def cube(name: str, side: float = 10.0, **settings) -> Part:
    return Part(name, creation.box((side, side, side)), rotations="fixed", **settings)


def counts(packed) -> dict[str, int]:
    names = [packed.part(one).part.name for _, one in packed.placements]
    return {name: names.count(name) for name in sorted(set(names))}


def test_the_parts_that_give_most_within_the_limits_are_chosen() -> None:
    parts = [
        cube("heavy", 12, count=9, mass=50),
        cube("light", count=9, mass=10),
        cube("small", 5, count=9, mass=1),
    ]
    limits = Limits(max_mass=100, max_parts=6)
    packed = pack(parts, (40, 40, 40), settings=replace(QUICK, limits=limits))
    assert counts(packed) == {"heavy": 1, "light": 5}
    assert summary(packed)["limits"] == "100 of 100 g, 6 of 6 parts"
    assert {each.reason for each in packed.left_out} == {"a limit of the box is reached"}


def test_each_type_of_boxes_has_its_limits() -> None:
    boxes = [
        BoxType((40, 40, 40), "A", limits=Limits(max_parts=2)),
        BoxType((40, 40, 40), "B"),
        BoxType((40, 40, 40), "C"),
    ]
    limits = {"": Limits(max_parts=4), "B": Limits(max_mass=30)}
    packed = pack([cube("a", count=12, mass=10)], boxes, settings=replace(QUICK, limits=limits))
    assert [len(each.placements) for each in packed.packings] == [2, 3, 4]


def test_fewest_boxes_keep_the_limits() -> None:
    settings = replace(QUICK, limits=Limits(max_mass=30))
    packed = pack([cube("a", count=7, mass=10)], (40, 40, 40), "boxes", settings=settings)
    assert sorted(len(each.placements) for each in packed.packings) == [1, 3, 3]


def test_candidates_lose_what_is_too_much() -> None:
    settings = replace(QUICK, limits=Limits(max_parts=2))
    packed = pack([cube("a", count=8, mass=10)], (40, 40, 40), settings=QUICK)
    task = pack([cube("a", count=8, mass=10)], (40, 40, 40), settings=settings).task
    found = candidate(task, packed.packings)
    assert found.count == 2
    assert found.rejected[0][1] == "the box holds 8 parts: at most 2"


def test_a_part_that_is_too_heavy_is_left_out_with_the_reason() -> None:
    settings = replace(QUICK, limits=Limits(max_mass=20))
    packed = pack([cube("a", mass=10), cube("b", mass=21)], (40, 40, 40), settings=settings)
    (left,) = packed.left_out
    assert left.reason == "21 g is heavier than what the box may hold, 20 g"
    with pytest.raises(ArgumentError, match="no part fits: b of 21 g is heavier"):
        pack([cube("b", mass=21)], (40, 40, 40), settings=settings)
    with pytest.raises(ArgumentError, match="need masses: part 'c' has no mass or density"):
        pack([cube("c")], (40, 40, 40), settings=settings)


def test_limits_of_boxes_that_there_are_not_are_an_error() -> None:
    settings = replace(QUICK, limits={"X": Limits(max_parts=1)})
    with pytest.raises(ArgumentError, match="there is no box 'X' for limits"):
        pack([cube("a")], (40, 40, 40), settings=settings)


def test_a_record_that_breaks_its_limits_is_not_valid(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
    settings = replace(QUICK, limits=Limits(max_mass=50, max_parts=4))
    pack([cube("a", count=6, mass=10)], (40, 40, 40), settings=settings, out=tmp_path)
    file = tmp_path / "packing.json"
    assert not verify_record(file).problems
    text = file.read_text()
    record = json.loads(text)
    for name, most, said in (
        ("max mass", 30, "box 1 holds 40 g: at most 30 g"),
        ("max parts", 3, "box 1 holds 4 parts: at most 3"),
    ):
        record = json.loads(text)
        record["request"]["boxes"][0][name] = most
        file.write_text(json.dumps(record))
        assert said in [each.sentence for each in verify_record(file).problems]


def test_texts_of_limits() -> None:
    found = read_limits(["20kg", "A:500g", "B:2 lb"], ["12", "A:3"])
    assert found == {
        "": Limits(20_000, 12),
        "A": Limits(500, 3),
        "B": Limits(907.18474),
    }
    for wrong in ("20", "kg", "-1kg", "1e3kg", "20 stones"):
        with pytest.raises(ArgumentError, match="is not a mass with a unit, such as 20kg"):
            grams(wrong)
    for masses, parts in ((["0g"], []), ([], ["0"]), ([], ["2.5"]), (["1g", "2g"], [])):
        with pytest.raises(ArgumentError):
            read_limits(masses, parts)


def test_nest_keeps_limits() -> None:
    mesh = creation.box((10, 10, 10))
    types = [ItemType(name, mesh.vertices, mesh.faces, demand=20) for name in "ab"]
    settings = NestSettings(workers=1, iterations=20, limits=[((3, 1), 10), ((1, 1), 7)])
    packing = nest(types, (41, 41, 41), "knapsack", settings=settings)
    kinds = [one.type for one in packing.placements]
    assert len(kinds) == 7 and 3 * kinds.count(0) + kinds.count(1) <= 10
    for wrong, limits in (("2 amounts for 1", [((3, 1), 10)]), ("-1", [((-1,), 10)])):
        with pytest.raises(ArgumentError, match=wrong):
            nest(types[:1], (41, 41, 41), "knapsack", settings=replace(settings, limits=limits))
    with pytest.raises(ArgumentError, match="limits are for the objective 'knapsack'"):
        nest(types, (41, 41, 41), "bins", settings=settings)


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_what_is_taken_out_and_added_keeps_limits(count: int) -> None:
    rng = np.random.default_rng(count)
    limits = ItemLimits(rng.random((2, count)), np.array([count / 8, count / 5]))
    values = rng.random(count)
    packed = np.ones(count, bool)
    packed[limits.excess(packed, values)] = False
    assert (limits.left(packed) >= 0).all()
    packed[limits.addable(packed, np.flatnonzero(~packed))] = True
    assert (limits.left(packed) >= 0).all()
    most = limits.most_value(values)
    assert values[packed].sum() <= most * (1 + 1e-9)
    order = np.argsort(-values / limits.costs(values, np.ones(count), 1e9))
    best = limits.addable(np.zeros(count, bool), order)
    assert values[best].sum() >= (0.9 if count > 10 else 0.5) * most


def test_items_that_go_make_room_for_others() -> None:
    limits = ItemLimits(np.array([[1.0, 2.0, 3.0]]), np.array([4.0]))
    left = limits.left(np.array([True, False, True]))
    assert left == pytest.approx([0.0], abs=1e-6)
    assert limits.allow(left, np.array([1]), np.array([2]))
    assert not limits.allow(left, np.array([1]), np.array([0]))
    assert not limits.allow(left, np.array([1]), np.array([], int))


def test_shelves_get_what_the_limits_allow() -> None:
    settings = replace(QUICK, limits=Limits(max_mass=50, max_parts=4))
    parts = [cube("light", count=9, mass=10), cube("heavy", count=9, mass=30)]
    task = prepared_task(parts, (40, 40, 40), "volume", settings)
    (box,) = task.boxes
    assert allowed(task, box, {0: 9, 1: 9}) == {0: 4}
    assert allowed(task, box, {0: 2, 1: 9}) == {0: 2, 1: 1}
    assert allowed(task, box, {1: 9}) == {1: 1}


def test_what_fills_a_box_exactly_may_be_in_it() -> None:
    task = prepared_task([cube("a", 20, count=8)], (40, 40, 40), "volume", QUICK)
    (box,) = task.boxes
    assert task.may_hold(box, [0])
    assert not task.may_hold(box, [0, 0])


def test_further_orders_of_construction_find_more_within_limits() -> None:
    rng = np.random.default_rng(1)
    types = [
        ItemType(f"block {n}", *_block(rng.uniform(8, 18, 3)), rotations="yaw-4") for n in range(16)
    ]
    grams = [each.volume * float(rng.uniform(0.5, 2)) for each in types]
    limits = [(grams, sum(grams) / 2)]
    found = []
    for again in (0, SearchSettings().constructed_again):
        search = SearchSettings(constructed_again=again)
        settings = NestSettings(workers=1, iterations=1, limits=limits, search=search)
        packing = nest(types, (34, 34, 34), "knapsack", settings=settings)
        assert packing.problems() == []
        found.append(sum(types[one.type].volume for one in packing.placements))
    assert found[1] > 1.02 * found[0]


def _block(sides: Floats) -> tuple[Floats, Ints]:
    mesh = creation.box(sides)
    return mesh.vertices, mesh.faces
