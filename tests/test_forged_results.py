"""Forged results: what `verify`, `compare` and `report` must not accept."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from packit_sim.core.errors import PackFormatError, PackItError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.manifests import manifest_path
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.game.evaluation.results import check_results, read_results
from packit_sim.rules import Rules
from tests.runs import everyday, run_packit, tasks

AGENT = "random/aligned/blbf"

Change = Callable[[dict[str, Any]], object]


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An honest file: one agent on three tasks."""
    file = tmp_path_factory.mktemp("honest") / "res.jsonl"
    evaluate([AGENT], tasks()[:3], 0, file=file)
    return file


def forge(honest: Path, file: Path, change: Change) -> Path:
    """Change the second result."""
    lines = [json.loads(line) for line in honest.read_text().splitlines()]
    change(lines[1])
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return file


def played(**fields: Any) -> Change:
    return lambda line: line["provenance"].update(fields)


def without_an_item_outside(line: dict[str, Any]) -> None:
    line["outside"].pop()


def a_smaller_task(line: dict[str, Any]) -> None:
    line["outside"] = line["outside"][:1]
    line["provenance"]["task_digest"] = "0" * 16


def a_larger_box(line: dict[str, Any]) -> None:
    line.update(cells=[200, 200, 200], density=line["density"] / 8)


def another_library(line: dict[str, Any]) -> None:
    line["library"]["digest"] = "0" * 64


FORGED: dict[str, tuple[Change, str]] = {
    "a return above 1": (played(**{"return": 7.5}), "field 'provenance.return' is 7.5"),
    "a return that is too high": (played(**{"return": 0.9}), "return is recorded as 0.9"),
    "an unknown end": (
        played(end="won"),
        "field 'provenance.end' is 'won': choose from",
    ),
    "a false end": (played(end="all placed"), "its end is recorded as 'all placed', with"),
    "a negative task": (played(task=-1), "field 'provenance.task' is -1"),
    "a negative seed": (played(seed=-3), "field 'provenance.seed' is -3"),
    "a false density": (lambda line: line.update(density=0.99), "density is recorded as 0.99"),
    "an item less": (without_an_item_outside, "in the box and outside, are not those of"),
    "another task": (a_smaller_task, "are not those of task '0000000000000000'"),
    "a larger box": (a_larger_box, "its box or its library is not that of task"),
    "another library": (another_library, "its box or its library is not that of task"),
    "another box": (played(rules={"cells": [40, 40, 40]}), "its rules say \\[40, 40, 40\\]"),
}


def test_honest_results_hold(honest: Path) -> None:
    report = verify_dataset(honest, everyday())
    assert report.is_valid and not report.not_judged
    rollouts = read_results(honest)
    check_results(honest, rollouts, everyday())
    task = tasks()[1]
    left = rollouts[1].pack.outside
    assert left and len(left) + len(rollouts[1].pack.items) == len(task.items)
    assert np.isclose(rollouts[1].pack.task(everyday()).volume, task.volume)


@pytest.mark.parametrize("what", FORGED)
def test_forged_results_are_refused(what: str, honest: Path, tmp_path: Path) -> None:
    change, sentence = FORGED[what]
    file = forge(honest, tmp_path / "forged.jsonl", change)
    with pytest.raises(PackItError, match=sentence):
        check_results(file, read_results(file), everyday())
    problems = [str(problem) for problem in verify_dataset(file, everyday()).problems]
    problems = [problem for problem in problems if "it has no manifest" not in problem]
    assert len(problems) >= 1
    for command in (["compare", file, honest], ["report", file, "--out", tmp_path / "r.html"]):
        done = run_packit(*command)
        assert done.returncode == 2 and str(file) in done.stderr, (command, done)
    assert not (tmp_path / "r.html").exists()


def test_numbers_beyond_floats_are_refused(honest: Path) -> None:
    line = honest.read_text().splitlines()[0]
    total = json.loads(line)["provenance"]["return"]
    for number in ("1e400", "-1e400"):
        with pytest.raises(PackFormatError):
            Pack.from_json(line.replace(repr(total), number))


def test_results_of_former_versions_hold_for_builtin_tasks(honest: Path, tmp_path: Path) -> None:
    def old(line: dict[str, Any]) -> None:
        del line["outside"]

    file = forge(honest, tmp_path / "old.jsonl", old)
    report = verify_dataset(file, everyday())
    assert [str(p) for p in report.problems] == [
        f"{file}: it has no manifest {manifest_path(file).name}"
    ]
    assert not report.not_judged
    assert check_results(file, read_results(file), everyday()) == 0
    file = forge(file, tmp_path / "unknown.jsonl", played(task_digest="0" * 16))
    assert check_results(file, read_results(file), everyday()) == 1
    assert check_results(file, read_results(file)) == 3
    assert (
        "not judged, of 1 results of former versions" in verify_dataset(file, everyday()).not_judged
    )


def test_two_results_of_one_task_are_refused(honest: Path, tmp_path: Path) -> None:
    file = forge(honest, tmp_path / "twice.jsonl", played(task=0))
    with pytest.raises(PackItError, match=f"two results of '{AGENT}' on task 0"):
        check_results(file, read_results(file))


@pytest.mark.slow
def test_kinematic_results_are_replayed(honest: Path, tmp_path: Path) -> None:
    evaluate([AGENT], tasks()[:3], 0, rules=Rules(kinematic=True), file=tmp_path / "k.jsonl")
    assert verify_dataset(tmp_path / "k.jsonl", everyday()).is_valid
    claims = [
        str(problem)
        for number in range(3)
        for problem in verify_dataset(_as_kinematic(honest, tmp_path, number), everyday()).problems
    ]
    assert any("can't be inserted from above, as its record demands" in claim for claim in claims)


def _as_kinematic(honest: Path, folder: Path, number: int) -> Path:
    line = json.loads(honest.read_text().splitlines()[number])
    line["provenance"]["rules"] = {"kinematic": True}
    file = folder / f"{number}.jsonl"
    file.write_text(json.dumps(line) + "\n")
    return file
