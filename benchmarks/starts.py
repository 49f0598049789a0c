"""Measure what `packit` costs before it works: processor seconds, instructions and modules.

    .venv/bin/python -m benchmarks.starts --code ../before --label before
    .venv/bin/python -m benchmarks.starts

Each run is a fresh process with compiled bytecode, after one that is not counted. The processor
time is that of the whole process; the least depends least on what else the machine does.
Instructions are counted by Valgrind's callgrind, where it is installed; two counts differ by less
than a thousandth.
Modules are those that were executed, by `-X importtime`, together with Python's own. Of the help of
each other command, a third as many runs are measured. `--code` measures the code in another folder,
without those; if its entry points are not the installed ones, the `.dist-info` of its wheel must be
in that folder. Instructions come last, and each count is stored when it is known. Writes
`benchmarks/results/starts.json` and the table of `docs/benchmarks/speed.md`.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from typer.main import get_command

from benchmarks.common import (
    RESULTS,
    argument_parser,
    machine,
    markdown_table,
    write_into_page,
    write_json,
)
from packit_sim.cli.app import app

FILE = "starts.json"

BLOCK = "starts"
"""Between these comments the page has the table."""

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "speed.md"

COMMANDS = (
    "--version",
    "--help",
    "pack --help",
    "evaluate --help",
    "shapes import --help",
    "train --help",
)

LABEL = "now"

CALLGRIND = ("valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null")
"""Runs a command, and prints the number of its instructions to stderr."""


def run(
    words: list[str], code: Path, options: Sequence[str] = (), within: Sequence[str] = ()
) -> str:
    """Run a command of the code in a fresh process, and return what it printed to stderr."""
    env = {**os.environ, "PYTHONPATH": f"{code}{os.pathsep}{code / 'agents'}"}
    env.pop("PYTHONDONTWRITEBYTECODE", None)
    command = [*within, sys.executable, *options, "-m", "packit_sim", *words]
    return subprocess.run(
        command, cwd=code, env=env, capture_output=True, text=True, check=True
    ).stderr


def measure(words: list[str], code: Path, runs: int) -> dict[str, Any]:
    """Run a command several times, and return its processor seconds and its number of modules."""
    modules = run(words, code, ("-X", "importtime")).count("\nimport time:")
    seconds = []
    for _ in range(runs):
        before = os.times()
        run(words, code)
        after = os.times()
        used = sum(after[2:4]) - sum(before[2:4])
        seconds.append(round(used, 3))
    return {"processor": seconds, "modules": modules}


def count(words: list[str], code: Path) -> int:
    """Count the instructions of a command."""
    collected = re.search(r"Collected : (\d+)", run(words, code, within=CALLGRIND))
    assert collected is not None
    return int(collected[1])


def every_help(group: Any = None, name: str = "") -> list[str]:
    """List the helps of all commands and groups, such as "shapes import --help"."""
    group = group or get_command(app)
    found = [f"{name} --help".strip()]
    for own, command in group.commands.items():
        words = f"{name} {own}".strip()
        found += every_help(command, words) if hasattr(command, "commands") else [f"{words} --help"]
    return found


def text(labels: dict[str, dict[str, Any]], helps: dict[str, list[float]]) -> str:
    """Write the table, and a sentence on the helps of all commands, by their processor seconds."""
    slowest = max(helps, key=lambda each: min(helps[each]))
    return (
        f"{table(labels)}\nOf all {len(helps)} helps, the slowest is `packit {slowest}`: "
        f"{min(helps[slowest]):.2f} s.\n"
    )


def table(labels: dict[str, dict[str, Any]]) -> str:
    """Tabulate the results in Markdown, a row for each command."""
    head = ["command"]
    for label in labels:
        head += [f"{label}: processor seconds, least (median)", "million instructions", "modules"]
    rows = []
    for command in COMMANDS:
        row = [f"`packit {command}`"]
        for found in labels.values():
            seconds = found[command]["processor"]
            row.append(f"{min(seconds):.2f} ({statistics.median(seconds):.2f})")
            instructions = found[command].get("instructions")
            row.append("" if instructions is None else f"{instructions / 1e6:,.0f}")
            row.append(str(found[command]["modules"]))
        rows.append(row)
    return markdown_table(head, rows)


def main() -> None:
    """Measure one code, and tabulate it with the others that were measured."""
    parser = argument_parser(__doc__)
    parser.add_argument("--runs", type=int, default=9, help="counted runs of each command")
    parser.add_argument("--code", type=Path, default=Path.cwd(), help="root folder of the code")
    parser.add_argument("--label", default=LABEL, help="the name of the code in the table")
    arguments = parser.parse_args()
    file: Path = arguments.out / FILE
    before = json.loads(file.read_text()) if file.exists() else {}
    labels: dict[str, Any] = before.get("labels", {})
    helps: dict[str, list[float]] = before.get("helps", {})
    code = arguments.code.resolve()
    labels[arguments.label] = {
        command: measure(command.split(), code, arguments.runs) for command in COMMANDS
    }
    if code == Path.cwd():
        few = -(-arguments.runs // 3)
        helps = {each: measure(each.split(), code, few)["processor"] for each in every_help()}
    head = {"command": "python -m benchmarks.starts", "machine": machine()}

    def store() -> None:
        write_json(file, {**head, "labels": labels, "helps": helps})
        if arguments.out == RESULTS:
            write_into_page(PAGE, text(labels, helps), BLOCK)

    store()
    for command in COMMANDS if shutil.which(CALLGRIND[0]) else ():
        labels[arguments.label][command]["instructions"] = count(command.split(), code)
        store()
    print(text(labels, helps))


if __name__ == "__main__":
    main()
