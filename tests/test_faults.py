"""Kills and full disks at every change of a file: nothing is lost, and messages have the path."""

from __future__ import annotations

import shutil
import sys
from functools import partial
from pathlib import Path

import pytest

from campaigns import injector
from packit_sim.game.datasets.manifests import Manifest, manifest_path
from packit_sim.game.evaluation.results import read_results, write_results
from packit_sim.game.evaluation.results_store import opened
from tests.runs import run_packit

EVALUATE = [
    *("-m", "packit_sim", "evaluate", "starter", "--tasks", "2", "--workers", "1"),
    *("--agent", "random/aligned/blbf", "--out"),
]


def resume(played: Path, begun: Path) -> None:
    """Resume a file of results with those of another, as an evaluation does."""
    wanted = read_results(played)
    with opened(begun) as store:
        store.add(wanted[len(store.rollouts) :])


pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="names files by /proc")


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two results of one agent."""
    folder = tmp_path_factory.mktemp("played")
    done = run_packit(*EVALUATE[2:], folder / "res.jsonl")
    assert done.returncode == 0, done.stderr
    return folder / "res.jsonl"


@pytest.fixture
def begun(played: Path, tmp_path: Path) -> Path:
    """A file with the first of the two results, as an evaluation that was stopped left it."""
    file = tmp_path / "out" / "res.jsonl"
    write_results(file, read_results(played)[:1])
    return file


def test_results_survive_a_kill_at_every_change(played: Path, begun: Path) -> None:
    folder, first = begun.parent, begun.parent.with_name("first")
    wanted = read_results(played)
    shutil.copytree(folder, first)
    work = partial(resume, played, begun)
    changes = injector.changes_of(work, folder)
    assert changes >= 6 and read_results(begun) == wanted
    for n in range(1, changes + 1):
        shutil.rmtree(folder)
        shutil.copytree(first, folder)
        assert injector.fork(work, folder, at=n) == -9
        assert read_results(begun) in (wanted[:1], wanted)
        work()
        assert read_results(begun) == wanted
        assert {path.name for path in folder.iterdir()} == {
            begun.name,
            f"{begun.name}.manifest.json",
        }
        assert Manifest.read(manifest_path(begun)).describes(begun.read_bytes())


def test_a_full_disk_changes_nothing_and_names_the_file(
    played: Path, begun: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in begun.parent.iterdir()}
    work = partial(resume, played, begun)
    for n in range(1, 8):
        assert injector.fork(work, begun.parent, at=n, fault="full") == 1
        last = capfd.readouterr().err.splitlines()[-1]
        assert "No space left on device" in last and str(begun.parent) in last
        assert {path: path.read_bytes() for path in begun.parent.iterdir()} == before


@pytest.mark.parametrize("name", ["evaluate", pytest.param("report", marks=pytest.mark.slow)])
def test_commands_name_the_file_that_is_too_large_for_the_disk(
    name: str, played: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    out = folder / ("res.jsonl" if name == "evaluate" else "page.html")
    report = ["-m", "packit_sim", "report", str(played), "--gallery", "0", "--out"]
    done = injector.run(
        [*(EVALUATE if name == "evaluate" else report), str(out)], folder, at=3, fault="full"
    )
    if name == "report":
        done = injector.run([*report, str(out)], folder, at=2, fault="full")
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
    assert str(out) in done.stderr and "No space left on device" in done.stderr
    assert not out.exists()
