"""Logs of long work: started, resumed and finished; only `-v` configures logging."""

import logging
import sys
from pathlib import Path

import pytest
from trimesh import creation

from packit_sim.cli.app import main
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.libraries.importer import ImportSettings, import_library
from packit_sim.libraries.library import ShapeLibrary

GENERATE = "generate --pool 4 --generations 0 --workers 1 --out out"


def run(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["packit", *command.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code


@pytest.mark.parametrize("option", ["", "-v ", "-vv "])
def test_verbose_logs_to_stderr(
    option: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    run(f"{option}{GENERATE}", monkeypatch)
    run(f"{option}evaluate out --agent random/random/random --workers 1", monkeypatch)
    captured = capsys.readouterr()
    words = " ".join(captured.err.split())
    assert ("1 of 1 packs are left to evolve" in words) == bool(option)
    assert ("pack 0: density" in words) == bool(option)
    assert ("1 agents, 1 tasks: 0 results exist, 1 to play" in words) == bool(option)
    assert ("task 0, random/random/random: return" in words) == (option == "-vv ")
    assert "left to evolve" not in captured.out


def test_evaluation_logs_what_is_resumed(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    tasks = load_tasks("starter", ShapeLibrary.open("everyday"))[:1]
    agents = [Agent.from_name("random/random/random")]
    with caplog.at_level(logging.INFO, "packit_sim"):
        for _ in range(2):
            evaluate(agents, tasks, 0, file=tmp_path / "results.jsonl")
    assert "0 results exist, 1 to play" in caplog.text
    assert "1 results exist, 0 to play" in caplog.text


@pytest.mark.usefixtures("in_this_process")
def test_import_logs_what_is_skipped(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    creation.box((1, 2, 3)).export(meshes / "brick.stl")
    (meshes / "bad.stl").write_bytes(b"no mesh")
    source = ShapeLibrary.open(f"folder:{meshes}").source
    with caplog.at_level(logging.INFO, "packit_sim"):
        import_library(
            [source.candidate(id) for id in ("bad", "brick")],
            tmp_path / "library",
            "two",
            settings=ImportSettings(workers=1),
        )
    warnings = [each.getMessage() for each in caplog.records if each.levelno == logging.WARNING]
    assert warnings == ["1 of 2 meshes are skipped"]
    assert "importing 2 meshes with 1 processes" in caplog.text
    assert "bad is skipped" in caplog.text and "1 shapes in" in caplog.text
