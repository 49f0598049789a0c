"""`packit render`, `film`, `export` and `figures` as a user runs them: files, messages, Ctrl-C."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh import creation

from packit_sim.box import Box
from packit_sim.cli.app import main
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_files import read_packs, write_packs
from packit_sim.game.datasets.packs import LibraryRef, Pack
from packit_sim.game.generation.evolution import evolve
from packit_sim.game.paper import figures
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.render.coloring import ramp
from packit_sim.render.defaults import BACKGROUND
from tests.zoo import cube_of

pytestmark = pytest.mark.usefixtures("software")

SMALL = EvolutionSettings(
    pool=8, population=8, elite=2, lucky=2, generations=2, patience=9, keep_every=1
)


@dataclass(frozen=True)
class Ran:
    code: int
    out: str
    err: str


@pytest.fixture(name="packit")
def _packit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Ran]:
    def run(*arguments: str | Path) -> Ran:
        monkeypatch.setattr(sys, "argv", ["packit", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return Ran(int(ended.value.code or 0), captured.out, captured.err)

    return run


@pytest.fixture(name="history", scope="module")
def _history() -> list[Pack]:
    return evolve(ShapeLibrary.open("everyday"), 3, SMALL).kept


@pytest.fixture(name="packs")
def _packs(history: list[Pack], tmp_path: Path) -> Path:
    path = tmp_path / "packs.jsonl"
    write_packs(path, history)
    return path


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def test_every_way_to_draw_a_pack_is_another_picture(packit, packs, tmp_path) -> None:
    ways = (
        (),
        ("--as-task",),
        ("--camera", "front"),
        ("--camera", "top"),
        ("--camera", "-30,50"),
        ("--explode", "0.8"),
        ("--cut", "y=0.5"),
        ("--box-style", "ghost"),
        ("--box-style", "none"),
        ("--background", "navy"),
        ("--color", "category", "--no-legend"),
        ("--color", "order", "--no-legend"),
        ("--color", "share", "--no-legend"),
        ("--pack", "2"),
    )
    found = []
    for n, way in enumerate(ways):
        out = tmp_path / f"{n}.png"
        done = packit("render", packs, "--out", out, "--size", "96x64", *way)
        assert (done.code, done.err) == (
            0,
            "",
        ) and f"wrote {out} by the software renderer" in done.out
        found.append(pixels(out))
    assert {picture.shape for picture in found} == {(64, 96, 3)}
    assert len({picture.tobytes() for picture in found}) == len(ways)
    assert (found[ways.index(("--background", "navy"))][0, 0] == (0, 0, 128)).all()
    assert (found[0][0, 0] == BACKGROUND).all()


def test_legends_are_next_to_pictures_and_a_turntable_is_eight_views(
    packit, packs, tmp_path
) -> None:
    packit("render", packs, "--out", tmp_path / "a.png", "--size", "200", "--color", "category")
    legend = pixels(tmp_path / "a.png")
    assert legend.shape[0] == 200 < legend.shape[1]
    packit("render", packs, "--out", tmp_path / "b.png", "--size", "40", "--camera", "turntable")
    views = pixels(tmp_path / "b.png")
    assert views.shape == (80, 160, 3)
    tiles = {views[y : y + 40, x : x + 40].tobytes() for y in (0, 40) for x in range(0, 160, 40)}
    assert len(tiles) == 8


def test_colours_tell_what_moves_when_a_box_is_let_go(packit, tmp_path) -> None:
    """Two cubes, one on the floor, one 0.4 above it: the ramp's ends are seen."""
    creation.box((1, 1, 1)).export(tmp_path / "cube.stl")
    library = ShapeLibrary.open(tmp_path)
    box = Box()
    box.place(Item(library["cube"], cube_of(30).scale), (0, 0, 0))
    box.place(Item(library["cube"], cube_of(30).scale), (10, 10, 10))
    write_packs(tmp_path / "packs.jsonl", [Pack.of(box, LibraryRef.of(library))])
    out = tmp_path / "stability.png"
    arguments = (
        tmp_path / "packs.jsonl",
        "--library",
        tmp_path,
        "--out",
        out,
        "--color",
        "stability",
    )
    done = packit("render", *arguments, "--size", "128", "--camera", "top", "--no-legend")
    assert done.code == 0, done.err
    found = pixels(out).reshape(-1, 3).astype(int)
    for color in (ramp(0.0), ramp(1.0)):  # in whatever light
        hue = np.array(color) / np.linalg.norm(color)
        bright = found[found.sum(axis=1) > 60]
        likeness = bright @ hue / np.linalg.norm(bright, axis=1)
        assert (likeness > 0.995).sum() > 100
    done = packit("render", *arguments, "--as-task")
    assert done.code == 2 and "--color stability needs a packed box" in done.err


def test_shapes_of_a_library_side_by_side(packit, tmp_path) -> None:
    out = tmp_path / "mugs.png"
    ids = ShapeLibrary.open("everyday").categories["mug"]
    done = packit("render", "--category", "mug", "--out", out, "--size", "128x96")
    assert done.code == 0, done.err
    several = pixels(out)
    assert several.shape == (96, 128, 3) and (several != BACKGROUND).any()
    packit("render", "--id", ids[0], "--out", out, "--size", "128x96")
    assert not np.array_equal(pixels(out), several)


def test_arrays(packit, packs, tmp_path) -> None:
    out = tmp_path / "view.npz"
    assert packit("render", packs, "--out", out, "--size", "64").code == 0
    with np.load(out) as arrays:
        assert set(arrays) == {"image", "depth", "segmentation", "projection"}
        count = len(read_packs(packs)[0].items)
        assert arrays["segmentation"].max() < count and (arrays["segmentation"] >= 0).any()


def test_a_result_is_coloured_by_the_reward_that_it_brought(packit, packs, tmp_path) -> None:
    results = tmp_path / "results.jsonl"
    agent = ("--agent", "largest-first/aligned/blbf", "--workers", "1")
    packit("evaluate", packs, *agent, "--out", results)
    shown = ("--size", "64", "--color", "share")
    done = packit("render", results, "--out", tmp_path / "a.png", *shown)
    assert done.code == 0, done.err


@pytest.mark.parametrize(("name", "frames"), [("film.mp4", 11), ("film.gif", 11)])
def test_films(packit, packs, tmp_path, name: str, frames: int) -> None:
    out = tmp_path / name
    settings = ("--size", "64x36", "--seconds", "1", "--fps", "10")
    done = packit("film", packs, "--out", out, *settings)
    assert done.code == 0 and f"{frames} frames" in done.out, done.err
    assert out.stat().st_size > 500
    turned = packit(
        "film", packs, "--out", out, *settings, "--camera", "turntable", "--cut", "z=.4"
    )
    assert turned.code == 0 and "10 frames" in turned.out, turned.err


def test_exports_are_read_back(packit, packs, tmp_path) -> None:
    count = len(read_packs(packs)[0].items)
    for name in ("box.glb", "box.3mf"):
        done = packit("export", packs, "--out", tmp_path / name)
        assert done.code == 0 and f"{count} items" in done.out, done.err
        assert len(trimesh.load_scene(tmp_path / name).graph.nodes_geometry) == count
    packit("export", packs, "--out", tmp_path / "box.stl", "--unit-mm", "250")
    assert trimesh.load_mesh(tmp_path / "box.stl").bounds.max() <= 250.1
    packit("export", packs, "--out", tmp_path / "box.json")
    assert len(json.loads((tmp_path / "box.json").read_text())["items"]) == count
    verified = packit("verify", tmp_path / "box.json")
    assert verified.code == 0 and "0 problems" in verified.out


@pytest.mark.slow
def test_figures_are_the_same_again(packit, packs, history, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(figures, "_SIDE", 80)
    kinds = ("task", "environment", "evolution", "rollouts", "looks")
    names = {f"figure-{name}.png" for name in kinds}
    one, two = tmp_path / "one", tmp_path / "two"
    settings = ("--history-dataset", packs, "--tasks", "2")
    done = packit("figures", packs, "--out", one, *settings)
    assert done.code == 0 and {path.name for path in one.iterdir()} == names, done.err
    packit("figures", packs, "--out", two, *settings, "--only", "task", "--only", "rollouts")
    for name in ("figure-task.png", "figure-rollouts.png"):
        assert np.array_equal(pixels(one / name), pixels(two / name))
    assert len(list(two.iterdir())) == 2
    assert all(pixels(one / name).std() > 5 for name in names)
    wide = pixels(one / "figure-evolution.png")
    assert wide.shape[1] > 2.5 * wide.shape[0] and len(history) == 3


def test_a_figure_of_packs_that_have_no_history(packit, tmp_path) -> None:
    wanted = ("--only", "evolution", "--history-dataset", "starter")
    failed = packit("figures", "--out", tmp_path / "docs", *wanted)
    assert failed.code == 2 and "packit generate --history" in failed.err
    assert list((tmp_path / "docs").iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["render", "starter", "--out", "a.jpg"], "a.jpg is not a picture: choose a name"),
        (["render", "--out", "a.png"], "nothing to draw: give DATASET"),
        (["render", "starter", "--id", "teapot", "--out", "a.png"], "leave them out, or 'starter'"),
        (["render", "--id", "dragon", "--out", "a.png"], "'dragon'"),
        (["render", "--category", "dragon", "--out", "a.png"], "'dragon': choose from"),
        (["render", "starter", "--pack", "99", "--out", "a.png"], "has no pack 99: choose 0 to"),
        (["render", "starter", "--camera", "side", "--out", "a.png"], "iso, front, top, turntable"),
        (
            ["render", "starter", "--camera", "0,95", "--out", "a.png"],
            "elevation 95.0 is not possible",
        ),
        (["render", "starter", "--camera", "turntable", "--out", "a.npz"], "8 views"),
        (["render", "starter", "--size", "4096", "--out", "a.png"], "16 to 2048 pixels"),
        (["render", "starter", "--size", "10xx10", "--out", "a.png"], "size '10xx10'"),
        (["render", "starter", "--cut", "y>1", "--out", "a.png"], "cut 'y>1' is not possible"),
        (["render", "starter", "--cut", "w=0.5", "--out", "a.png"], "cut 'w=0.5'"),
        (["render", "starter", "--cut", "y=-1", "--out", "a.png"], "cut 'y=-1'"),
        (["render", "starter", "--background", "mud", "--out", "a.png"], "'mud' is not a colour"),
        (["render", "starter", "--out", "/proc/a.png"], "/proc/a.png"),
        (["film", "starter", "--out", "a.avi"], "a.avi is no film"),
        (["film", "starter", "--cut", "y=0.5", "--out", "a.gif"], "choose --camera turntable"),
        (["film", "starter", "--explode", "1", "--out", "a.gif"], "choose --camera turntable"),
        (["film", "starter", "--size", "63x33", "--seconds", "0.1", "--out", "a.mp4"], "63 x 33"),
        (["export", "starter", "--out", "a.obj"], "a.obj is no export"),
        (["export", "starter", "--unit-mm", "0", "--out", "a.stl"], "0.0 mm is not possible"),
        (["export", "starter", "--out", "/proc/a.glb"], "/proc/a.glb"),
    ],
)
def test_bad_input_is_one_clear_line_and_writes_nothing(
    packit, arguments, message, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    failed = packit(*arguments)
    assert failed.code == 2
    assert failed.err.startswith("error: ") and failed.err.count("\n") == 1
    assert message in failed.err
    assert list(tmp_path.iterdir()) == []


def test_a_read_only_folder_is_reported_before_any_work(
    packit, packs, tmp_path, monkeypatch
) -> None:
    """As root any folder can be: so `os.access` says what it says to others."""
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setattr("packit_sim.Scene", None)
    for command, name in (("render", "a.png"), ("film", "a.gif"), ("export", "a.glb")):
        failed = packit(command, packs, "--out", tmp_path / name)
        assert failed.code == 2 and "no permission for" in failed.err
    assert {path.suffix for path in tmp_path.iterdir()} == {".jsonl", ".json"}


@pytest.mark.slow
def test_ctrl_c_ends_a_film_and_leaves_nothing(packs, tmp_path) -> None:
    out = tmp_path / "out" / "film.mp4"
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    command = [sys.executable, "-m", "packit_sim", "film", str(packs), "--out", str(out)]
    process = subprocess.Popen(
        [*command, "--size", "64x36", "--seconds", "60"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(temporary)},
        start_new_session=True,
    )
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while process.poll() is None and not children.read_text().split():
        time.sleep(0.05)  # until ffmpeg runs
    os.killpg(process.pid, signal.SIGINT)
    output, error = process.communicate()
    assert process.returncode == 130, error
    assert "stopped: nothing is written" in output and "Traceback" not in error
    assert list(out.parent.iterdir()) == [] and list(temporary.iterdir()) == []


def test_the_page_s_example_runs_and_its_pictures_are_there(tmp_path, monkeypatch) -> None:
    page = Path(__file__).parents[1] / "docs" / "guides" / "pictures.md"
    text = page.read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, page.name, "exec"), {})
    assert {path.name for path in tmp_path.iterdir()} == {"apart.png", "cut.png", "height.png"}
    assert all((page.parent / name).is_file() for name in re.findall(r"!\[.*?\]\((.*?)\)", text))
