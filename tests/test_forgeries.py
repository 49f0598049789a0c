"""The campaign of forged records: its judge finds what is wrong, and its page has its results."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaigns.common import read_results, table_in_page
from campaigns.forgeries import __main__ as command
from campaigns.forgeries import trials
from campaigns.forgeries.bodies import read_obj
from campaigns.forgeries.cases import Case, cases
from campaigns.forgeries.judge import Judge
from campaigns.forgeries.table import NAME, counted, table
from campaigns.forgeries.trials import KINDS, tried
from packit_sim.core.check_reports import FileProblem, Report
from packit_sim.core.errors import PackItError
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.results import request, resuming, verification


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> list[Case]:
    return cases(tmp_path_factory.mktemp("cases"))


def test_the_judge_finds_right_records_right(right: list[Case]) -> None:
    for case in right:
        judge = Judge(case.folder, case.record)
        assert judge.verdict(json.dumps(case.record).encode()) == ("right", "")


WRONG: dict[str, Callable[[Any], object]] = {
    "half the size": lambda r: r["items"][0]["pose"].__setitem__(0, [0.5, 0, 0, 22]),
    "in a wall": lambda r: r["items"][0]["pose"][0].__setitem__(3, 21.99),
    "too close": lambda r: r["items"][1]["pose"][0].__setitem__(3, 62.99),
    "in a keep-out": lambda r: r["items"][0]["pose"][2].__setitem__(3, 40.0),
    "a digest": lambda r: r["request"]["parts"][0].update(sha256="0" * 64),
    "a digest of an export": lambda r: r["files"].update({"packing.png": "0" * 64}),
    "one more": lambda r: r["items"].append(r["items"][0]),
    "one less": lambda r: r["items"].pop(),
    "a larger box": lambda r: r.update(boxes=[[200, 100, 60]]),
    "another box": lambda r: r["request"]["boxes"][0].update(size=[200, 100, 60]),
    "no clearance": lambda r: r.update(clearance=0),
    "a density": lambda r: r["summary"].update(density="0.999"),
    "a centre": lambda r: r["summary"].update({"centre of gravity": "(50, 50, 50) mm, by mass"}),
    "a mass": lambda r: r["parts"][0].update(mass=1.0),
    "no name": lambda r: r["items"][0].update(name="x"),
    "fixed": lambda r: r["request"]["parts"][0].update(rotations="fixed"),
    "a field": lambda r: r.pop("left out"),
}


DELIVERED: dict[str, tuple[int, Callable[[Any], object]]] = {
    "another door": (3, lambda r: (r["request"].update(door="y-"), r["summary"].update(door="y-"))),
    "a door that is none": (3, lambda r: r["request"].update(door="z-")),
    "an order that is none": (3, lambda r: r["request"].update(order="size")),
    "no word on insertion": (3, lambda r: r["request"].pop("insertable")),
    "the last one first": (3, lambda r: r["items"].reverse()),
    "other deliveries": (3, lambda r: r["summary"].update(deliveries="stop 1: 6")),
    "groups together in two boxes": (4, lambda r: r["items"][0].update(box=1)),
    "a rule that is none": (4, lambda r: r["request"].update(groups=["alone"])),
    "less powder": (4, lambda r: r["request"]["powder"].update(density=0.4)),
    "no fresh powder": (4, lambda r: r["request"]["powder"].update(refresh=0)),
    "another mass in a box": (
        4,
        lambda r: r["summary"].update(limits=r["summary"]["limits"].replace("18 of", "19 of")),
    ),
}
"""Changes of doors, stops, groups, limits and powder: the judge and the product refuse them."""


@pytest.mark.parametrize("what", DELIVERED)
def test_the_judge_and_the_product_find_wrong_deliveries_and_limits(
    what: str, right: list[Case]
) -> None:
    number, change = DELIVERED[what]
    case = right[number]
    record = json.loads(json.dumps(case.record))
    change(record)
    data = json.dumps(record).encode()
    assert Judge(case.folder, case.record).verdict(data).state == "wrong"
    file = case.folder / "changed.json"
    file.write_bytes(data)
    try:
        problems = [str(one) for one in verification.verify_record(file).problems]
    except PackItError as error:
        problems = [str(error)]
    file.unlink()
    assert problems


@pytest.mark.parametrize("what", WRONG)
def test_the_judge_finds_what_is_wrong(what: str, right: list[Case]) -> None:
    record = json.loads(json.dumps(right[0].record))
    WRONG[what](record)
    judge = Judge(right[0].folder, right[0].record)
    assert judge.verdict(json.dumps(record).encode()).state == "wrong"


_MATRIX = np.eye(4).tolist()

UNREAD: dict[str, tuple[int, str, int, str, Any]] = {
    "a mass that is a list": (2, "fixed", 0, "mass", [{"count": 1, "size": [10.0, 6.0, 4.0]}]),
    "a mass in brackets": (0, "keep out", 0, "mass", [[[[]]]]),
    "a mass that is true": (1, "parts", 0, "mass", True),
    "a density that is a matrix": (2, "fixed", 0, "density", _MATRIX),
    "a density that is an object": (2, "parts", 1, "density", {"a": {"a": {}}}),
    "a scale that is a list": (0, "parts", 2, "scale", [1.0, 0.0, 0.0, 0.0]),
    "a scale that is a text": (0, "parts", 2, "scale", "76608 mm³"),
    "a scale of 0": (0, "parts", 2, "scale", 0),
    "a value that is too large": (2, "fixed", 0, "value", 2**63),
    "a value that is a text": (2, "fixed", 0, "value", "😀"),
    "a priority that is a list": (2, "fixed", 0, "priority", []),
    "a priority with a fraction": (0, "parts", 2, "priority", -0.0),
    "a large number for no stack": (0, "keep out", 0, "no stack", 2**63 - 1),
    "a zero for no stack": (2, "fixed", 0, "no stack", -0.0),
    "no deviation": (2, "fixed", 0, "deviation", None),
    "a deviation that is a text": (0, "keep out", 0, "deviation", "'"),
    "a load that is a text": (2, "fixed", 0, "max load", "杯"),
    "an axis that is a number": (0, "parts", 2, "up", 2),
    "a mesh without a name": (0, "parts", 2, "mesh", ""),
    "a form that is none": (0, "boxes", 0, "form", ""),
    "another form": (0, "boxes", 0, "form", "cylinder"),
    "an outline that is none": (0, "boxes", 0, "outline", []),
    "more boxes than possible": (0, "boxes", 0, "count", 65536),
    "as many as fit that is a text": (0, "parts", 0, "as many as fit", "yes"),
    "as many as fit that nobody said": (0, "parts", 0, "as many as fit", True),
    "a limit on the mass that is a list": (0, "boxes", 0, "max mass", [20.0]),
    "a limit on the mass that is broken": (0, "boxes", 0, "max mass", 1e-3),
    "a limit on parts that is not kept": (0, "boxes", 0, "max parts", 1),
    "a limit on parts that nobody said": (0, "boxes", 0, "max parts", 10_000),
    "a balance that is a text": (0, "boxes", 0, "balance", "10%"),
    "a balance that is not kept": (0, "boxes", 0, "balance", 0.01),
    "a balance that nobody said": (0, "boxes", 0, "balance", 0.5),
    "a clearance that is a text": (0, "parts", 0, "clearance", "1mm"),
    "a clearance that nobody said": (0, "parts", 0, "clearance", 1.0),
    "a stop that comes too late": (3, "parts", 0, "stop", 4),
    "a part without a stop": (3, "parts", 1, "stop", None),
    "a stop that is true": (3, "parts", 0, "stop", True),
    "a tilt that is not allowed": (3, "parts", 0, "max tilt", 181),
    "a side that is not down": (3, "parts", 2, "down", ["z+"]),
    "a group in two boxes": (4, "parts", 1, "group", "A"),
    "a kit that is not whole": (4, "parts", 0, "count", 4),
    "a mass above the limit": (4, "boxes", 0, "max mass", 35.9),
    "parts above the limit": (4, "boxes", 0, "max parts", 4),
    "out of balance": (4, "boxes", 0, "balance", 0.005),
}
"""Fields that a judge could leave unread: it and the product refuse these values."""


@pytest.mark.parametrize("what", UNREAD)
def test_the_judge_reads_every_field_of_the_request(what: str, right: list[Case]) -> None:
    record = _changed(right, what)
    case = right[UNREAD[what][0]]
    assert Judge(case.folder, case.record).verdict(json.dumps(record).encode()).state == "wrong"


@pytest.mark.slow
@pytest.mark.parametrize("what", UNREAD)
def test_what_the_judge_refuses_is_not_valid(what: str, right: list[Case]) -> None:
    number, _, _, field, _ = UNREAD[what]
    file = right[number].folder / "changed.json"
    file.write_text(json.dumps(_changed(right, what)))
    try:
        assert verification.verify_record(file).problems
    except PackItError as error:
        assert field in str(error)  # noqa: PT017
    file.unlink()


def _changed(right: list[Case], what: str) -> dict[str, Any]:
    number, group, place, field, value = UNREAD[what]
    record: dict[str, Any] = json.loads(json.dumps(right[number].record))
    record["request"][group][place][field] = value
    return record


def test_the_judge_refuses_a_name_that_is_too_long(right: list[Case]) -> None:
    record = json.loads(json.dumps(right[0].record))
    record["request"]["parts"][0]["mesh"] = "a" * 5000 + ".obj"
    judge = Judge(right[0].folder, right[0].record)
    assert judge.verdict(json.dumps(record).encode()) == ("wrong", "no mesh")


def test_the_judge_knows_records_of_earlier_versions(right: list[Case]) -> None:
    record = json.loads(json.dumps(right[0].record))
    del record["request"]["separable"]
    judge = Judge(right[0].folder, right[0].record)
    assert judge.verdict(json.dumps(record).encode()) == ("right", "")


def test_the_judge_names_exports_that_are_missing(right: list[Case]) -> None:
    record = json.loads(json.dumps(right[0].record))
    record["files"]["packing.stl"] = "0" * 64
    judge = Judge(right[0].folder, right[0].record)
    assert judge.verdict(json.dumps(record).encode()) == ("absent", "packing.stl")


def test_bodies_are_measured(right: list[Case]) -> None:
    mesh = right[1].record["items"][0]["mesh"]
    cube = read_obj((right[1].folder / mesh).read_text())
    assert cube.volume == pytest.approx(1000) and cube.centre == pytest.approx([0, 0, 0])
    turn = np.eye(4)
    turn[:2, :2] = np.sqrt(0.5) * np.array([[1, -1], [1, 1]])
    turn[:3, 3] = (20, 0, 3)
    other = cube.moved(turn)
    assert cube.gap(other) == pytest.approx(15 - 5 * np.sqrt(2))
    assert cube.distance(other) == pytest.approx(15 - 5 * np.sqrt(2))
    turn[:3, 3] = (12, 0, 3)
    assert cube.gap(cube.moved(turn)) == pytest.approx(7 - 5 * np.sqrt(2))


def _valid(file: Path) -> Report:
    return Report((), 1, 1, 1, 1.0, 1.0)


def _refused(file: Path) -> Report:
    return Report((FileProblem(file, None, "no"),), 1, 1, 1, 1.0, 1.0)


def test_answers_that_are_always_the_same_are_found(
    right: list[Case], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trials, "verify_record", _valid)
    one = tried("items deleted", right, "0", tmp_path / "work")
    assert one.judged == "wrong" and one.faults[0].startswith("verified, but ")
    monkeypatch.setattr(trials, "verify_record", _refused)
    one = tried("nothing that matters", right, "0", tmp_path / "work")
    assert one.judged == "right" and one.faults[0].startswith("refused: ")


def _any_pose(task: Any, number: int, pose: Any, container: Any) -> Placement:
    return Placement.from_matrix(
        number, pose @ np.linalg.inv(task.parts[number].part.matrix(task.unit))
    )


def _nothing(*_: object) -> list[str]:
    return []


PLANTED: dict[str, tuple[str, str, Any, tuple[str, Any]]] = {
    "poses of any kind": ("a rotation", "resumed, but", resuming, ("_placement", _any_pose)),
    "overlaps": (
        "a part moved",
        "resumed, but",
        resuming,
        ("pair_problems", lambda *_: iter(())),
    ),
    "counts": ("left out", "verified, but", verification, ("_counts", _nothing)),
    "the summary": ("a line of the summary", "verified, but", verification, ("_summary", _nothing)),
    "masses": ("volumes and masses", "verified, but", verification, ("_masses", _nothing)),
    "boxes and settings": ("clearances", "verified, but", verification, ("_settings", _nothing)),
    "obstacles": ("obstacles", "verified, but", verification, ("_obstacles", _nothing)),
    "groups": ("groups", "verified, but", verification, ("_groups", _nothing)),
    "orders": (
        "door, stops and order",
        "verified, but",
        verification,
        ("order_faults", _nothing),
    ),
    "balances": (
        "limits of a box",
        "verified, but",
        verification,
        ("balance_fault", lambda *_: ""),
    ),
    "exports": ("an export", "verified, but", verification, ("_files", lambda *_: ([], []))),
    "links": (
        "links",
        "verified, but",
        request,
        ("file_inside", lambda folder, path: folder / path),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", PLANTED)
def test_a_planted_error_is_found(
    what: str, right: list[Case], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind, sentence, module, (name, other) = PLANTED[what]
    monkeypatch.setattr(module, name, other)
    if what == "links":
        monkeypatch.setattr("packit_sim.parts.packings.packing_files.file_inside", other)
    for seed in range(60):
        one = tried(kind, right, str(seed), tmp_path / "work")
        if any(each.startswith(sentence) for each in one.faults):
            return
    pytest.fail("nothing was found")


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_forgery_is_judged_as_the_product_does(
    kind: str, right: list[Case], tmp_path: Path
) -> None:
    assert tried(kind, right, "7", tmp_path / "work").faults == ()


def test_memory_changes_no_trial(right: list[Case], tmp_path: Path) -> None:
    numbers = range(1, len(KINDS), 4)
    alone = [tried(KINDS[n], right, f"3/{n}", tmp_path / "work") for n in numbers]
    assert trials.trials(numbers, 3) == alone


@pytest.mark.slow
def test_an_interrupted_run_is_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["forgeries", "--forgeries", "4", "--jobs", "1", "--out", str(tmp_path)]
    monkeypatch.setattr(command, "BATCH", 2)
    monkeypatch.setattr("sys.argv", given)
    command.main()
    whole = read_results(NAME, tmp_path)
    with monkeypatch.context() as stopped:
        stopped.setattr(command, "counted", _stop_at_the_second())
        with pytest.raises(KeyboardInterrupt):
            command.main()
    assert read_results(NAME, tmp_path)["tried"] == 2
    monkeypatch.setattr("sys.argv", [*given, "--resume"])
    command.main()
    assert read_results(NAME, tmp_path) == whole
    monkeypatch.setattr("sys.argv", [*given, "--seed", "1", "--resume"])
    with pytest.raises(SystemExit):
        command.main()
    assert "has no results of seed 1" in capsys.readouterr().err


def _stop_at_the_second() -> Callable[[Any], Any]:
    done = []

    def own(found: Any) -> Any:
        done.append(found)
        if len(done) == 2:
            raise KeyboardInterrupt
        return counted(found)

    return own


def test_the_page_has_the_results() -> None:
    results = read_results(NAME)
    assert set(results["kinds"]) <= set(KINDS) and results["wrong"] == []
    assert table_in_page(NAME) == table(results)
