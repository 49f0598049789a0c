"""Count the instructions of the placement engine's queries, by library, with callgrind.

    .venv/bin/python -m benchmarks.instructions    (needs valgrind; some minutes)

Counts have no noise. Each kind of work is repeated in one process, and its instructions are
assigned to the library that contains them; "kernels" are the engine's own compiled functions.
Prints a table, and writes `benchmarks/results/instructions.json`.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from argparse import SUPPRESS
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import PAIR_CACHES, argument_parser, write_json
from packit_sim import Box, Item, ShapeLibrary
from packit_sim.core import caches
from packit_sim.placement import MEETINGS_BEFORE_TABLE, collision_mesh

TIMES = 20
"""Repetitions of each kind of work."""

CPU = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx2,+bmi,+bmi2,+fma,+popcnt"}
"""The processor to compile kernels for: valgrind does not support AVX-512."""


class Work:
    """A box of everyday shapes, and items to query."""

    def __init__(self) -> None:
        library = ShapeLibrary.open("everyday")
        rng = np.random.default_rng(0)
        self.box = Box()
        while len(self.box.placed) < 12:
            item = self._item(library, rng)
            location = self.box.blbf(item)
            if location is not None:
                self.box.place(item, location)
        self.items = [self._item(library, rng) for _ in range(4)]

    def prepare(self) -> None:
        """Fill the caches again that earlier work has cleared."""
        for item in (*self.items, *(placed.item for placed in self.box.placed)):
            _ = item.voxels
            collision_mesh(item)
        for item in self.items:
            for _ in range(MEETINGS_BEFORE_TABLE + 2):
                self.box.feasible(item)

    def _item(self, library: ShapeLibrary, rng: np.random.Generator) -> Item:
        shape = library[library.ids[rng.integers(len(library.ids))]]
        return Item(shape, rng.uniform(0.4, 0.7) ** 3, int(rng.integers(24)))

    def nothing(self, item: Item) -> None:
        """No work."""

    def blbf(self, item: Item) -> None:
        """A BLBF query with cleared pair caches."""
        caches.clear("collisions")
        self.box.blbf(item)

    def cold_mask(self, item: Item) -> None:
        """A mask with cleared pair caches."""
        caches.clear(*PAIR_CACHES)
        self.box.feasible(item)

    def warm_mask(self, item: Item) -> None:
        """A mask with no-fit tables for all pairs."""
        self.box.feasible(item)

    def first(self, item: Item) -> None:
        """The voxels of a shape at a scale."""
        caches.clear("voxels", "turned voxels")
        _ = item.turned(0).voxels

    def turn(self, item: Item) -> None:
        """The voxels of a further rotation."""
        caches.clear("turned voxels")
        _ = item.voxels

    def place(self, item: Item) -> None:
        """An item placed and removed."""
        location = self.box.blbf(item)
        if location is not None:
            self.box.place(item, location)
            self.box.undo()


KINDS = ("nothing", "blbf", "cold_mask", "warm_mask", "first", "turn", "place")
"""Kinds of work, in the order of measurement; the count of "nothing" is subtracted."""


def work(times: int) -> None:
    """Do all work in the counted process; write and reset the counts around each kind."""
    prepared = Work()
    for kind in KINDS:
        prepared.prepare()
        _write_counts()
        do: Callable[[Item], None] = getattr(prepared, kind)
        for n in range(times):
            do(prepared.items[n % len(prepared.items)])
        _write_counts()


def _write_counts() -> None:
    command = ["callgrind_control", "--dump", str(os.getpid())]
    os.waitpid(os.posix_spawnp(command[0], command, os.environ, file_actions=_QUIET), 0)


_QUIET = [(os.POSIX_SPAWN_OPEN, fd, os.devnull, os.O_WRONLY, 0) for fd in (1, 2)]


def count_instructions(times: int) -> dict[str, Counter[str]]:
    """Count the instructions of each kind of work by library."""
    child = [sys.executable, "-m", "benchmarks.instructions", "--work", "--times", str(times)]
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | CPU | {"NUMBA_CACHE_DIR": folder, "PYTHONHASHSEED": "0"}
        subprocess.run(child, env=environment, check=True)  # compiles
        out = Path(folder) / "callgrind.out"
        valgrind = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={out}"]
        subprocess.run([*valgrind, *child], env=environment, check=True, capture_output=True)
        dumps = [out.with_name(f"{out.name}.{2 * n + 2}") for n in range(len(KINDS))]
        return {kind: by_library(dump.read_text()) for kind, dump in zip(KINDS, dumps, strict=True)}


def by_library(profile: str) -> Counter[str]:
    """Sum up the self costs in callgrind's file by the short name of the object file."""
    names: dict[str, str] = {}
    costs: Counter[str] = Counter()
    library = ""
    inclusive = False
    for line in profile.splitlines():
        if named := re.match(r"ob=(\(\d+\))(?: (.*))?", line):
            number, path = named.groups()
            if path:
                names[number] = _short(path)
            library = names[number]
        elif named := re.match(r"cob=(\(\d+\)) (.*)", line):
            names[named[1]] = _short(named[2])
        elif line.startswith("calls="):
            inclusive = True
        elif re.match(r"[\d+*-]", line):
            if not inclusive:
                costs[library] += int([*line.split(), "0"][1])  # a cost of 0 is left out
            inclusive = False
    return costs


def _short(path: str) -> str:
    name = Path(path).name
    for short in ("python", "fcl", "numpy", "libc.", "libm.", "libstdc"):
        if short in (path if short in ("fcl", "numpy") else name):
            return short.rstrip(".").replace("libstdc", "libstdc++")
    return "kernels" if name == "???" else "others"


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--work", action="store_true", help=SUPPRESS)
    parser.add_argument("--times", type=int, default=TIMES, help="repetitions of each work")
    arguments = parser.parse_args()
    if arguments.work:
        work(arguments.times)
        return
    if shutil.which("valgrind") is None:
        sys.exit("valgrind is not installed: apt-get install valgrind")
    result = {}
    with Console().status("counting"):
        kinds = count_instructions(arguments.times)
        nothing = kinds.pop("nothing")
        for kind, spent in kinds.items():
            spent.subtract(nothing)
            result[kind] = {name: n / arguments.times for name, n in spent.most_common() if n > 0}
    table = Table("once", "million instructions", "of it, in percent", title="instructions")
    for kind, shares in result.items():
        total = sum(shares.values())
        named = [f"{name} {n / total:.0%}" for name, n in shares.items() if n > 0.01 * total]
        label = (getattr(Work, kind).__doc__ or "").rstrip(".")
        table.add_row(label, f"{total / 1e6:.2f}", ", ".join(named))
    Console(width=100).print(table)
    result_file = arguments.out / "instructions.json"
    write_json(result_file, {"times": arguments.times, "instructions": result})


if __name__ == "__main__":
    main()
