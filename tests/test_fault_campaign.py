"""The campaign of faults finds planted defects, and its page has its results."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sb3_contrib", reason="sb3-contrib comes with the extra learn")

from campaigns import fault_kinds, fault_trials, injector
from campaigns.common import read_results, table_in_page
from campaigns.disturbed import OUT, Command
from campaigns.fault_commands import COMMANDS
from campaigns.fault_kinds import FAULTS
from campaigns.fault_trials import Bench, Running
from campaigns.faults import table, tried
from packit_sim.core.files import replace_text, replacing
from packit_sim.render.renderers import RENDERER_VARIABLE

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

TEXT = "all of it\n" * 3


def check(folder: Path, whole: Path) -> None:
    file = folder / "file.txt"
    assert not file.exists() or file.read_text() == TEXT


@dataclass(frozen=True)
class Writer(Command):
    """Writes a file, whole or not at all unless a defect is planted."""

    defect: str = ""

    def run(self, workers: int = 1, arguments: object = None) -> None:
        file = Path(OUT, "file.txt")
        if self.defect == "in parts":
            with open(file, "w") as parts:
                parts.write(TEXT[:5])
                parts.flush()
                os.fsync(parts.fileno())
                parts.write(TEXT[5:])
        elif self.defect == "temporary file":
            part = file.with_name(f"{os.getpid()}.part")
            part.write_text(TEXT)
            part.rename(file)
        else:
            replace_text(file, TEXT)
        if self.defect == "foreign file":
            Path(OUT, "notes.txt").unlink(missing_ok=True)


@pytest.mark.parametrize(
    ("defect", "problem"),
    [
        ("", ""),
        ("in parts", "unreadable"),
        ("temporary file", "these files differ"),
        ("foreign file", "the foreign file notes.txt was changed"),
    ],
)
def test_a_planted_defect_is_found(
    defect: str, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    bench = Bench(Writer("writer", (), (), check, defect=defect), tmp_path)
    count, problems = tried(bench, FAULTS["kill -9"], seed=0)
    assert count == bench.changes() >= 2
    assert any(problem in each for each in problems) if problem else not problems


@dataclass(frozen=True)
class Refusing(Command):
    """Refuses to do anything."""

    def run(self, workers: int = 1, arguments: object = None) -> None:
        print("there is no such file")
        sys.exit(2)


def test_a_command_that_fails_without_a_fault_stops_the_campaign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RuntimeError, match=r"exit code 2: there is no such file"):
        Bench(Refusing("refusing", (), (), check), tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_machine_of_a_cluster_may_be_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray", reason="the extra `cluster` is not installed")
    monkeypatch.setattr(fault_kinds, "MOMENTS", 2)
    monkeypatch.setenv(RENDERER_VARIABLE, "software")
    monkeypatch.chdir(tmp_path)
    bench = Bench(COMMANDS["evaluate"], tmp_path)
    assert tried(bench, FAULTS["machine of a cluster lost"], seed=0) == (2, [])


def leave_one() -> None:
    if os.fork() == 0:
        signal.pause()


def test_a_process_that_is_left_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fault_trials, "GRACE", 0.2)
    ended = Running(leave_one).end()
    assert ended.left


def test_the_page_has_the_results() -> None:
    assert table(read_results("faults")) == table_in_page("faults")


def test_temporary_files_of_killed_processes_are_removed_and_no_others(tmp_path: Path) -> None:
    file = tmp_path / "file.txt"
    kept = tmp_path / ".file.txt.original"
    kept.write_text("mine")
    assert injector.fork(lambda: replace_text(file, TEXT), tmp_path, at=2) == -9
    assert len(list(tmp_path.iterdir())) == 2  # that of the killed process, and the one of the user
    with replacing(file) as unfinished:
        unfinished.write(b"first")
        replace_text(file, TEXT)
        assert len(list(tmp_path.glob(".file.txt.*.tmp"))) == 1 and file.read_text() == TEXT
    assert file.read_text() == "first"
    assert {path.name for path in tmp_path.iterdir()} == {"file.txt", kept.name}


def test_sizes_are_those_of_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    bench = Bench(Writer("writer", (), (), check), tmp_path)
    sizes = bench.sizes(np.random.default_rng(0))
    assert sizes[0] == 0 and min(sizes[1:]) >= len(TEXT) - 1
