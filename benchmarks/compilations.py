"""Measure what numba compiles before `packit pack` shows a packing and before `packit demo` plays.

    .venv/bin/python -m benchmarks.compilations

Each command is a fresh process with an empty cache of kernels; it ends at that moment. Counted is
the processor time of the thread that compiles, of each kernel without the others that it calls. It
takes minutes. Writes `benchmarks/results/compilations.json` and the table of
`docs/benchmarks/speed.md`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
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
from benchmarks.first_answers import BOX, write_parts
from benchmarks.packing_parts import UNIT_MM
from benchmarks.starts import PAGE
from packit_sim.geometry.lattice import CELL

FILE = "compilations.json"

BLOCK = "compilations"
"""Between these comments the page has the table."""

PARTS = 8

SHOWN = 12
"""Kernels in the table, those that take longest."""

CHILD = """
import json, os, sys, threading, time
from collections import defaultdict
from numba.core import event
import packit_sim
from packit_sim.cli import evaluations
from packit_sim.cli.app import main
file = sys.argv.pop(1)
found, threads = defaultdict(lambda: [0, 0.0]), threading.local()
class Times(event.Listener):
    def on_start(self, event):
        threads.open = getattr(threads, "open", []) + [[time.thread_time(), 0.0]]
    def on_end(self, event):
        start, inner = threads.open.pop()
        took = time.thread_time() - start
        if threads.open:
            threads.open[-1][1] += took
        function = event.data["dispatcher"].py_func
        kernel = found[f"{function.__module__}.{function.__name__}"]
        kernel[0] += 1
        kernel[1] += took - inner
event.register("numba:compile", Times())
def end(*arguments, **options):
    with open(file, "w") as opened:
        json.dump({"processor": time.process_time(), "kernels": found}, opened)
    os._exit(0)
def pack(*arguments, **options):
    *rest, callback, settings, progress = arguments
    return own(*rest, end, settings, progress, **options)
own, packit_sim.pack, evaluations.evaluate_shown = packit_sim.pack, pack, end
main()
"""
"""Runs a command to that moment, and writes the times to a file."""


def measure(words: list[str], cache: Path) -> dict[str, Any]:
    """Run a command with an empty cache.

    Returns
    -------
    dict
        Processor seconds of the process, and of each kernel how often it was compiled and how many
        it took.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "times.json"
        env = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
        subprocess.run([sys.executable, "-c", CHILD, str(file), *words], env=env, check=True)
        found: dict[str, Any] = json.loads(file.read_text())
    return found


def table(found: dict[str, dict[str, Any]]) -> str:
    """Tabulate the kernels in Markdown."""
    rows = []
    for command, one in found.items():
        slowest = sorted(one["kernels"].items(), key=lambda each: -each[1][1])
        own = {name: kernel for name, kernel in slowest if name.startswith("packit_")}
        ranked = list(own)
        rest = [own[name] for name in ranked[SHOWN:]]
        others = [kernel for name, kernel in one["kernels"].items() if name not in own]
        listed = [(f"`{'.'.join(n.split('.')[-2:])}`", *own[n]) for n in ranked[:SHOWN]]
        listed += [(f"{len(rest)} others", sum(n for n, _ in rest), sum(s for _, s in rest))]
        listed += [("numba's own", sum(n for n, _ in others), sum(s for _, s in others))]
        every = one["kernels"].values()
        listed += [("all", sum(n for n, _ in every), sum(s for _, s in every))]
        rows += [(f"`{command}`", name, count, f"{seconds:.1f}") for name, count, seconds in listed]
    return markdown_table(("command", "kernel", "compilations", "core-seconds"), rows)


def main() -> None:
    """Measure both commands, and tabulate them."""
    parser = argument_parser(__doc__)
    parser.add_argument("--cache", type=Path, help="empty folder that keeps the machine code")
    arguments = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        parts = Path(folder) / "parts"
        parts.mkdir()
        write_parts(PARTS, parts)
        box = "x".join(f"{side * CELL * UNIT_MM:g}" for side in BOX) + "mm"
        options = ("--box", box, "--time", "600", "--out", f"{folder}/packed")
        commands = {
            "packit pack": ["pack", str(parts), *options],
            "packit demo": ["demo", "--out", f"{folder}/demo"],
        }
        for name, words in commands.items():
            cache = (arguments.cache or Path(folder)) / name.split()[1]
            found[name] = measure(words, cache)
            result = {"command": "python -m benchmarks.compilations", "machine": machine()}
            write_json(arguments.out / FILE, {**result, "found": found})
    if arguments.out == RESULTS:
        write_into_page(PAGE, table(found), BLOCK)
    print(table(found))


if __name__ == "__main__":
    main()
