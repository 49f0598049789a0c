"""Orders of the workbench, and parts that are moved by hand."""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from trimesh import creation

from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.results import exports
from packit_sim.parts.workbench.workbench import Workbench
from tests.workbench_client import is_done, post, send, state, wait


@pytest.fixture(name="bench")
def _bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Workbench]:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
    with Workbench() as bench:
        yield bench


def _file(number: int, count: int | str = 1, **more: Any) -> dict[str, Any]:
    return {"number": number, "count": count, "rotations": "fixed", **more}


def _order(*files: dict[str, Any], box: str = "20x20x10", **more: Any) -> dict[str, Any]:
    return {"box": [{"size": box}], "unit": "mm", "seconds": 0.1, "files": files, **more}


def _packed(bench: Workbench, order: dict[str, Any]) -> dict[str, Any]:
    assert post(bench, "/order", order)[1]["faults"] == {}
    assert post(bench, "/pack", order) == (200, {})
    found = wait(bench, lambda one: not one["busy"])
    assert is_done(found), found["message"]
    assert found["result"]["problems"] == []
    return found


def test_each_fault_has_the_name_of_its_field(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    good = _order(_file(number))
    assert post(bench, "/order", good)[1]["faults"] == {}
    two = [{"size": "20x20x10", "name": name} for name in "AB"]
    changes: tuple[tuple[dict[str, Any], str, str], ...] = (
        ({"box": [{"size": "20x20"}]}, "box", "300x200x150mm"),
        ({"box": [{"file": 99}]}, "box", "choose one that was sent"),
        ({"box": [{"size": "/etc/trunk.stl"}]}, "box", "send it to the page"),
        ({"box": [{"size": "/etc/boxes.csv"}]}, "box", "send it to the page"),
        ({"box": two, "objective": "height"}, "objective", "needs one box"),
        ({"objective": "value"}, "objective", "no part has a value"),
        ({"clearance": "-1"}, "clearance", "-1"),
        ({"clearance_z": "2"}, "clearance_z", "both above 0"),
        ({"wall_clearance": "sides=5,lid=2"}, "wall_clearance", "lid"),
        ({"wall_clearance": "12"}, "wall_clearance", "leave no space"),
        ({"stable": "soon"}, "stable", "soon"),
        ({"boxes": 0}, "boxes", "0"),
        ({"max_mass": ["20"]}, "max_mass", "20kg"),
        ({"max_mass": ["20kg"]}, "max_mass", "cube has no mass"),
        ({"max_parts": ["few"]}, "max_parts", "few"),
        ({"groups": ["kit"]}, "groups", "no part has a group"),
        ({"box": [{"size": "cylinder:20x10"}], "removable": True}, "removable", "a cylinder"),
        ({"max_tilt": "200"}, "max_tilt", "200"),
        ({"down": "z"}, "down", "choose from x-, x+"),
        ({"box": [{"size": "cylinder:20x10"}], "door": "x+"}, "door", "a cylinder"),
        ({"order": "delivery"}, "order", "cube has no stop"),
        ({"balance": ["60%"]}, "balance", "0.6"),
        ({"powder": "0.45"}, "powder", "0.45:20%"),
        ({"powder": "0.45:20%"}, "powder", "cube has no mass"),
        ({"even": True, "removable": True}, "even", "not possible with rules"),
        ({"files": [_file(number, fields={"stop": "soon"})]}, f"file {number}", "soon"),
        ({"files": [_file(number, fields={"mass": "heavy"})]}, f"file {number}", "heavy"),
        ({"files": [_file(number, 20_000)]}, f"file {number}", "10000"),
        ({"files": [_file(number, "max")], "objective": "boxes"}, "boxes", "how many boxes"),
        ({"unit": "ell"}, "unit", "ell"),
    )
    for change, field, sentence in changes:
        faults = post(bench, "/order", {**good, **change})[1]["faults"]
        assert list(faults) == [field] and sentence in faults[field], (change, faults)
    both = post(bench, "/order", {**good, "clearance": "-1", "stable": "soon"})[1]["faults"]
    assert sorted(both) == ["clearance", "stable"]
    assert post(bench, "/pack", {**good, "stable": "soon"})[0] == 400
    assert list(state(bench)["faults"]) == ["stable"]


def test_distances_limits_and_counts_are_those_of_the_command(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    walls = {"clearance": "1", "clearance_z": "2", "wall_clearance": "sides=1,floor=2,top=0"}
    found = _packed(bench, _order(_file(number, "max"), **walls, box="22x15x22"))
    (box,) = found["result"]["boxes"]
    low, high = np.array(box["low"]), np.array(box["high"])
    assert low.min(axis=0) == pytest.approx((1, 1, 2), abs=0.01) and high[:, 2].max() <= 22
    assert len(low) == 12  # 3 x 2 in each of two layers
    heavy = _file(number, 9, fields={"mass": "400"})
    found = _packed(bench, _order(heavy, max_mass=["1kg"]))
    assert found["result"]["summary"]["limits"] == "800 of 1000 g"
    found = _packed(bench, _order(_file(number, 9), max_parts=["3"]))
    assert found["result"]["summary"]["packed"] == "3 of 9 parts"


def test_several_boxes_hold_groups(bench) -> None:
    numbers = [send(bench, f"{name}.stl", creation.box((6, 6, 6))) for name in "ab"]
    files = [_file(n, 2, fields={"group": str(n)}) for n in numbers]
    boxes = [{"size": "13x7x7", "name": "A"}, {"size": "14x7x7", "name": "B", "count": 2}]
    found = _packed(bench, {**_order(*files, groups=["apart"], objective="boxes"), "box": boxes})
    assert sorted(sorted(box["parts"]) for box in found["result"]["boxes"]) == [
        ["a", "a"],
        ["b", "b"],
    ]
    assert {kind["name"]: kind["count"] for kind in found["result"]["kinds"]} == {"a": 2, "b": 2}


def test_parts_in_the_box_and_volumes_that_stay_free_are_shown_and_kept_clear_of(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    post_of = [creation.box(bounds=[(x, 0, 0), (x + 6, 6, 6)]) for x in (0, 7)]
    fixed, free = (
        send(bench, f"{n}.stl", m) for n, m in zip(("post", "free"), post_of, strict=True)
    )
    files = (_file(number, 2), _file(fixed, use="fixed"), _file(free, use="keep_out"))
    order = _order(*files, box="20x6x6")
    preview = post(bench, "/order", order)[1]
    assert preview["boxes"][0]["parts"] == ["cube"] * 2
    assert preview["boxes"][0]["others"] == ["post", "free"]
    found = _packed(bench, order)
    (box,) = found["result"]["boxes"]
    assert box["low"][0][0] > 13 - 1e-3 and box["others"] == ["post", "free"]
    assert len(found["result"]["models"]["boxes"][0]["items"]) == 3


def test_containers_are_cylinders_meshes_and_named_ones(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    trunk = send(bench, "trunk.stl", creation.box((14, 7, 7)))
    found = _packed(bench, _order(_file(number, 5), box="cylinder:10x14"))
    assert found["result"]["summary"]["packed"] == "2 of 5 parts"
    in_mesh = {**_order(_file(number, 5), _file(trunk)), "box": [{"file": trunk}]}
    found = _packed(bench, in_mesh)
    assert found["result"]["summary"]["packed"] == "2 of 5 parts"
    assert found["result"]["boxes"][0]["name"] == "trunk"
    named = post(bench, "/order", _order(_file(number), box="prusa-mk4"))[1]
    assert named["faults"] == {} and named["boxes"][0]["sides"][2] > 100


def test_rules_hold_for_all_parts(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    rules = {"removable": True, "insertable": True, "separable": True}
    found = _packed(bench, _order(_file(number, 2), **rules))
    assert found["result"]["summary"]["packed"] == "2 of 2 parts"


def test_turning_doors_deliveries_and_balance_are_those_of_the_command(bench) -> None:
    bar = send(bench, "bar.stl", creation.box((6, 6, 18)))
    turned = {"number": bar, "count": 1, "rotations": "cube"}
    order = _order(turned, box="20x20x20", max_tilt="15deg", order="delivery", door="x+")
    order["files"][0]["fields"] = {"stop": "1", "mass": "5"}
    found = _packed(bench, {**order, "balance": ["5%"], "insertable": True})
    (box,) = found["result"]["boxes"]
    low, high = np.array(box["low"][0]), np.array(box["high"][0])
    assert high - low == pytest.approx((6, 6, 18), abs=1e-3)  # upright
    assert (low + high)[:2] / 2 == pytest.approx((10, 10), abs=1)
    fallen = {**turned, "fields": {"max_tilt": "", "down": "x-,x+"}}
    found = _packed(bench, _order(fallen, box="20x20x20", down="z-"))
    (box,) = found["result"]["boxes"]
    assert np.ptp([box["low"][0], box["high"][0]], axis=0)[2] == pytest.approx(6, abs=1e-3)


def test_powder_is_counted_and_layers_are_evened(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    cube = _file(number, 2, fields={"density": "1"})
    found = _packed(bench, _order(cube, box="9x9x30", powder="0.45:20%", even=True))
    assert "fresh at 20%" in found["result"]["summary"]["powder"]


def test_a_moved_part_is_checked_and_accepted_only_where_it_is_free(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    long = send(bench, "rod.stl", creation.box((8, 2, 2)))
    order = _order(_file(number), _file(long, rotations="cube"), box="30x20x10")
    found = _packed(bench, order)
    key, (box,) = found["packing"], found["result"]["boxes"]
    cube, rod = box["parts"].index("cube"), box["parts"].index("rod")

    def moves(part: int, goal: tuple[float, ...], turns: int = 0) -> dict[str, Any]:
        shift = [to - at for to, at in zip(goal, box["low"][part], strict=True)]
        return {"packing": key, "moves": [{"part": part, "shift": shift, "turns": turns}]}

    status, answer = post(bench, "/moves", moves(rod, (20, 10, 5)))
    assert (status, answer) == (200, {"conflicts": []})
    onto = moves(rod, tuple(box["low"][cube]))
    (conflict,) = post(bench, "/moves", onto)[1]["conflicts"]
    assert sorted(conflict["parts"]) == sorted((cube, rod)) and "cube" in conflict["text"]
    outside = post(bench, "/moves", moves(rod, (25, 10, 5)))[1]["conflicts"]
    assert outside[0]["parts"] == [rod]
    assert re.search(r"reaches [\d.]+ mm beyond", outside[0]["text"])
    turned = post(bench, "/moves", moves(cube, (20, 10, 0), turns=1))[1]["conflicts"]
    assert turned[0]["text"] == "cube: it may not be turned like this"

    assert post(bench, "/moves", {**onto, "accept": True})[0] == 200
    refused = wait(bench, lambda one: not one["busy"])
    assert refused["message"].startswith("error:") and refused["packing"] == key
    assert refused["result"]["downloads"] == found["result"]["downloads"]

    assert post(bench, "/moves", {**moves(rod, (20, 10, 0)), "accept": True})[0] == 200
    moved = wait(bench, lambda one: not one["busy"])
    assert moved["message"] == "done: 1 part moved and locked"
    assert moved["result"]["downloads"] == [] and moved["undo"]
    (own,) = moved["result"]["boxes"]
    part = own["parts"].index("rod")
    assert moved["locked"] == [part] and own["low"][part] == pytest.approx((20, 10, 0))
    assert post(bench, "/moves", onto)[0] == 400  # of the packing before
    assert post(bench, "/write", {})[0] == 200
    assert wait(bench, is_done)["result"]["problems"] == []
    (folder,) = bench.folder.glob("packing-*")
    assert verify_packing(folder / "packing.json").problems == ()
    again = _packed(bench, order)
    (own,) = again["result"]["boxes"]
    assert own["low"][own["parts"].index("rod")] == pytest.approx((20, 10, 0))


def test_moves_that_are_not_possible_get_one_sentence(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    one = {"part": 0, "shift": [0, 0, 0]}
    assert post(bench, "/moves", {"packing": "1:None", "moves": [one]})[0] == 400
    key = _packed(bench, _order(_file(number)))["packing"]
    for moves, sentence in (
        ({"moves": [one, one]}, "no such parts"),
        ({"moves": [{**one, "part": 1}]}, "no such parts"),
        ({"moves": [one], "box": 3}, "no such parts"),
        ({"moves": []}, "no such parts"),
        ({"moves": [{**one, "shift": [1e300, 0, 0]}]}, "shift"),
        ({"moves": [{**one, "turns": 4}]}, "turns"),
        ({"moves": [one] * 501}, "length <= 500"),
    ):
        status, answer = post(bench, "/moves", {"packing": key, **moves})
        assert status == 400 and sentence in answer["error"], answer


def test_a_moved_part_that_breaks_a_rule_is_refused(bench) -> None:
    number = send(bench, "cube.stl", creation.box((6, 6, 6)))
    plate = send(bench, "plate.stl", creation.box((6, 6, 2)))
    files = (_file(number), _file(plate, fields={"no_stack": "yes"}))
    found = _packed(bench, _order(*files, box="20x20x9"))
    (box,) = found["result"]["boxes"]
    cube, base = (box["parts"].index(name) for name in ("cube", "plate"))
    goal = np.add(box["low"][base], (0, 0, 2))
    shift = (goal - box["low"][cube]).tolist()
    body = {"packing": found["packing"], "moves": [{"part": cube, "shift": shift}]}
    assert post(bench, "/moves", body)[1]["conflicts"] == []
    assert post(bench, "/moves", {**body, "accept": True})[0] == 200
    refused = wait(bench, lambda one: not one["busy"])
    assert refused["message"].startswith("error:") and refused["packing"] == found["packing"]
