"""Parts, records and folders from strangers: refused with one error, or harmless."""

from __future__ import annotations

import http.client
import json
import os
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from trimesh import creation

from packit_sim.core.errors import ArgumentError, MeshError, PackFormatError, PackItError
from packit_sim.game.datasets.pack_files import read_packs
from packit_sim.geometry.motions import Motion
from packit_sim.libraries import mesh_files
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.raw_meshes import RawMesh
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.pack import pack
from packit_sim.parts.packings import validity
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.reading import files
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.units import lengths
from packit_sim.parts.results import exports
from packit_sim.parts.results.exports import export
from packit_sim.parts.results.resuming import read_earlier
from packit_sim.parts.workbench.workbench import Workbench

QUICK = PackSettings(workers=1, iterations=100)

Record = dict[str, Any]


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    creation.box((10, 10, 10)).export(tmp_path / "cube.stl")
    return tmp_path / "cube.stl"


def manifest(cube: Path, **fields: Any) -> Path:
    file = cube.with_name("parts.json")
    file.write_text(json.dumps([{"file": cube.name, **fields}]))
    return file


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"mass": 1e308}, "mass 1e[+]308 is not possible: 1e-09 to"),
        ({"mass": 5e-324}, "mass 5e-324 is not possible"),
        ({"density": 1e308}, "density 1e[+]308 is not possible"),
        ({"density": 1e-320}, "density 1e-320 is not possible"),
        ({"value": 1e308}, "value 1e[+]308 is not possible: 0 to"),
        ({"count": 10**400}, "parts.json: an integer of 401 digits is not possible"),
        ({"priority": -(10**400)}, "parts.json: an integer of 401 digits is not possible"),
        ({"count": 10**9}, "count 1000000000 is not possible: 1 to 10000"),
        ({"name": [[[[["x" * 5000]]]]]}, r"name \[\[\[.{,60}\]\]\] is not possible"),
    ],
)
def test_numbers_without_a_meaning_are_refused(cube: Path, fields: Record, problem: str) -> None:
    with pytest.raises(ArgumentError, match=problem):
        find_parts([manifest(cube, **fields)])


@pytest.mark.parametrize(
    "name", ["\ud800", "\x1b]0;x\x07", "n" * 5000, "é" * 200, "../../evil", "</script>", "", "\0"]
)
def test_any_name_can_be_packed_and_written(cube: Path, name: str, tmp_path: Path) -> None:
    packed = pack([manifest(cube, name=name)], "20x20x20mm", settings=QUICK)
    export(packed, tmp_path / "out" / "packed")
    assert verify_packing(tmp_path / "out" / "packed" / "packing.json").is_valid
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["packed"]
    page = (tmp_path / "out" / "packed" / "packing.html").read_text()
    assert "\x1b" not in page and page.count("<script") == page.count("</script>")


def test_a_file_whose_name_is_not_utf_8_is_packed(cube: Path, tmp_path: Path) -> None:
    strange = os.fsencode(tmp_path) + b"/\xff.stl"
    shutil.copy(os.fsencode(cube), strange)
    packed = pack([os.fsdecode(strange)], "20x20x20mm", settings=QUICK)
    export(packed, tmp_path / "packed")
    assert verify_packing(tmp_path / "packed" / "packing.json").is_valid


def test_a_file_that_is_named_often_is_read_once(
    cube: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = manifest(cube)
    file.write_text(json.dumps([{"file": cube.name}] * 50))
    read: list[Path] = []

    def count(file: Path, accuracy: float | None, keep: mesh_files.Keep) -> RawMesh:
        read.append(file)
        return mesh_files.read(file, accuracy, keep)

    monkeypatch.setattr(files, "read", count)
    parts = find_parts([file]).parts
    assert len(parts) == 50 and len(read) == 1 and all(one.mesh is parts[0].mesh for one in parts)


@pytest.mark.parametrize("unit", ["-1", "1e400", "nan", "1e-320"])
def test_a_file_with_an_impossible_unit_stops_no_other(cube: Path, unit: str) -> None:
    content = creation.box((1, 2, 3)).export(file_type="dae").decode()
    changed = content.replace("<asset>", f'<asset><unit name="x" meter="{unit}"/>')
    assert changed != content
    file = cube.with_name("unit.dae")
    file.write_text(changed)
    found = find_parts([file, cube])
    assert [part.name for part in found.parts] == ["cube"]
    assert "its unit of length is" in found.unread[0].reason


@pytest.mark.parametrize("text", ["1" * 20_000 + "!", "x".join(["11"] * 40) + "!"])
def test_lengths_are_refused_in_time_that_grows_with_the_text(text: str) -> None:
    with pytest.raises(ArgumentError, match="is not"):
        lengths(text, 3, "mm")
    with pytest.raises(ArgumentError, match="is not"):
        BoxType.parse(text, "mm")


def test_a_count_of_boxes_of_thousands_of_digits_is_refused() -> None:
    with pytest.raises(ArgumentError, match="is not possible"):
        BoxType.parse(f"1x1x1={'9' * 5000}", "mm")


@pytest.fixture(scope="module")
def packed() -> PackedParts:
    cube = Part("cube", creation.box((10, 10, 10)), count=3)
    return pack([cube], (20.0, 20.0, 20.0), settings=QUICK)


FORGED: dict[str, Callable[[Record], object]] = {
    "an infinite number of searches": lambda record: record.update(searches=float("inf")),
    "searches of 401 digits": lambda record: record.update(searches=10**400),
    "a negative number of searches": lambda record: record.update(searches=-1),
    "a coordinate of 401 digits": lambda record: record["items"][0]["pose"][0].append(10**400),
    "a box before the first": lambda record: record["items"][0].update(box=-1),
}


NO_RECORD = (
    "an infinite number of searches",
    "searches of 401 digits",
    "a coordinate of 401 digits",
)
"""Those that are not even JSON as it is written here."""


@pytest.mark.parametrize("what", FORGED)
def test_a_forged_record_is_not_resumed(what: str, packed: PackedParts, tmp_path: Path) -> None:
    export(packed, tmp_path)
    file = tmp_path / "packing.json"
    assert read_earlier(tmp_path, packed.task) is not None
    record = json.loads(file.read_text())
    FORGED[what](record)
    file.write_text(json.dumps(record))
    if what in NO_RECORD:
        with pytest.raises(ArgumentError, match="is not of `packit pack`"):
            read_earlier(tmp_path, packed.task)
    else:
        assert read_earlier(tmp_path, packed.task) is None


def test_the_problems_of_a_packing_have_an_end(
    packed: PackedParts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export(packed, tmp_path)
    file = tmp_path / "packing.json"
    record = json.loads(file.read_text())
    record["items"] = record["items"][:1] * 40  # 780 pairs
    file.write_text(json.dumps(record))
    assert len(verify_packing(file).problems) == 780
    monkeypatch.setattr(validity, "MAX_PROBLEMS", 100)
    problems = verify_packing(file).problems
    assert len(problems) == 101 and "there may be more" in str(problems[-1])


@pytest.mark.parametrize("device", ["/dev/zero", "pipe"])
def test_a_mesh_file_that_never_ends_is_refused(device: str, cube: Path, tmp_path: Path) -> None:
    endless = tmp_path / "endless.stl"
    endless.symlink_to(device) if device != "pipe" else os.mkfifo(endless)
    with pytest.raises(MeshError, match=r"endless\.stl: it is not a regular file"):
        mesh_files.read(endless)
    found = find_parts([endless, cube])
    assert [part.name for part in found.parts] == ["cube"] and len(found.unread) == 1


def test_links_to_devices_are_not_read_as_data(cube: Path, tmp_path: Path) -> None:
    readers: dict[str, Callable[[Path], object]] = {
        "packs.jsonl": read_packs,
        "parts.json": lambda file: find_parts([file]),
        "packing.json": verify_packing,
        "library.json": lambda file: ShapeLibrary.open(file.parent),
    }
    for name, read in readers.items():
        file = tmp_path / "folder" / name
        file.parent.mkdir(exist_ok=True)
        file.symlink_to("/dev/zero")
        with pytest.raises((PackFormatError, PackItError), match="not a regular file"):
            read(file)


@pytest.mark.parametrize("wxyz", [(1, 0, 1e308, 0), (0, 0, 0, 0), (2, 0, 0, 0)])
def test_a_rotation_is_a_unit_quaternion(wxyz: tuple[float, float, float, float]) -> None:
    with pytest.raises(ArgumentError, match="is no rotation: it must be 1"):
        Motion.from_wxyz(wxyz)


def test_the_workbench_answers_whatever_it_is_asked(cube: Path) -> None:
    data = cube.read_bytes()
    with Workbench() as bench:
        host = bench.address.removeprefix("http://")

        def ask(path: str, body: bytes) -> tuple[int, Record]:
            connection = http.client.HTTPConnection(host, timeout=60)
            connection.request("POST", path, body)
            answer = connection.getresponse()
            found = answer.status, json.loads(answer.read())
            connection.close()
            return found

        assert ask("/parts?name=%00%1b.stl", data) == (200, {"number": 1})
        status, answer = ask(f"/parts?name={'a' * 300}.stl", data)
        assert status == 422 and "a name has at most 200 bytes" in answer["error"]
        files = [{"number": 1, "count": 1, "rotations": "cube"}]
        order = {"box": [{"size": "9x9x9"}], "unit": "mm", "files": files * 501}
        status, answer = ask("/pack", json.dumps(order).encode())
        assert status == 400 and "expected array of length <= 500" in answer["error"]
        name, port = host.split(":")
        with socket.create_connection((name, int(port)), timeout=60) as raw:
            raw.sendall(f"GET http://[ HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
            assert raw.recv(100).startswith(b"HTTP/1.1 400 ")
