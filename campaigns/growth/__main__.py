"""Growth: whether the work of every reader grows as its file does, no faster.

Each repetition that a format allows is doubled again and again. Those whose CPU time may grow
faster than the file are counted: the instructions of reading three files, by Valgrind. `--reader`
chooses some readers; `--every` counts all of their repetitions, which takes far longer; `--resume`
continues: it screens readers that have no results, and counts what is not counted yet.
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
from typing import Any

from benchmarks.common import machine, write_json
from campaigns.common import ROOT, argument_parser, read_results
from campaigns.fuzzing.readers import READERS
from campaigns.growth.counting import NO_VALGRIND, Counter, command, is_installed
from campaigns.growth.kinds import kinds
from campaigns.growth.repetition import LONGEST, Repetition
from campaigns.growth.screening import SUSPICIOUS, screened
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
    """Screen and count, and write the results after each reader."""
    parser = argument_parser(__doc__)
    parser.add_argument("--reader", nargs="+", default=["all"], choices=("all", *READERS))
    parser.add_argument("--every", action="store_true", help="count what the screening clears, too")
    parser.add_argument("--resume", action="store_true", help="keep what the results have")
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
    known = read_results(NAME, arguments.out).get("readers", {}) if arguments.resume else {}
    screen([name for name in names if name not in known], arguments.out, arguments.every)
    results = read_results(NAME, arguments.out)["readers"]
    names = [
        name for name in names if set(results[name]["suspects"]) - set(results[name]["counted"])
    ]
    if not names:
        return
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


def screen(names: Iterable[str], out: Path, every: bool = False) -> None:
    """Measure the CPU times of some readers, and write what is to be counted."""
    for name in names:
        reader, found = READERS[name], kinds(READERS[name])
        with suppress(Exception):  # of a file that is refused
            reader.read(found[0].write(1))
        exponents = {one.name: screened(reader.read, one) for one in found}
        suspects = [what for what, e in exponents.items() if every or e > SUSPICIOUS]
        cleared = [e for what, e in exponents.items() if what not in suspects]
        row = {"kinds": len(found), "largest": round(max(cleared, default=0.0), 2)}
        _write(name, row | {"suspects": suspects, "counted": {}}, out)
        print(f"{name:20} {len(found):4} kinds {len(suspects):4} suspects", flush=True)


def count(names: Iterable[str], logs: Path, out: Path) -> None:
    """Count the instructions of the suspects of some readers, inside Valgrind."""
    kinds_of = {name: kinds(READERS[name]) for name in names}  # before all becomes slow
    counter = Counter(logs)
    for name, found in kinds_of.items():
        reader, row = READERS[name], read_results(NAME, out)["readers"][name]
        with suppress(Exception):  # of a file that is refused
            reader.read(found[0].write(1))
        for one in found:
            if one.name not in row["suspects"] or one.name in row["counted"]:
                continue
            exponent = growth(counter, reader.read, one)
            row["counted"][one.name] = str(exponent) if math.isinf(exponent) else round(exponent, 2)
            if exponent > LARGEST:
                print(f"{name}: {one.name}: exponent {exponent:.2f}", flush=True)
            _write(name, row, out)
        print(f"{name:20} {len(row['counted']):4} counted", flush=True)


def _write(name: str, row: dict[str, Any], out: Path) -> None:
    results = read_results(NAME, out) or {"readers": {}}
    results |= {"version": __version__, "machine": machine(), "bytes": LONGEST}
    results |= {"bound": LARGEST, "suspicious": SUSPICIOUS}
    results["readers"][name] = row
    write_json(out / f"{NAME}.json", results)


def growth(counter: Counter, read: Callable[[bytes], object], one: Repetition) -> float:
    """Return the exponent with which work grows between the two largest files of a repetition.

    It is that of the instructions which each doubling adds: what a file of any size takes does not
    count. The files are large, so that a table that grows adds little, while work that grows as a
    square shows itself. Where they are not read to their end within the limit, smaller ones are
    counted. Infinite if these are not read to their end either.
    """
    large = _exponent(counter, read, one, 8 * one.most)
    return large if math.isfinite(large) else _exponent(counter, read, one, one.most)


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
