"""STEP: units, names, copies, the deviation of tessellations, and broken files."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from trimesh import creation

from packit_sim.core.errors import MeshError
from packit_sim.core.extras import MissingPackageError
from packit_sim.geometry.deviation import Surface
from packit_sim.geometry.deviation_kernels import farthest
from packit_sim.libraries import step_files as reader
from packit_sim.libraries.folder import MeshFolder
from packit_sim.libraries.importer import ImportSettings, import_library
from packit_sim.libraries.mesh_files import read, read_parts
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.pack import pack
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results import exports
from packit_sim.parts.results.check import check
from packit_sim.parts.results.reread_scenes import read_scene
from tests import step_files
from tests.step_files import Step

needs_cascadio = pytest.mark.skipif(
    importlib.util.find_spec("cascadio") is None, reason="without the extra cad"
)


def pin(folder: Path, radius: float = 50.0, height: float = 40.0, name: str = "pin.step") -> Path:
    step = Step()
    step.product("pin", [step.cylinder(radius, height)])
    (folder / name).write_text(step.text())
    return folder / name


@needs_cascadio
@pytest.mark.parametrize(("unit", "millimetres"), [("mm", 1.0), ("in", 25.4), ("m", 1000.0)])
def test_the_unit_of_the_file_counts(tmp_path: Path, unit: str, millimetres: float) -> None:
    (tmp_path / "box.STP").write_text(step_files.box((30, 20, 10), unit))
    raw = read(tmp_path / "box.STP")
    assert raw.mesh.extents == pytest.approx(np.array([30, 20, 10]) * millimetres)
    assert (raw.up, raw.unit_cm, raw.deviation, raw.mesh.is_watertight) == ("z", 0.1, 0.0, True)


@pytest.mark.slow
@needs_cascadio
def test_solids_of_an_assembly_have_their_names_and_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "top.step"
    file.write_text(step_files.assembly())
    reading = find_parts([file])
    found = {part.name: (part.count, part.unit) for part in reading.parts}
    assert set(found.values()) == {(4, "mm"), (1, "mm")}
    assert sorted(name.partition("_")[0] for name in found) == ["top/block", "top/pin"]
    assert not any("read as mm" in note for note in reading.notes)
    for part in reading.parts:  # the check finds the same solid, by itself
        again = read_scene(part, part.copy, ".step")
        assert again.bounds == pytest.approx(part.mesh.bounds, abs=0.05)
        assert len(again.faces) >= len(part.mesh.faces) and again.is_watertight


@needs_cascadio
@pytest.mark.parametrize("count", [10, 100, pytest.param(1000, marks=pytest.mark.slow)])
def test_many_occurrences_are_counted(tmp_path: Path, count: int) -> None:
    step = Step()
    top, block = step.product("top"), step.product("block", [step.box((3, 2, 1))])
    for n in range(count):
        step.place(block, top, (10 * n, 0, 0))
    (tmp_path / "top.step").write_text(step.text())
    assert [part.count for part in read_parts(tmp_path / "top.step")] == [count]


@needs_cascadio
def test_too_many_occurrences_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("packit_sim.libraries.mesh_limits.MAX_INSTANCES", 20)
    step = Step()
    top, block = step.product("top"), step.product("block", [step.box((3, 2, 1))])
    for n in range(21):
        step.place(block, top, (10 * n, 0, 0))
    (tmp_path / "top.step").write_text(step.text())
    with pytest.raises(MeshError, match="21 instances of objects are too many"):
        read(tmp_path / "top.step")


@needs_cascadio
def test_each_solid_of_a_product_is_a_part(tmp_path: Path) -> None:
    step = Step()
    step.product("Körper", [step.box((10, 10, 10)), step.cylinder(5, 30, (40, 0, 0))])
    step.product("Körper#2", [step.box((1, 2, 3))])
    file = tmp_path / "two.step"
    file.write_text(step.text())
    reading = find_parts([file])
    assert len(reading.parts) == 3 and len({part.name for part in reading.parts}) == 3
    assert "its 2 products have 3 solids: each is a part" in reading.notes[0]
    for part in reading.parts:
        assert part.name.startswith("two/Körper")
        again = read_scene(part, part.copy, ".step")
        assert again.bounds == pytest.approx(part.mesh.bounds, abs=0.1)
    assert read(file).parts == 3


@needs_cascadio
@pytest.mark.parametrize("accuracy", [None, 0.01, 0.5])
def test_no_point_of_the_surface_is_farther_than_the_deviation(
    tmp_path: Path, accuracy: float | None
) -> None:
    raw = read(pin(tmp_path), accuracy)
    angles = np.linspace(0, 2 * np.pi, 5000)
    around = np.column_stack([50 * np.cos(angles), 50 * np.sin(angles), np.full(5000, 20.0)])
    gap = farthest(around, Surface.of(raw.mesh), 0.0)
    limit = accuracy or 0.001 * np.linalg.norm([100, 100, 40])
    assert 0 < gap <= raw.deviation <= limit


@needs_cascadio
def test_the_deviation_is_part_of_the_promise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
    file = pin(tmp_path, 8, 20)
    settings = PackSettings(workers=1, iterations=20, accuracy=0.2, clearance=1.0)
    (part,) = prepared_task([file], "40x40x30mm", "volume", settings).parts
    assert 0 < part.deviation <= 0.2 and part.deviation == part.part.deviation
    assert "tessellated, at most" in str(part.simplification)
    task = prepared_task([file], "4x4x3cm", "volume", PackSettings(accuracy=0.02))
    assert 0 < task.parts[0].deviation <= 0.02
    packed = pack([f"{file}=4"], "40x40x30mm", settings=settings)
    found = check(packed)
    assert packed.count == 4 and found.problems == ()
    assert found.distance is not None and found.distance >= 1.0


@needs_cascadio
def test_flat_parts_fit_exactly(tmp_path: Path) -> None:
    (tmp_path / "plate.step").write_text(step_files.box((20, 20, 5)))
    settings = PackSettings(workers=1, iterations=50)
    packed = pack([f"{tmp_path}/plate.step=6"], "60x40x5mm", settings=settings)
    assert packed.count == 6 and check(packed).problems == ()


BROKEN = {
    "empty": ("", "the file is empty"),
    "words": ("once upon a time", "it is no valid STEP file"),
    "no data": (
        "ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n",
        "it is no valid STEP file",
    ),
    "cut": (step_files.box((1, 2, 3))[:3000], "it is no valid STEP file: unexpected"),
    "no shape": (Step().text(), "finds no shape"),
    "dangling": (step_files.box((1, 2, 3)).replace("PLANE('',#", "PLANE('',#9"), "no valid STEP"),
    "no shell": (
        step_files.box((1, 2, 3)).replace("CLOSED_SHELL(", "CLOSED_SHEL("),
        "holds no triangles",
    ),
}


@needs_cascadio
def test_broken_files_are_named_and_stop_no_other(tmp_path: Path) -> None:
    """All in one folder: each file is read by its own process."""
    for kind, (content, _) in BROKEN.items():
        (tmp_path / f"{kind}.step").write_text(content)
    (tmp_path / "good.step").write_text(step_files.box((3, 2, 1)))
    reading = find_parts([tmp_path])
    assert [part.name for part in reading.parts] == ["good"]
    reasons = {Path(unread.source).stem: unread.reason for unread in reading.unread}
    assert reasons.keys() == BROKEN.keys()
    for kind, (_, problem) in BROKEN.items():
        assert problem in reasons[kind]
    with pytest.raises(MeshError, match=r"words\.step: it is no valid STEP file"):
        read(tmp_path / "words.step")


@needs_cascadio
def test_a_crash_and_a_limit_are_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = pin(tmp_path)
    monkeypatch.setattr(reader, "_RUN", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(MeshError, match=r"pin\.step: OpenCASCADE crashes on it \(signal 11\)"):
        read(file)
    monkeypatch.setattr(reader, "_RUN", "import time; time.sleep(60)")
    monkeypatch.setattr(reader, "SECONDS", 0.1)
    with pytest.raises(MeshError, match=r"pin\.step: OpenCASCADE took more than"):
        read(file)


@pytest.mark.slow
@needs_cascadio
def test_a_folder_of_step_files_is_imported(tmp_path: Path) -> None:
    """The processes of an import have limits that their children can't raise."""
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "box.step").write_text(step_files.box((3, 2, 1)))
    source = MeshFolder(tmp_path / "in")
    candidates = [source.candidate(id) for id in source.categories]
    settings = ImportSettings(workers=1)
    (outcome,) = import_library(candidates, tmp_path / "out", "mine", "", settings)
    assert outcome.problem is None and outcome.info is not None


def test_without_the_extra_the_error_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        MissingPackageError,
        match=r"STEP files need cascadio.*packit-sim\[cad\].*or export as 3MF or STL",
    ):
        read(pin(tmp_path))


def test_without_the_extra_the_other_files_of_a_folder_are_packed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    pin(tmp_path)
    creation.box().export(tmp_path / "good.stl")
    reading = find_parts([tmp_path])
    assert [part.name for part in reading.parts] == ["good"]
    assert "pip install 'packit-sim[cad]'" in reading.unread[0].reason


def test_a_part_has_a_deviation_that_is_possible() -> None:
    with pytest.raises(ValueError, match="deviation -1 is not possible"):
        Part("a", creation.box(), deviation=-1)
