"""Measure time and memory of `packit pack` for large meshes, many equal parts, and many meshes.

    .venv/bin/python -m benchmarks.large_packings

Each case is one command with `--time 5s` in a separate process. Peak memory is that of the process
alone. Writes `benchmarks/results/large_packings.json` and the table of `docs/trust/security.md`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from trimesh import creation

from benchmarks.common import (
    RESULTS,
    argument_parser,
    machine,
    markdown_table,
    write_into_page,
    write_json,
)

PAGE = Path(__file__).parents[1] / "docs" / "trust" / "security.md"

BLOCK = "large packings"
"""Between these comments the page has the table."""

FILE = "large_packings.json"

SIDE = "400x400x400mm"


def _ball(subdivisions: int, count: int, folder: Path) -> str:
    creation.icosphere(subdivisions=subdivisions, radius=10).export(folder / "ball.stl")
    return f"{folder / 'ball.stl'}={count}"


def _different(count: int, folder: Path) -> str:
    for n in range(count):
        sides = (10 + n % 37 / 4, 10 + n % 41 / 4, 10 + n % 43 / 4)
        creation.box(sides).export(folder / f"{n}.stl")
    return str(folder)


CASES: dict[str, Callable[[Path], str]] = {
    "2 copies of 1.3 million triangles": partial(_ball, 8, 2),
    "2 copies of 5.2 million triangles": partial(_ball, 9, 2),
    "2,000 equal parts of 320 triangles": partial(_ball, 2, 2000),
    "1,000 different boxes": partial(_different, 1000),
}


def measure(write: Callable[[Path], str]) -> dict[str, Any]:
    """Run a case; return its seconds, processor seconds, peak bytes and exit code."""
    with tempfile.TemporaryDirectory() as folder:
        parts = Path(folder, "parts")
        parts.mkdir()
        with ProcessPoolExecutor(1) as other:  # a child begins with the peak of its parent
            given = other.submit(write, parts).result()
        options = ["--box", SIDE, "--time", "5s", "--out", str(Path(folder, "out"))]
        command = [sys.executable, "-m", "packit_sim", "pack", given, *options]
        started = time.perf_counter()
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        return {
            "seconds": round(time.perf_counter() - started, 1),
            "processor": round(used.ru_utime + used.ru_stime, 1),
            "memory": used.ru_maxrss * 1024,
            "exit code": child.returncode,
        }


def table(runs: Mapping[str, Mapping[str, Any]]) -> str:
    """Tabulate the cases in Markdown."""
    rows = [
        (
            name,
            f"{run['seconds']:.0f}",
            f"{run['processor']:.0f}",
            f"{run['memory'] / 2**30:.1f}",
            "refused" if run["exit code"] == 2 else run["exit code"],
        )
        for name, run in runs.items()
    ]
    return markdown_table(("parts", "seconds", "processor seconds", "GiB", "exit code"), rows)


def main() -> None:
    arguments = argument_parser(__doc__).parse_args()
    runs = {}
    for name, write in CASES.items():
        runs[name] = measure(write)
        print(name, runs[name], flush=True)
    head = {"command": "python -m benchmarks.large_packings", "machine": machine()}
    write_json(arguments.out / FILE, {**head, "runs": runs})
    if arguments.out == RESULTS:
        write_into_page(PAGE, table(runs), BLOCK)


if __name__ == "__main__":
    main()
