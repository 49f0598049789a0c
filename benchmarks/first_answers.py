"""Measure how soon `packit pack` shows a first packing in a terminal, and the memory it takes.

    .venv/bin/python -m benchmarks.first_answers

The parts are STL files of random library shapes, no two the same: eight with a quarter of the box's
volume, and 200 with 1.2 times as much. The command ends by Ctrl-C as soon as it shows a packing,
which it then writes. Each case runs once before, so that kernels and bytecode are compiled.
Processor seconds depend less than seconds on what else the machine does. Writes
`benchmarks/results/first_answers.json`, and the table of `docs/benchmarks/parts.md`.
"""

from __future__ import annotations

import os
import pty
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
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
from benchmarks.packing_parts import LIBRARY, PAGE, SIZES, UNIT_MM, parts_of, selection
from packit_sim import ShapeLibrary
from packit_sim.geometry.lattice import CELL

FILE = "first_answers.json"

BLOCK = "first answers"
"""Between these comments the page has the table."""

CASES = {8: 0.25, 200: 1.2}
"""The volume of all parts relative to the box's, by their number."""

BOX = SIZES[0]

SHOWN = re.compile(rb"(\d+) of \d+ parts")
"""What the progress says of a packing."""

MEGABYTE = 1e6

Run = Mapping[str, float]


def write_parts(count: int, folder: Path) -> None:
    """Write the STL files of a case into a folder."""
    library = ShapeLibrary.open(LIBRARY)
    task = selection(library, seed=count, cells=BOX, count=count, volume=CASES[count])
    for part in parts_of(task):
        part.mesh.export(folder / f"{part.name}.stl")


def measure(command: Sequence[str]) -> Run:
    """Run a command in a terminal of its own, and end it when it shows a packing.

    Parameters
    ----------
    command : Sequence[str]
        A command that shows its progress.

    Returns
    -------
    dict
        Seconds and processor seconds until the packing was shown and until the command ended, the
        number of its parts, and the most resident memory in megabytes. Linux counts what this
        process had when it started the command, so the memory may be less.

    Raises
    ------
    RuntimeError
        If the command ends without a packing.
    """
    started = time.perf_counter()
    terminal, end = pty.openpty()
    env = {**os.environ, "TERM": "xterm", "COLUMNS": "200"}
    env.pop("PYTHONDONTWRITEBYTECODE", None)
    child = subprocess.Popen(command, stdin=end, stdout=end, stderr=end, env=env)
    os.close(end)
    text, shown, used_until, parts = b"", 0.0, 0.0, 0
    while more := _read(terminal):
        text += more
        if not shown and (found := SHOWN.search(text)):
            shown, parts = time.perf_counter() - started, int(found[1])
            used_until = _processor_seconds(child.pid)
            child.send_signal(signal.SIGINT)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    os.close(terminal)
    if not shown or child.returncode:
        raise RuntimeError(text.decode(errors="replace"))
    return {
        "shown": round(shown, 2),
        "processor until shown": round(used_until, 2),
        "parts": parts,
        "ended": round(time.perf_counter() - started, 2),
        "processor": round(used.ru_utime + used.ru_stime, 2),
        "memory": round(used.ru_maxrss * 1024 / MEGABYTE),
    }


def _processor_seconds(process: int) -> float:
    """Return the processor seconds of a process that runs, by Linux."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 65536)
    except OSError:  # Linux, when the other end is closed
        return b""


def table(runs: Mapping[str, Sequence[Run]]) -> str:
    """Tabulate the medians in Markdown."""
    rows = []
    for count, own in runs.items():
        low, *_, high = sorted(run["shown"] for run in own)
        median = {name: statistics.median(run[name] for run in own) for name in own[0]}
        rows.append(
            (
                count,
                len(own),
                f"{median['shown']:.1f} ({low:.1f} to {high:.1f})",
                f"{median['processor until shown']:.1f}",
                f"{median['parts']:g}",
                f"{median['ended']:.1f}",
                f"{max(run['memory'] for run in own):.0f}",
            )
        )
    head = ("parts", "runs", "seconds to the first packing (range)", "processor seconds to it")
    return markdown_table((*head, "parts in it", "seconds to its files", "most memory, MB"), rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--repeats", type=int, default=5, help="runs of each case")
    arguments = parser.parse_args()
    box = "x".join(f"{side * CELL * UNIT_MM:g}" for side in BOX) + "mm"
    runs: dict[str, list[Run]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for count in CASES:
            parts = Path(folder) / str(count)
            parts.mkdir()
            write_parts(count, parts)
            command = [sys.executable, "-m", "packit_sim", "pack", str(parts), "--box", box]
            own = [
                measure([*command, "--time", "600", "--out", f"{folder}/{count}-{number}"])
                for number in range(arguments.repeats + 1)
            ]
            runs[str(count)] = own[1:]
    result: dict[str, Any] = {"command": "python -m benchmarks.first_answers"}
    write_json(arguments.out / FILE, {**result, "machine": machine(), "runs": runs})
    if arguments.out == RESULTS:
        write_into_page(PAGE, table(runs), BLOCK)
    print(table(runs))


if __name__ == "__main__":
    main()
