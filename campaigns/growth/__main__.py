"""Growth: whether the work of every reader grows as its file does, no faster.

Each repetition that a format allows is doubled twice, and the instructions of reading the three
files are counted. Needs Valgrind, and a few hours for all readers; `--reader` chooses some.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path

from benchmarks.common import machine, write_json
from campaigns.common import ROOT, argument_parser, read_results
from campaigns.fuzzing.readers import READERS
from campaigns.growth.counting import NO_VALGRIND, Counter, command, is_installed
from campaigns.growth.kinds import kinds
from campaigns.growth.repetition import LONGEST, Repetition
from campaigns.growth.table import NAME, write_table
from packit_sim.core.version import __version__

LARGEST = 1.3
"""Largest exponent of linear work: sorting and tables that grow have up to 1.2 at these sizes."""

FEW = 200_000
"""Instructions by which two files must differ: less is no growth that one could measure."""

_FIXED = {
    "PYTHONHASHSEED": "0",
    "NUMBA_CPU_NAME": "haswell",  # without AVX-512, which Valgrind does not know
    "NUMBA_CPU_FEATURES": "+avx2,+fma",
    "NUMBA_CACHE_DIR": str(ROOT / "build" / "growth"),
}
"""The environment in which two runs count the same, and Valgrind finds compiled kernels."""


def main() -> None:
    """Count, and write the results after each reader."""
    parser = argument_parser(__doc__)
    parser.add_argument("--reader", nargs="+", default=["all"], choices=("all", *READERS))
    parser.add_argument("--logs", type=Path, help="used by the campaign itself, inside Valgrind")
    arguments = parser.parse_args()
    if arguments.table:
        write_table()
        return
    names = list(READERS) if "all" in arguments.reader else arguments.reader
    if arguments.logs is not None:
        count(names, arguments.logs, arguments.out)
        return
    if not is_installed():
        sys.exit(NO_VALGRIND)
    environment = os.environ | _FIXED
    compiling = "from campaigns.growth.__main__ import compile_kernels; compile_kernels()"
    subprocess.run([sys.executable, "-c", compiling], env=environment, cwd=ROOT, check=True)
    with tempfile.TemporaryDirectory() as logs:
        own = ["-m", "campaigns.growth", "--reader", *names, "--logs", logs]
        run = command([*own, "--out", str(arguments.out)], Path(logs))
        subprocess.run(run, env=environment, cwd=ROOT, check=True)


def compile_kernels() -> None:
    """Read small files with all readers, so that kernels are compiled outside Valgrind."""
    for reader in READERS.values():
        kinds(reader)


def count(names: Iterable[str], logs: Path, out: Path) -> None:
    """Count the instructions of some readers, inside Valgrind."""
    kinds_of = {name: kinds(READERS[name]) for name in names}  # before all becomes slow
    counter = Counter(logs)
    for name, found in kinds_of.items():
        reader = READERS[name]
        with suppress(Exception):  # of a file that is refused
            reader.read(found[0].write(1))
        rows = []
        for one in found:
            exponent = growth(counter, reader.read, one)
            rows.append((one.name, exponent))
            if exponent > LARGEST:
                print(f"{name}: {one.name}: exponent {exponent:.2f}", flush=True)
        exponents = [exponent for _, exponent in rows]
        findings = [[what, round(e, 2)] for what, e in rows if e > LARGEST]
        results = read_results(NAME, out) or {"readers": {}}
        results |= {"version": __version__, "machine": machine(), "bytes": LONGEST}
        results["bound"] = LARGEST
        results["readers"][name] = {
            "kinds": len(rows),
            "largest": round(max((e for e in exponents if e <= LARGEST), default=0.0), 2),
            "findings": findings,
        }
        write_json(out / f"{NAME}.json", results)
        print(f"{name:20} {len(rows):4} kinds {len(findings)} findings", flush=True)


def growth(counter: Counter, read: Callable[[bytes], object], one: Repetition) -> float:
    """Return the exponent with which work grows between the two largest files of a repetition.

    It is that of the instructions which each doubling adds: what a file of any size takes does not
    count. Infinite if a file is not read to its end within the limit. What seems to grow too fast
    is counted again with files eight times as large: there a table that grows adds little, while
    work that grows as a square has shown itself.
    """
    first = _exponent(counter, read, one, one.most)
    return first if first <= LARGEST else _exponent(counter, read, one, 8 * one.most)


def _exponent(
    counter: Counter, read: Callable[[bytes], object], one: Repetition, most: int
) -> float:
    counts = [counter.count(partial(read, one.write(n))) for n in (most // 4, most // 2, most)]
    ended = [each for each in counts if each is not None]
    if len(ended) < len(counts):
        return math.inf
    small, middle, large = ended
    if large - middle < FEW:
        return 0.0
    return math.log2((large - middle) / max(middle - small, FEW / 2))


if __name__ == "__main__":
    main()
