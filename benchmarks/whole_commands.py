"""Measure `packit pack` from the command to its last file, for 8 to 500 different parts.

    .venv/bin/python -m benchmarks.whole_commands

The parts are STL files of library shapes of 20 to 60 mm, by seed, no two the same. Each case runs
with `--time 30s`. The wall time depends on what else the machine does; the processor time hardly
does. The steps' times are those that `pack` announces. `--code` measures the code in another
folder, without steps, for a comparison (`--label`). Each result is added to
`benchmarks/results/whole_commands.json`; writes the table of `docs/benchmarks/parts.md`.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import (
    RESULTS,
    argument_parser,
    machine,
    markdown_table,
    write_into_page,
    write_json,
)
from benchmarks.packing_parts import LIBRARY, PAGE
from packit_sim import ShapeLibrary

FILE = "whole_commands.json"

BLOCK = "whole commands"
"""Between these comments the page has the table."""

CASES = {8: 100, 50: 150, 200: 225, 500: 300}
"""The side of the cubic box in mm, by the number of parts."""

SIZES_MM = 20.0, 60.0

SECONDS = 30

LIMIT = 1200.0
"""Seconds after which a command counts as not ended."""

LABEL = "now"

STEPS = ("reading", "preparing", "packing", "checking", "writing")

CHILD = """
import json, sys, time
import packit_sim
from packit_sim.cli.app import main
steps, last = {}, ["reading", time.perf_counter()]
def timed(*arguments, **options):
    *rest, show = arguments
    def seen(step, done, total):
        now, name = time.perf_counter(), step.split()[0]
        steps[last[0]] = steps.get(last[0], 0.0) + now - last[1]
        last[:] = name, now
        show(step, done, total)
    return own(*rest, seen, **options)
own, packit_sim.pack = packit_sim.pack, timed
try:
    main()
finally:
    open(sys.argv[-1] + ".steps", "w").write(json.dumps(steps))
"""
"""The command, with the seconds of each step written to a file."""


def write_parts(count: int, folder: Path) -> None:
    """Write the STL files of a case into a folder: the first shapes in a random order."""
    library = ShapeLibrary.open(LIBRARY)
    rng = np.random.default_rng(1)
    ids = sorted(library)
    rng.shuffle(ids)
    for id in ids[:count]:
        mesh = library[id].mesh.copy()
        mesh.apply_scale(rng.uniform(*SIZES_MM) / max(mesh.extents))
        mesh.export(folder / f"{id.replace('/', '_')}.stl")


def measure(count: int, parts: Path, out: Path, code: Path | None) -> dict[str, Any]:
    """Run the command once.

    Returns
    -------
    dict
        Seconds of the wall and of the processor, the exit code (None: stopped after `LIMIT`), the
        number of packed parts, and the seconds of each step.
    """
    side = CASES[count]
    arguments = [str(parts), "--box", f"{side}x{side}x{side}mm", "--time", f"{SECONDS}s"]
    start = ["-m", "packit_sim"] if code else ["-c", CHILD]
    command = [sys.executable, *start, "pack", *arguments, "--out", str(out)]
    env = {**os.environ, **({"PYTHONPATH": str(code)} if code else {})}
    before = os.times()
    started = time.perf_counter()
    try:
        ended: int | None = subprocess.run(
            command, cwd=code, env=env, capture_output=True, timeout=LIMIT, check=False
        ).returncode
    except subprocess.TimeoutExpired:
        ended = None
    wall, after = time.perf_counter() - started, os.times()
    record, steps = out / "packing.json", out.with_name(f"{out.name}.steps")
    return {
        "seconds": round(wall, 1),
        "processor": round(sum(after[2:4]) - sum(before[2:4]), 1),
        "exit code": ended,
        "packed": len(json.loads(record.read_text())["items"]) if record.exists() else 0,
        "files": len(list(out.glob("packing.*"))),
        "steps": json.loads(steps.read_text()) if steps.exists() else {},
    }


def table(runs: Mapping[str, Mapping[str, Sequence[Mapping[str, Any]]]]) -> str:
    """Tabulate the medians in Markdown, a row for each number of parts and code."""
    rows = []
    for count, labels in runs.items():
        for label, own in labels.items():
            row: list[Any] = [count, label, len(own)]
            row += [
                f"{statistics.median(run[key] for run in own):.0f}"
                for key in ("seconds", "processor")
            ]
            for step in STEPS:
                known = [run["steps"][step] for run in own if step in run["steps"]]
                row.append(f"{statistics.median(known):.1f}" if known else "-")
            codes = sorted({str(run["exit code"]) for run in own})
            row += [", ".join(codes), f"{statistics.median(run['packed'] for run in own):g}"]
            rows.append(row)
    head = ("parts", "code", "runs", "seconds", "processor seconds", *STEPS, "exit code", "packed")
    return markdown_table(head, rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--parts", type=int, nargs="*", default=list(CASES), help="which cases")
    parser.add_argument("--repeats", type=int, default=1, help="runs of each case")
    parser.add_argument("--code", type=Path, help="root folder of other code to measure")
    parser.add_argument("--label", default=LABEL, help="the name of the code in the table")
    arguments = parser.parse_args()
    file: Path = arguments.out / FILE
    runs: dict[str, Any] = json.loads(file.read_text())["runs"] if file.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        for count in arguments.parts:
            parts = Path(folder) / str(count)
            parts.mkdir()
            write_parts(count, parts)
            for number in range(arguments.repeats):
                found = measure(count, parts, Path(folder) / f"{count}-{number}", arguments.code)
                runs.setdefault(str(count), {}).setdefault(arguments.label, []).append(found)
                print(count, arguments.label, found, flush=True)
                head = {"command": "python -m benchmarks.whole_commands", "machine": machine()}
                write_json(file, {**head, "runs": runs})
    if arguments.out == RESULTS:
        write_into_page(PAGE, table(runs), BLOCK)
    print(table(runs))


if __name__ == "__main__":
    main()
