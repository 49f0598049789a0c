"""What the command line loads before it works, its help, and what it suggests and completes."""

import io
import json
import os
import re
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numba
import pytest
import typer.main
from numba.core import event

from packit_sim.cli import compilation_bar, evaluations, output, terminal
from packit_sim.cli.app import app
from packit_sim.core.confidence import Estimate
from tests.runs import run_packit as packit

HEAVY = {
    *("fcl", "gymnasium", "joblib", "lxml", "matplotlib", "networkx", "numba"),
    *("numpy", "PIL", "pybullet", "pydantic", "rich.console", "scipy", "torch", "trimesh"),
}

HELP = """
import contextlib, io, json, sys, types
from packit_sim.cli.app import app
for words in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()):
        app(words, standalone_mode=False)
executed = {name for name, module in sys.modules.items() if type(module) is types.ModuleType}
print(json.dumps(sorted(executed)))
"""
"""Runs commands, and prints the modules that were executed: lazy ones have another type."""


def modules_after(*commands: str) -> set[str]:
    words = json.dumps([command.split() for command in commands])
    run = subprocess.run(
        [sys.executable, "-c", HELP, words], capture_output=True, check=True, timeout=60
    )
    return set(json.loads(run.stdout.splitlines()[-1]))


def commands(group: Any = None, name: str = "") -> list[str]:
    """All commands and groups, such as "shapes import"."""
    group = group or typer.main.get_command(app)
    found = [name]
    for own, command in group.commands.items():
        is_group = hasattr(command, "commands")
        found += commands(command, f"{name} {own}") if is_group else [f"{name} {own}"]
    return found


def test_help_of_every_command_loads_nothing_heavy() -> None:
    loaded = modules_after(*(f"{name} --help" for name in commands()))
    assert not loaded & HEAVY


@pytest.mark.parametrize("command", ["--version", "pack --help", "train --help"])
def test_a_start_loads_few_modules(command: str) -> None:
    loaded = modules_after(command)
    assert len(loaded) < 260  # 213 with Python 3.11 and `pack --help`
    assert sum(name.startswith("packit_") for name in loaded) < 40


@pytest.mark.parametrize("name", commands())
def test_help_has_80_columns_and_whole_words(name: str) -> None:
    lines = packit(*name.split(), "--help").stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert not any(line.rstrip().endswith(("...", "…", "-")) for line in lines[1:])
    assert not {"│", "╭"} & set("".join(lines))


@pytest.mark.parametrize(
    ("words", "suggestion"),
    [
        ("pakc", "Did you mean 'pack'?"),
        ("shapes lst", "Did you mean 'list'?"),
        ("pack --objectiv count", "Did you mean --objective?"),
        ("evaluate --agent largest-frist/aligned/blbf", "did you mean largest-first"),
        ("evaluate --agent random/algined/blbf", "did you mean aligned?"),
        ("evaluate --agent random/aligned/blbf+beem=2", "did you mean beam?"),
        ("verify startr", "did you mean starter?"),
        ("shapes list --library everday", "did you mean everyday?"),
        ("nest cut-cubes-8", "did you mean cut-cube-8"),
        ("reproduce tabel1", "did you mean table1?"),
    ],
)
def test_a_name_that_is_not_known_leads_to_one_that_is(words: str, suggestion: str) -> None:
    failed = packit(*words.split())
    assert failed.returncode == 2 and failed.stderr.count("\n") == 1
    assert suggestion in failed.stderr


def completed(line: str) -> list[str]:
    words = line.split(" ")
    env = {"_PACKIT_COMPLETE": "complete_bash", "COMP_WORDS": line}
    code = "import sys; sys.argv = ['packit']; from packit_sim.__main__ import main; main()"
    run = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **env, "COMP_CWORD": str(len(words) - 1)},
        capture_output=True,
        check=True,
        text=True,
        timeout=60,
    )
    return run.stdout.split()


@pytest.mark.parametrize(
    ("line", "first"),
    [
        ("packit ev", "evaluate"),
        ("packit pack --obj", "--objective"),
        ("packit evaluate sta", "starter"),
        ("packit evaluate --agent largest-first/aligned/bl", "largest-first/aligned/blbf"),
        ("packit evaluate --agent random/aligned/blbf+bea", "random/aligned/blbf+beam="),
        ("packit nest cut-cube-8", "cut-cube-8"),
    ],
)
def test_the_shell_completes(line: str, first: str) -> None:
    assert completed(line)[0] == first


@pytest.mark.parametrize("is_terminal", [True, False])
def test_only_a_terminal_gets_progress(is_terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = io.StringIO()
    console = terminal.PlainConsole(file=shown, force_terminal=is_terminal, width=80)
    monkeypatch.setattr(terminal, "console", console)
    with terminal.progress_bars() as progress:
        progress.update(progress.add_task("packing", total=2, note="2 parts"), advance=2)
    assert ("2 parts" in shown.getvalue()) is is_terminal


def test_a_bar_counts_kernels_while_they_are_compiled() -> None:
    column, task = compilation_bar.NoteColumn(), SimpleNamespace(fields={"note": "2 parts"})
    assert column.render(task).plain == "2 parts"
    shown: list[str] = []

    class Compiling(event.Listener):
        def on_start(self, event: object) -> None:
            shown.append(column.render(task).plain)

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Compiling()):
        numba.njit(lambda x: x)(2)
    assert re.fullmatch(r"compiling, once: [━╌]{10} \d+ of at most \d+", shown[0])
    assert column.render(task).plain == "2 parts"


def test_intervals_are_in_brackets() -> None:
    console = terminal.PlainConsole(file=io.StringIO(), width=80)
    with console.capture() as shown:
        console.print(evaluations.interval(Estimate(0.5, 0.25, 0.75), ".3f", ".2f"))
    assert shown.get().split("\n")[:2] == ["0.500", "[0.25 0.75]"]


@pytest.mark.parametrize("width", [30, 80, 400])
def test_intervals_fold_at_no_width(width: int) -> None:
    cell = evaluations.interval(Estimate(100, 99.25, 100), ".1f", ".2f")
    table = output.NumberTable("", *"abcdefgh")
    table.add_row("1", *[cell] * 8)
    console = terminal.PlainConsole(file=io.StringIO(), width=width)
    with console.capture() as shown:
        console.print(table)
    assert shown.get().count("[99.25 100.00]") == 8
    assert max(map(len, shown.get().split("\n"))) <= width


def test_long_examples_can_be_copied() -> None:
    shown = packit("evaluate", "--help").stdout.replace(" \\\n      ", " ")
    assert "--split test --agent largest-first/aligned/blbf\n" in shown


FROZEN = """
import gc
from packit_sim.core.whole_imports import let_imports_end
let_imports_end()
import json
before = gc.get_freeze_count()
import trimesh
print(before, gc.get_freeze_count() > 10_000, gc.isenabled())
gc.disable()
import numba
print(gc.isenabled())
"""


def test_what_many_modules_created_is_excluded_from_garbage_collections() -> None:
    run = subprocess.run([sys.executable, "-c", FROZEN], capture_output=True, check=True, text=True)
    assert run.stdout == "0 True True\nFalse\n"
