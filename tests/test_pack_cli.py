"""`packit pack` as a user runs it."""

import json
from pathlib import Path

import pytest
from trimesh import creation

from packit_sim.cli.options import read_seconds
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.results import instructions
from tests.runs import packit

QUICK = ("--workers", 1, "--iterations", 300)


@pytest.fixture(name="parts", scope="module")
def _parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("parts")
    creation.box((10, 10, 10)).export(folder / "cube.stl")
    creation.box((200, 10, 10)).export(folder / "long.stl")
    (folder / "broken.stl").write_text("nothing")
    return folder


def test_a_folder_is_packed_and_described(parts, tmp_path) -> None:
    arguments = (parts, f"{parts}/cube.stl=7", "--box", "2x2x2cm", "--clearance", "0mm", *QUICK)
    output = packit("pack", *arguments, "--out", tmp_path / "out")
    assert "8 of 9 parts" in output
    assert "20 x 1 x 1 cm is larger than the box of 2 x 2 x 2 cm" in output
    assert "broken.stl" in output and "no problems" in output
    files = {file.name for file in (tmp_path / "out").iterdir()}
    kinds = ("3mf", "glb", "stl", "png", "html", "json")
    assert files == {"meshes", *(f"packing.{kind}" for kind in kinds)}
    record = json.loads((tmp_path / "out" / "packing.json").read_text())
    assert record["unit"] == "cm" and len(record["items"]) == 8
    assert "8 of 9 parts" in (tmp_path / "out" / "packing.html").read_text()
    for named in (tmp_path / "out", tmp_path / "out" / "packing.json"):
        assert "0 problems" in packit("verify", named)


def test_a_box_without_a_unit_has_that_of_the_others(parts, tmp_path) -> None:
    boxes = ("--box", "A:300x200x150", "--box", "B:30x20x15cm")
    output = packit("pack", f"{parts}/cube.stl", *boxes, *QUICK, "--out", tmp_path)
    assert "note: boxes without a unit read as cm: A:300x200x150" in output
    record = json.loads((tmp_path / "packing.json").read_text())
    assert (record["unit"], record["box"]) == ("cm", [300, 200, 150])


@pytest.mark.parametrize(
    ("text", "seconds"), [("60", 60), ("60s", 60), ("1.5min", 90), ("1h", 3600), ("2m", 120)]
)
def test_times_have_units(text, seconds) -> None:
    assert read_seconds(text) == seconds


def test_times_that_are_not_possible_are_named() -> None:
    with pytest.raises(ArgumentError, match="'soon'"):
        read_seconds("soon")


def test_ctrl_c_before_the_first_packing_ends_the_command(parts, tmp_path, monkeypatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("packit_sim.pack", interrupted)
    with pytest.raises(AssertionError, match="stopped: repeat the command"):
        packit("pack", parts, "--box", "1x1x1", "--out", tmp_path / "out")


def test_instructions_are_written_when_asked_for(parts, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(instructions, "LARGE", (125, 90))
    monkeypatch.setattr(instructions, "SMALL", (105, 85))
    arguments = (f"{parts}/cube.stl=2", "--box", "25x12x12mm", *QUICK, "--out", tmp_path)
    assert "instructions.html" in packit("pack", *arguments, "--instructions")
    page = (tmp_path / "instructions.html").read_text(encoding="utf-8")
    assert "step 2 of 2" in page and "25 x 12 x 12 mm, 2 parts" in page
