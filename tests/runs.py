"""Run `packit` in tests; build results and trainings by hand, without playing."""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

from typer.testing import CliRunner

from packit_sim.cli.app import app, main
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.datasets.provenance import Played
from packit_sim.game.evaluation.results import Rollout, write_results
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import PACKIT, End, Rules


@cache
def everyday() -> ShapeLibrary:
    return ShapeLibrary.open("everyday")


@cache
def tasks() -> tuple[Task, ...]:
    return load_tasks("starter", everyday())


def packit(*arguments: object) -> str:
    """What `packit` prints, where it ends well."""
    found = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if found.exception and not isinstance(found.exception, SystemExit):
        raise found.exception
    assert found.exit_code == 0, found.output
    return found.output


class PoolOfNone:
    """A pool of no processes, each of which would take 2 s to start: it works in this one."""

    def __init__(self, **settings: object) -> None: ...

    def __enter__(self) -> PoolOfNone:
        return self

    def __exit__(self, *raised: object) -> None: ...

    def stop(self) -> None: ...

    def schedule(
        self, work: Callable[..., object], arguments: tuple[object, ...], timeout: float
    ) -> Future[object]:
        future: Future[object] = Future()
        try:
            future.set_result(work(*arguments))
        except Exception as error:
            future.set_exception(error)
        return future


@dataclass(frozen=True)
class Ran:
    """How a command ended, and what it printed."""

    returncode: int
    stdout: str
    stderr: str


def run_packit(*arguments: object, cwd: Path | None = None) -> Ran:
    """Run `packit` as from a shell, but in this process: a new one takes seconds to import."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["packit", *map(str, arguments)]),
        mock.patch.dict(os.environ),
        contextlib.chdir(cwd or Path.cwd()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
    return Ran(code, out.getvalue(), err.getvalue())


def rollout(agent: str, task: int, items: int, rules: Rules = PACKIT, **more: Any) -> Rollout:
    """The first so many items of the ground truth; more: other fields of its provenance."""
    whole = tasks()[task]
    truth = whole.pack
    volumes = [one.item.volume for one in truth.placed(everyday())[:items]]
    total = sum(volumes) / whole.volume
    end = End.COMPLETE if items >= len(truth.items) else End.NO_LOCATION
    played = Played(
        agent=agent,
        task=task,
        task_digest=whole.digest,
        seed=0,
        rules=rules,
        total=total,
        end=str(end),
        seconds=0.5,
        **more,
    )
    items_placed = truth.items[:items]
    return Rollout(replace(truth, items=items_placed, density=sum(volumes), provenance=played))


def results(file: Path, agents: Mapping[str, Sequence[int]]) -> Path:
    """A file of results: how many items each agent placed, task by task."""
    write_results(
        file,
        [rollout(a, n, items) for a, counts in agents.items() for n, items in enumerate(counts)],
    )
    return file


def training(folder: Path, rewards: Sequence[float], **settings: Any) -> Path:
    """A training's folder: validation rewards after each thousand steps."""
    folder.mkdir()
    written = {"steps": 5000, "rules": {"easy": False}, "network": {"width": 64}, **settings}
    (folder / "settings.json").write_text(json.dumps({"settings": written}))
    curve = [
        {
            "steps": 1000 * n,
            "reward": reward - 0.1 if n else None,
            "validation": {"mean": reward, "low": reward - 0.05, "high": reward + 0.05},
        }
        for n, reward in enumerate(rewards)
    ]
    (folder / "curve.json").write_text(json.dumps(curve))
    return folder
