"""`packit verify` compares the record of a packing with what was asked for."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trimesh import creation

from packit_sim.core.errors import PackFormatError
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.packings.instances import read_instance
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results.check import check
from packit_sim.parts.results.record import write_record
from packit_sim.parts.results.verification import REQUEST, verify_record
from tests.runs import run_packit

Record = dict[str, Any]

PLACES = ((0, (22, 17, 12)), (0, (63, 17, 12)), (1, (13, 46, 13)))

FREE = Part("free", creation.box(bounds=[(0, 0, 50), (10, 10, 60)]))


def packed(**settings: Any) -> PackedParts:
    """Two blocks of three and a ball, in a box with a volume that stays free."""
    parts = [
        Part("a", creation.box((40, 30, 20)), count=3, density=2.0),
        Part("b", creation.icosphere(2, 1.1), unit="cm"),
        Part("large", creation.box((200, 1, 1))),
    ]
    given: dict[str, Any] = {"clearance": 1.0, "wall_clearance": 2.0, "keep_out": [FREE]}
    box = BoxType((100, 100, 60))
    task = prepared_task(parts, [box], "volume", PackSettings(**{**given, **settings}))
    places = tuple(Placement(n, Motion.shift(place)) for n, place in PLACES)
    packing = Packing(task.types, task.container(box), places, task.gap, "knapsack")
    return PackedParts(task, (packing,))


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an honest packing, also with a smaller block among its meshes."""
    folder = tmp_path_factory.mktemp("honest")
    own = packed()
    write_record(own, check(own), folder, {})
    creation.box((4, 3, 2)).export(folder / "meshes" / "small.stl")
    return folder


def found(folder: Path, change: Callable[[Record], object]) -> list[str]:
    """Return the problems of a changed record."""
    record = json.loads((folder / "packing.json").read_text())
    change(record)
    file = folder / "forged.json"
    file.write_text(json.dumps(record))
    return [each.sentence for each in verify_record(file).problems]


def every(number: float) -> Callable[[Record], object]:
    """Return a change of the sizes of all parts, about their middles."""

    def change(record: Record) -> None:
        for item in record["items"]:
            pose = np.array(item["pose"])
            pose[:3, :3] *= number
            item["pose"] = pose.tolist()

    return change


def pose(number: int, row: int, column: int, value: float) -> Callable[[Record], object]:
    def change(record: Record) -> None:
        record["items"][number]["pose"][row][column] = value

    return change


def turned(record: Record) -> None:
    c, s = np.cos(0.1), np.sin(0.1)
    record["items"][0]["pose"] = [[c, -s, 0, 24], [s, c, 0, 22], [0, 0, 1, 12], [0, 0, 0, 1]]


def one_more(record: Record) -> None:
    item = json.loads(json.dumps(record["items"][1]))
    item["pose"][1][3] = 70
    record["items"] += [item] * 2
    record["left out"] = [each for each in record["left out"] if each["name"] != "a"]


def no_obstacle(record: Record) -> None:
    record["obstacles"] = []


FORGERIES: dict[str, tuple[Callable[[Record], object], str]] = {
    "all smaller": (every(0.5), "its size is 0.5 times the part's"),
    "turned": (turned, "its rotation is none of cube"),
    "too close to a wall": (pose(0, 0, 3, 21.0), "is 1 mm from the box's left wall: less than"),
    "too close to a part": (pose(1, 0, 3, 62.99), "0.99 mm from a"),
    "another mesh": (lambda r: r["items"][0].update(mesh="meshes/small.stl"), "the mesh of 'a' is"),
    "another mesh, also in the request": (
        lambda r: [
            each.update(mesh="meshes/small.stl") for each in (*r["items"], *r["request"]["parts"])
        ],
        "is another file than the one that was packed",
    ),
    "the name of another part": (lambda r: r["items"][2].update(name="a"), "the mesh of 'a' is"),
    "an unknown part": (lambda r: r["items"][0].update(name="c"), "the task has no such part"),
    "one part more": (one_more, "there are only 3"),
    "items deleted": (lambda r: r["items"].pop(), "0 of 'b' are packed and 0 left out"),
    "left out deleted": (lambda r: r.update({"left out": []}), "2 of 'a' are packed and 0 left"),
    "another left out": (
        lambda r: r["left out"].append({"name": "c", "count": 1, "reason": ""}),
        "'c' is left out, but was not asked for",
    ),
    "a larger box": (
        lambda r: r.update(box=[200] * 3, boxes=[[200] * 3]),
        "the boxes are not those that were asked for",
    ),
    "another first box": (lambda r: r.update(box=[200] * 3), "field 'box' is not the first"),
    "another name of the box": (lambda r: r.update({"box names": ["B"]}), "has no box 0"),
    "no clearance": (lambda r: r.update(clearance=0), "field 'clearance' is 0.0, but 1.0 was ask"),
    "no clearance of walls": (
        lambda r: r.update({"wall clearance": 0}),
        "field 'wall clearance' is 0.0, but 2.0 was asked for",
    ),
    "another unit": (lambda r: r.update(unit="cm"), "field 'unit' is 'cm'"),
    "another objective": (lambda r: r.update(objective="count"), "field 'objective' is 'count'"),
    "counts": (lambda r: r["parts"][0].update(count=2), "field 'parts' has other parts"),
    "no obstacle": (no_obstacle, "the obstacles are not those that were asked for"),
    "a moved obstacle": (
        lambda r: r["obstacles"][0]["pose"][0].__setitem__(3, 9),
        "the obstacles are not those that were asked for",
    ),
    "a volume": (lambda r: r["parts"][0].update(volume=1.0), "the volume of 'a' is said to be 1"),
    "a mass": (lambda r: r["parts"][0].update(mass=None), "the mass of 'a' is said to be None"),
    "a density": (lambda r: r["summary"].update(density="0.999"), "the summary's 'density' is"),
    "a count": (lambda r: r["summary"].update(packed="5 of 5 parts"), "the summary's 'packed' is"),
    "a line less": (lambda r: r["summary"].pop("height"), "the summary's 'height' is missing"),
    "a line more": (lambda r: r["summary"].update(grade="A"), "the summary's 'grade' is A"),
    "a constraint": (
        lambda r: r["request"]["parts"][0].update({"no stack": True, "rotations": "wrong"}),
        "rotations 'wrong' are not known",
    ),
}


@pytest.mark.parametrize("what", FORGERIES)
def test_what_was_not_asked_for_is_a_problem(what: str, honest: Path) -> None:
    change, sentence = FORGERIES[what]
    assert any(sentence in each for each in found(honest, change)), found(honest, change)


def test_a_right_record_has_no_problem_and_all_of_it_is_checked(honest: Path) -> None:
    report = verify_record(honest / "packing.json")
    assert report.is_valid and report.not_judged == ""
    assert found(honest, lambda record: record["summary"].update(check="not done")) == []


def test_constraints_are_checked_or_named(tmp_path: Path) -> None:
    own = packed(stable=3.0, removable=True)
    write_record(own, check(own), tmp_path, {})
    report = verify_record(tmp_path / "packing.json")
    assert report.is_valid
    assert report.not_judged == "not checked: that parts move by at most 3 mm"


def test_what_a_file_does_not_say_is_named_as_not_checked(honest: Path) -> None:
    assert found(honest, lambda record: record.pop("request")) == []
    result = run_packit("verify", honest / "forged.json")
    assert result.returncode == 0 and REQUEST in result.stdout.replace("\n", " ")
    with pytest.raises(PackFormatError, match=r"field 'request\.clearance' is missing"):
        found(honest, lambda record: record["request"].pop("clearance"))


def _exported(honest: Path, folder: Path, *names: str) -> Path:
    """Copy a packing, and add exports that its record lists."""
    shutil.copytree(honest, folder)
    record = json.loads((folder / "packing.json").read_text())
    for name in names:
        (folder / name).write_text(name)
        record["files"][name] = hashlib.sha256(name.encode()).hexdigest()
    (folder / "packing.json").write_text(json.dumps(record))
    return folder


def _changed(file: Path) -> None:
    file.write_text("changed")


def _linked(file: Path) -> None:
    file.unlink()
    file.symlink_to("/etc/hostname")


def _folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


def _dangling(file: Path) -> None:
    file.unlink()
    file.symlink_to("none")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (_changed, "'packing.png' is another file than was written, by its SHA-256"),
        (_folder, "'packing.png' is another file than was written, by its SHA-256"),
        (_dangling, "'packing.png' is another file than was written, by its SHA-256"),
        (_linked, "no path or link may lead out of it"),
    ],
)
def test_exports_have_the_recorded_digests(
    change: Callable[[Path], None], sentence: str, honest: Path, tmp_path: Path
) -> None:
    folder = _exported(honest, tmp_path / "packed", "packing.png", "packing.3mf")
    assert verify_record(folder / "packing.json").not_judged == ""
    change(folder / "packing.png")
    problems = verify_record(folder / "packing.json").problems
    assert len(problems) == 1 and sentence in problems[0].sentence


def test_exports_that_are_missing_or_not_recorded_are_named(honest: Path, tmp_path: Path) -> None:
    folder = _exported(honest, tmp_path / "packed", "packing.png")
    (folder / "packing.png").unlink()
    (folder / "packing-7.stl").touch()
    (folder / "notes.txt").touch()
    report = verify_record(folder / "packing.json")
    assert report.is_valid
    missing, more = "'packing.png' (missing)", "'packing-7.stl' (not recorded)"
    assert report.not_judged == f"not checked: {missing}, {more}"


@pytest.mark.parametrize("name", ["../secret", "/etc/hostname", "meshes/../../secret", ""])
def test_recorded_files_are_inside_the_folder(name: str, honest: Path) -> None:
    digest = hashlib.sha256(b"").hexdigest()
    problems = found(honest, lambda record: record["files"].update({name: digest}))
    assert len(problems) == 1 and "no path or link may lead out of it" in problems[0]


def test_the_recorded_digest_of_a_mesh_is_compared(honest: Path) -> None:
    def forged(record: Record) -> None:
        record["files"][record["items"][0]["mesh"]] = "0" * 64

    problems = found(honest, forged)
    assert len(problems) == 1 and "another file than was written" in problems[0]


LINKS = ("file", "nested", "meshes", "loop", "device")


@pytest.mark.parametrize("kind", LINKS)
def test_links_do_not_lead_out_of_the_folder(kind: str, honest: Path, tmp_path: Path) -> None:
    folder = tmp_path / "packed"
    shutil.copytree(honest, folder)
    secret = tmp_path / "secret"
    shutil.copytree(honest / "meshes", secret)
    meshes = folder / "meshes"
    record = json.loads((folder / "packing.json").read_text())
    mesh = folder / record["items"][0]["mesh"]
    if kind == "meshes":
        shutil.rmtree(meshes)
        meshes.symlink_to(secret)
    else:
        mesh.unlink()
    if kind == "file":
        mesh.symlink_to(secret / mesh.name)
    elif kind == "nested":
        (meshes / "x").symlink_to("..")
        (folder / "y").symlink_to(secret)
        mesh.symlink_to(Path("x/y") / mesh.name)
    elif kind == "loop":
        mesh.symlink_to(mesh.name)
    elif kind == "device":
        os.mkfifo(mesh)
    problems = found(folder, lambda record: None)
    assert problems and not any("secret" in each for each in problems)
    if kind not in ("loop", "device"):
        assert "no path or link may lead out of it" in problems[0]


def test_links_inside_the_folder_are_followed(honest: Path, tmp_path: Path) -> None:
    folder = tmp_path / "packed"
    shutil.copytree(honest, folder)
    (folder / "meshes").rename(folder / "m")
    (folder / "meshes").symlink_to("m")
    assert found(folder, lambda record: None) == []
    (tmp_path / "link").symlink_to(folder)
    assert found(tmp_path / "link", lambda record: None) == []


def test_paths_with_dots_are_refused(honest: Path) -> None:
    for mesh in ("meshes/a.obj/../../..", "../a.obj", "meshes/../../a.obj", "/etc/passwd"):
        with pytest.raises(PackFormatError, match="a path inside the packing's folder"):
            found(honest, lambda record, mesh=mesh: record["items"][0].update(mesh=mesh))


def test_meshes_of_instances_are_inside_their_folder_too(tmp_path: Path) -> None:
    creation.box((1, 1, 1)).export(tmp_path / "secret.stl")
    folder = tmp_path / "instance"
    folder.mkdir()
    (folder / "a.stl").symlink_to(tmp_path / "secret.stl")
    item = {"path": "a.stl", "demand": 1}
    text = {"container": {"size-x": 5, "size-y": 5}, "item-types": [item]}
    (folder / "instance.json").write_text(json.dumps(text))
    with pytest.raises(Exception, match="no path or link may lead out of it"):
        read_instance(folder / "instance.json")
