"""The command line as a user runs it: output, files and errors."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from trimesh import creation

from packit_sim.game.datasets.pack_files import read_packs
from packit_sim.game.evaluation.results import read_results
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.scene import Scene
from tests.runs import run_packit as packit

SMALL = ("--pool", "6", "--generations", "1")

ALONE = ("--workers", "1")


def shell(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run `packit` in its own process."""
    return subprocess.run(
        [sys.executable, "-m", "packit_sim", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
    )


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("packs") / "two"
    result = packit("generate", "--packs", "2", "--seed", "4", *SMALL, *ALONE, "--out", path)
    assert result.returncode == 0, result.stderr
    assert "2 packs" in result.stdout
    return path


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder in which the demo ran, and what it printed."""
    folder = tmp_path_factory.mktemp("demo")
    done = shell("demo", "--generations", "0", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "demo", done.stdout


@pytest.mark.slow
def test_demo_does_the_whole_job(demo) -> None:
    folder, printed = demo
    assert printed.count("valid") == 9  # the ground truth and eight agents
    files = ("packs.jsonl", "results.jsonl", "truth.png", "best.png", "worst.png")
    for name in files:
        assert f"demo/{name}" in printed and (folder / name).exists()
    results = read_packs(folder / "results.jsonl")
    assert len(results) == len({pack.provenance.agent for pack in results}) == 8
    pictures = [pixels(folder / name) for name in files[2:]]
    assert all(picture.shape == (512, 512, 3) for picture in pictures)
    assert len({picture.tobytes() for picture in pictures}) == 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["packs", "results"])
def test_pybullet_sees_no_penetration_in_the_packs_of_the_demo(demo, name) -> None:
    library = ShapeLibrary.open("everyday")
    for pack in read_packs(demo[0] / f"{name}.jsonl"):
        box = pack.replay(library)
        with Scene(box) as scene:
            found = scene.penetrations()
        assert max(found.values(), default=0.0) <= CONTACT_TOLERANCE


def test_generated_packs_verify_evaluate_and_render(dataset, tmp_path) -> None:
    verified = packit("verify", dataset)
    assert verified.returncode == 0 and "2 of 2 packs hold" in verified.stdout

    played = packit("evaluate", dataset, "--workers", "1", "--out", tmp_path / "results.jsonl")
    assert played.returncode == 0, played.stderr
    assert "aligned/blbf" in played.stdout and "tasks: 2," in played.stdout
    assert len(read_packs(tmp_path / "results.jsonl")) == 16

    drawn = packit("render", dataset, "--pack", "1", "--size", "64", "--out", tmp_path / "one.png")
    assert drawn.returncode == 0, drawn.stderr
    assert pixels(tmp_path / "one.png").shape == (64, 64, 3)


@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_a_seed_repeats_a_dataset_bit_for_bit(workers, dataset, tmp_path) -> None:
    arguments = ("--packs", "2", "--seed", "4", *SMALL, "--workers", workers)
    packit("generate", *arguments, "--out", tmp_path)
    assert (tmp_path / "packs.jsonl").read_bytes() == (dataset / "packs.jsonl").read_bytes()


def test_verify_is_red_on_a_pack_that_does_not_hold(dataset, tmp_path) -> None:
    packs = read_packs(dataset / "packs.jsonl")
    last = packs[1].to_json().rpartition('"location":[')
    moved = tmp_path / "moved.jsonl"
    moved.write_text(f"{packs[0].to_json()}\n{last[0]}{last[1]}24,{last[2].partition(',')[2]}\n")
    verified = packit("verify", moved)
    assert verified.returncode == 1
    assert "pack 1: item" in verified.stdout and "not inside the box" in verified.stdout
    assert "1 of 2 packs hold" in verified.stdout


def test_verify_reports_lines_that_cannot_be_read(dataset, tmp_path) -> None:
    lines = (dataset / "packs.jsonl").read_text().splitlines()
    (tmp_path / "cut.jsonl").write_text(f"{lines[0]}\n{lines[1][:200]}\n")
    verified = packit("verify", tmp_path / "cut.jsonl")
    assert verified.returncode == 1 and "not JSON" in verified.stdout
    assert "1 of 2 packs hold" in verified.stdout


def test_verify_takes_packings_of_other_tools(tmp_path) -> None:
    creation.box((1, 1, 1)).export(tmp_path / "cube.stl")
    pose = np.eye(4)
    pose[:3, 3] = 0.5
    items = [{"mesh": "cube.stl", "pose": pose.tolist()}]
    (tmp_path / "one.json").write_text(json.dumps({"box": [1, 1, 2], "items": items}))
    assert packit("verify", tmp_path / "one.json").returncode == 0
    (tmp_path / "two.json").write_text(json.dumps({"box": [1, 1, 2], "items": items * 2}))
    twice = packit("verify", tmp_path / "two.json")
    assert twice.returncode == 1 and "crosses item 0" in twice.stdout


def test_a_folder_of_ones_own_meshes_is_packed(tmp_path) -> None:
    (tmp_path / "blocks").mkdir()
    creation.box((1, 2, 3)).export(tmp_path / "blocks" / "brick.stl")
    creation.icosphere(subdivisions=2).export(tmp_path / "ball.obj")
    out = tmp_path / "mine"
    result = packit("generate", "--library", tmp_path, *SMALL, "--workers", "1", "--out", out)
    assert result.returncode == 0, result.stderr
    assert {i.shape for i in read_packs(out / "packs.jsonl")[0].items} <= {"blocks/brick", "ball"}
    assert packit("verify", out, "--library", tmp_path).returncode == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["verify", "absent.jsonl"], "absent.jsonl: No such file"),
        (["evaluate", "broken.jsonl"], "broken.jsonl, line 1: not JSON"),
        (["evaluate", "absent.jsonl"], "absent.jsonl: No such file"),
        (
            ["evaluate", "starter", "--agent", "best/aligned/blbf"],
            "no shape policy 'best': choose from best-fit, blockout, blockout-ahead, champion,",
        ),
        (["render", "broken.jsonl", "--out", "x.png"], "broken.jsonl, line 1"),
        (["shapes", "list", "--library", "nowhere"], "'nowhere'"),
        (["shapes", "list", "--category", "dragon"], "'dragon': choose from"),
        (["generate", "--size-range", "1", "0.5", "--out", "x"], "size_range = (1.0, 0.5)"),
        (["generate", "--population", "9", "--out", "x"], "population = 9"),
        (["generate", "--library", "meshes", "--out", "x"], "bad.stl"),
    ],
)
def test_bad_input_is_one_clear_line_and_writes_nothing(arguments, message, tmp_path) -> None:
    (tmp_path / "broken.jsonl").write_text('{"format":1,\n')
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "bad.stl").write_bytes(b"no mesh")
    before = sorted(p.name for p in tmp_path.rglob("*"))
    failed = packit(*arguments, cwd=tmp_path)
    assert failed.returncode == 2
    assert failed.stderr.startswith("error: ") and failed.stderr.count("\n") == 1
    assert message in failed.stderr
    assert sorted(p.name for p in tmp_path.rglob("*")) == before


def test_brackets_in_a_name_are_printed_as_they_are(tmp_path) -> None:
    failed = packit("verify", tmp_path / "a[bold]b.jsonl")
    assert failed.returncode == 2 and "a[bold]b.jsonl" in failed.stderr


def test_an_agent_named_twice_plays_once(dataset, tmp_path) -> None:
    name = ("--agent", "largest-first/aligned/blbf")
    for names, file in ((name, "once.jsonl"), (name + name, "twice.jsonl")):
        packit("evaluate", dataset, *names, "--workers", "1", "--out", tmp_path / file)
    assert len(read_results(tmp_path / "once.jsonl")) == 2
    assert read_results(tmp_path / "once.jsonl") == read_results(tmp_path / "twice.jsonl")


def test_a_picture_larger_than_can_be_drawn_is_refused(dataset, tmp_path) -> None:
    failed = packit("render", dataset, "--size", "4096", "--out", tmp_path / "x.png")
    assert failed.returncode == 2 and "2048" in failed.stderr


def test_a_dataset_is_never_replaced(dataset) -> None:
    before = {path.name: path.read_bytes() for path in dataset.iterdir()}
    failed = packit("generate", *SMALL, "--patience", "7", "--out", dataset)
    assert failed.returncode == 2 and "other settings" in failed.stderr
    assert {path.name: path.read_bytes() for path in dataset.iterdir()} == before


def test_a_dataset_that_is_there_already_is_left_as_it_is(dataset) -> None:
    before = (dataset / "packs.jsonl").read_bytes()
    again = packit("generate", "--packs", "2", "--seed", "4", *SMALL, "--out", dataset)
    assert again.returncode == 0 and "2 packs" in again.stdout
    assert (dataset / "packs.jsonl").read_bytes() == before


def test_where_nothing_can_be_written_it_says_so_before_it_works(tmp_path) -> None:
    (tmp_path / "file").write_text("in the way")
    failed = packit("generate", "--out", tmp_path / "file" / "packs")
    assert failed.returncode == 2 and "file" in failed.stderr
    assert failed.stderr.startswith("error: ") and failed.stderr.count("\n") == 1


def test_a_pack_that_is_not_there_is_refused(dataset, tmp_path) -> None:
    failed = packit("render", dataset, "--pack", "7", "--out", tmp_path / "x.png")
    assert failed.returncode == 2 and "choose 0 to 1" in failed.stderr
