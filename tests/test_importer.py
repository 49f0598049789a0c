"""Import: meshes from any source become a stored library, or are reported."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim.core.choices import SPLITS
from packit_sim.core.errors import LibraryError
from packit_sim.core.memory import limit_memory
from packit_sim.geometry.repair import Repairs
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.simplification import Simplification
from packit_sim.libraries import importer
from packit_sim.libraries.importer import ImportOutcome, ImportSettings, import_library
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.raw_meshes import RawMesh
from packit_sim.libraries.sources import Candidate
from tests import bad_meshes
from tests.runs import PoolOfNone
from tests.runs import run_packit as packit

MEASURED = """
import resource, subprocess, sys
subprocess.run([sys.executable, "-m", "packit_sim", *sys.argv[1:]], check=True)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""

BALL = creation.icosphere(subdivisions=5)
QUICK = ImportSettings(workers=1)


def candidate(id: str, mesh: trimesh.Trimesh, **known: object) -> Candidate:
    return Candidate(id, id.partition("/")[0], partial(RawMesh, mesh), source=f"{id}.stl", **known)


@dataclass(frozen=True)
class Trouble:
    """Reads nothing, and does harm instead."""

    kind: str

    def __call__(self) -> RawMesh:
        if self.kind == "sleep":
            time.sleep(600)
        if self.kind == "memory":
            np.ones(2**34)
        if self.kind == "crash":
            os.kill(os.getpid(), signal.SIGKILL)
        raise RuntimeError("what no one thought of")


@pytest.mark.usefixtures("in_this_process")
def test_an_import_is_a_library_with_a_report(tmp_path: Path) -> None:
    block = creation.box((1, 2, 3))
    flipped = trimesh.Trimesh(
        block.vertices, np.concatenate([block.faces[:2, ::-1], block.faces[2:]]), process=False
    )
    sheet = trimesh.Trimesh(block.vertices, block.faces[:1], process=False)
    seen: list[ImportOutcome] = []
    outcomes = import_library(
        [
            candidate("ball/large", BALL),
            candidate("box/ein würfel", flipped, title="A box"),
            candidate("flat/sheet", sheet),
        ],
        tmp_path / "lib",
        "mine",
        "7",
        replace(QUICK, unit_cm=2.54),
        done=seen.append,
    )
    assert [outcome.id for outcome in outcomes] == ["ball/large", "box/ein-würfel", "flat/sheet"]
    assert [outcome.name for outcome in seen] == ["ball/large", "box/ein würfel", "flat/sheet"]
    assert "no extent along" in (outcomes[2].problem or "") and outcomes[2].info is None
    assert outcomes[1].repairs == Repairs(flipped_triangles=2)
    assert outcomes[0].triangles_read == 20480

    library = ShapeLibrary.open(tmp_path / "lib")
    assert (library.name, library.version) == ("mine", "7")
    assert library.ids == ("ball/large", "box/ein-würfel")
    ball, box = map(library.info, library)
    assert ball == outcomes[0].info and box == outcomes[1].info
    assert ball.triangles <= 4000 and 1e-4 < ball.error_bound <= 0.005 and ball.watertight
    assert box.solid and box.error_bound < 1e-4 and box.title == "A box"
    assert box.size_cm == pytest.approx((2.54, 5.08, 7.62), rel=1e-3)
    assert library["box/ein-würfel"].volume == pytest.approx(6 / 14**1.5, rel=1e-4)
    assert sorted(id for split in SPLITS for id in library.split(split)) == list(library)


def test_a_limit_of_the_shell_is_not_raised() -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (2**40, 2**40))
        limit_memory(2**50)
        assert resource.getrlimit(resource.RLIMIT_AS) == (2**40, 2**40)

    process = multiprocessing.get_context("fork").Process(target=limit)
    process.start()
    process.join()
    assert process.exitcode == 0


@pytest.mark.usefixtures("in_this_process")
def test_no_library_is_stored_before_its_report(tmp_path: Path) -> None:
    def stop(outcomes: list[ImportOutcome]) -> None:
        raise KeyboardInterrupt(outcomes[0].info)

    with pytest.raises(KeyboardInterrupt, match="ball"):
        import_library(
            [candidate("ball", creation.box())], tmp_path / "lib", "mine", "", QUICK, report=stop
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_error_bound_is_valid(tmp_path: Path) -> None:
    outcomes = import_library([candidate("ball", BALL)], tmp_path / "lib", "mine", "", QUICK)
    info = outcomes[0].info
    assert info is not None
    kept = ShapeLibrary.open(tmp_path / "lib")["ball"].mesh
    source = Shape.from_mesh(BALL, "ball").mesh
    for one, other in ((source, kept), (kept, source)):
        points = trimesh.sample.sample_surface(one, 100, seed=0)[0]
        triangles = np.tile(other.triangles, (len(points), 1, 1))
        nearest = trimesh.triangles.closest_point(triangles, points.repeat(len(other.faces), 0))
        gaps = np.linalg.norm(nearest - points.repeat(len(other.faces), 0), axis=1)
        assert gaps.reshape(len(points), -1).min(axis=1).max() <= info.error_bound


@pytest.mark.slow
def test_an_import_is_the_same_to_the_bit_in_one_process_and_in_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    candidates = [
        candidate(f"thing/{n}", creation.icosphere(subdivisions=3).apply_scale((1, 1, n + 1)))
        for n in range(3)
    ]
    settings = replace(QUICK, simplification=Simplification(max_triangles=500))
    import_library(candidates, tmp_path / "two", "mine", "", replace(settings, workers=2))
    monkeypatch.setattr(importer, "ProcessPool", PoolOfNone)
    import_library(candidates, tmp_path / "one", "mine", "", settings)
    files = [f.relative_to(tmp_path / "one") for f in (tmp_path / "one").rglob("*") if f.is_file()]
    assert len(files) == 5
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("in_this_process")
def test_the_same_object_is_one_group_and_in_one_split(tmp_path: Path) -> None:
    ball, turned = creation.capsule(2, 1), creation.capsule(2, 1)
    turned.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    others = [candidate(f"box/{n}", creation.box((1, 1 + n, 9))) for n in range(3)]
    import_library(
        [candidate("pill/one", ball), *others, candidate("pill/other", turned)],
        tmp_path / "lib",
        "mine",
        "",
        QUICK,
    )
    library = ShapeLibrary.open(tmp_path / "lib")
    assert library.info("pill/one").group == library.info("pill/other").group == "pill/one"
    holding = [split for split in SPLITS if "pill/one" in library.split(split)]
    assert holding == [split for split in SPLITS if "pill/other" in library.split(split)]
    assert len({info.group for info in map(library.info, library)}) == 4


@pytest.mark.slow
def test_too_costly_meshes_are_refused_and_the_rest_is_imported(tmp_path: Path) -> None:
    troubles = [
        Candidate(kind, "bad", Trouble(kind)) for kind in ("sleep", "memory", "crash", "surprise")
    ]
    outcomes = import_library(
        [*troubles, candidate("good", creation.box((1, 2, 3)))],
        tmp_path / "lib",
        "mine",
        "",
        replace(QUICK, timeout=6, memory=2**31, workers=2),
    )
    problems = [outcome.problem for outcome in outcomes]
    assert problems[0] == "took more than 6 s"
    assert problems[1] == "took more than 2 GiB of memory"
    assert "ended the process that read it" in (problems[2] or "")
    assert problems[3] == "unexpected: RuntimeError('what no one thought of')"
    assert problems[4] is None
    assert ShapeLibrary.open(tmp_path / "lib").ids == ("good",)


@pytest.mark.usefixtures("in_this_process")
def test_what_cannot_be_reduced_closely_enough_is_refused(tmp_path: Path) -> None:
    settings = replace(QUICK, simplification=Simplification(max_triangles=20, max_error=0.001))
    (outcome,) = import_library([candidate("ball", BALL)], tmp_path / "lib", "mine", "", settings)
    assert outcome.problem is not None
    assert "20,480 triangles can't be reduced to" in outcome.problem
    assert not (tmp_path / "lib").exists() and not list(tmp_path.iterdir())

    thin = replace(QUICK, min_thickness=0.05)
    (outcome,) = import_library(
        [candidate("board", creation.box((1, 1, 0.02)))], tmp_path / "lib", "mine", "", thin
    )
    assert outcome.problem == "it is 0.014 of its diagonal thick: at least 0.05"


@pytest.mark.usefixtures("in_this_process")
def test_ids_that_cannot_be_stored_are_changed_and_stay_apart(tmp_path: Path) -> None:
    names = ["a b", "a-b", "A-B", "../up", "...", "ü/ß"]
    blocks = [candidate(name, creation.box((1, 2, 3 + n))) for n, name in enumerate(names)]
    outcomes = import_library(blocks, tmp_path / "lib", "mine", "", QUICK)
    assert [outcome.id for outcome in outcomes] == ["a-b", "a-b-2", "A-B-3", "up", "shape", "ü/ß"]
    assert len(ShapeLibrary.open(tmp_path / "lib")) == 6


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"up": "w"}, "up axis 'w'"),
        ({"min_thickness": 1.5}, "min_thickness 1.5"),
        ({"timeout": 0.0}, "timeout 0.0"),
        ({"workers": 0}, "workers 0"),
        ({"unit_cm": -1.0}, "unit_cm -1.0"),
    ],
)
def test_settings_that_make_no_sense(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ImportSettings(**wrong)


def test_other_folders_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "diary.txt").write_text("dear diary")
    with pytest.raises(LibraryError, match=r"diary\.txt"):
        import_library([candidate("ball", BALL)], tmp_path / "lib", "mine", "", QUICK)


@pytest.mark.slow
def test_the_command_imports_a_folder_of_anything(tmp_path: Path) -> None:
    meshes = tmp_path / "meshes"
    (meshes / "good").mkdir(parents=True)
    bad_meshes.write(meshes, list(bad_meshes.BAD))
    bad_meshes.write(meshes / "good", list(bad_meshes.GOOD))
    arguments = ["shapes", "import", f"folder:{meshes}", "--out", tmp_path / "lib", "--memory", "2"]
    arguments += ["--workers", "1"]
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, *map(str, arguments)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) < 1e6  # kB, of the process that took most
    report = json.loads((tmp_path / "lib.report.json").read_text())
    rows = {row["source"].rpartition("/")[2]: row for row in report["shapes"]}
    assert set(rows) == {*bad_meshes.BAD, *bad_meshes.GOOD}
    for name, (_, pattern) in bad_meshes.BAD.items():
        assert rows[name]["info"] is None
        assert any(part in rows[name]["problem"] for part in pattern.split("|")), name
    library = ShapeLibrary.open(tmp_path / "lib")
    assert sorted(library.ids) == [
        "good/flipped",
        "good/giggles",
        "good/path",
        "good/tasse-bol-杯",
        "good/two-words",
    ]
    assert rows["flipped.stl"]["repairs"]["flipped_triangles"] == 4
    assert library.info("good/flipped").solid
    assert f"{len(bad_meshes.BAD)} refused" in done.stdout


@pytest.mark.usefixtures("in_this_process")
def test_the_command_says_what_is_wrong(tmp_path: Path) -> None:
    bad_meshes.write(tmp_path, ["nan.stl"])
    refused = packit("shapes", "import", f"folder:{tmp_path}", "--out", tmp_path / "lib")
    assert refused.returncode == 2 and "none of its meshes can be a shape" in refused.stderr
    assert not (tmp_path / "lib").exists() and (tmp_path / "lib.report.json").exists()
    for arguments, message in (
        (["folder:nowhere", "--out", tmp_path / "lib"], "'folder:nowhere'"),
        (["everyday", "--out", tmp_path], "exists already"),
        (["everyday", "--out", tmp_path / "lib", "--max-error", "0"], "max_error 0.0"),
        (["everyday", "--out", tmp_path / "lib", "--max-triangles", "2"], "max_triangles 2"),
        (["everyday", "--out", tmp_path / "lib", "--up", "w"], "'w' is not one of"),
    ):
        done = packit("shapes", "import", *arguments)
        assert done.returncode == 2 and message in " ".join(done.stderr.split()), done.stderr


@pytest.mark.usefixtures("in_this_process")
def test_the_command_names_meshes_whose_volume_is_that_of_a_sheet(tmp_path: Path) -> None:
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    box = trimesh.creation.box((1, 1, 1))
    for name, faces in (("solid", box.faces), ("pierced", box.faces[1:]), ("open", box.faces[2:])):
        trimesh.Trimesh(box.vertices, faces, process=False).export(meshes / f"{name}.stl")
    done = packit("shapes", "import", f"folder:{meshes}", "--out", tmp_path / "lib")
    assert done.returncode == 0, done.stderr
    assert "Open meshes: open. Their volume is only that of a thin sheet" in done.stdout
    library = ShapeLibrary.open(tmp_path / "lib")
    assert library.info("pierced").volume == pytest.approx(library.info("solid").volume)
