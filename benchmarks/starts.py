"""Measure what `packit` costs before it works: processor seconds and modules of `--help`.

    .venv/bin/python -m benchmarks.starts --code ../before --label before
    .venv/bin/python -m benchmarks.starts

Each run is a fresh process with compiled bytecode, after one that is not counted. The processor
time is that of the whole process; the least depends least on what else the machine does.
Modules are those that were executed, by `-X importtime`, together with Python's own. `--code`
measures the code in another folder. Writes `benchmarks/results/starts.json` and the table of
`docs/benchmarks/speed.md`.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.common import (
    RESULTS,
    argument_parser,
    machine,
    markdown_table,
    write_into_page,
    write_json,
)

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


def measure(words: list[str], code: Path, runs: int) -> dict[str, Any]:
    """Run a command several times.

    Returns
    -------
    dict
        The processor seconds of each run, and the number of modules.
    """
    env = {**os.environ, "PYTHONPATH": f"{code}{os.pathsep}{code / 'agents'}"}
    env.pop("PYTHONDONTWRITEBYTECODE", None)

    def run(*options: str) -> str:
        command = [sys.executable, *options, "-m", "packit_sim", *words]
        return subprocess.run(
            command, cwd=code, env=env, capture_output=True, text=True, check=True
        ).stderr

    modules = run("-X", "importtime").count("\nimport time:")
    seconds = []
    for _ in range(runs):
        before = os.times()
        run()
        after = os.times()
        used = sum(after[2:4]) - sum(before[2:4])
        seconds.append(round(used, 3))
    return {"processor": seconds, "modules": modules}


def table(labels: dict[str, dict[str, Any]]) -> str:
    """Tabulate the results in Markdown, a row for each command."""
    head = ["command"]
    for label in labels:
        head += [f"{label}: processor seconds, least (median)", "modules"]
    rows = []
    for command in COMMANDS:
        row = [f"`packit {command}`"]
        for found in labels.values():
            seconds = found[command]["processor"]
            row.append(f"{min(seconds):.2f} ({statistics.median(seconds):.2f})")
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
    labels: dict[str, Any] = json.loads(file.read_text())["labels"] if file.exists() else {}
    labels[arguments.label] = {
        command: measure(command.split(), arguments.code.resolve(), arguments.runs)
        for command in COMMANDS
    }
    head = {"command": "python -m benchmarks.starts", "machine": machine()}
    write_json(file, {**head, "labels": labels})
    if arguments.out == RESULTS:
        write_into_page(PAGE, table(labels), BLOCK)
    print(table(labels))


if __name__ == "__main__":
    main()
