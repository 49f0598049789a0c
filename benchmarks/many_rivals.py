"""Pack the strips of `many_parts` by other rules, for their density after equal processor time.

    .venv/bin/python -m benchmarks.many_rivals --parts 25 50 100 300 --seeds 1
    .venv/bin/python -m benchmarks.many_rivals --table

The rules take the largest part first: to the lowest place on a grid in 24 rotations, by exact masks
(`greedy`); where the heightmap grows least; and by spectral packing in six rotations. The last two
are our own small versions of what others published (see `benchmarks.peers`), with conservative
voxels. Each rule packs on finer and finer grids until it takes longer than the search, which
has two workers; then the densest packing counts. Results go into
`benchmarks/results/many_rivals.json` at once, and what has a result is not repeated. `--table`
writes table and plot of `docs/benchmarks/nesting-many.md`.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
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
from benchmarks.many_parts import FILE as SEARCHES
from benchmarks.many_parts import PAGE, SECONDS, items_of, parts
from benchmarks.nesting.cases import place_lowest
from benchmarks.peers.heightmaps import Heightmaps
from benchmarks.peers.spectral import Spectral
from packit_sim import Box, ItemType, Task
from packit_sim.geometry.lattice import CELL, MAX_CELLS, STEP
from packit_sim.render import plots

BLOCK = "many rivals"
"""Between these comments the page has the table."""

FILE = "many_rivals.json"

PICTURE = PAGE.parents[1] / "images" / "benchmark-nesting-many.png"

CELLS = 48, 64, 96, 128, 160, 192, 224, 320
"""Cells along a side of the base, one grid after the other."""

HIGHEST = 2.2
"""The strip's space, in sides of its base; a rule that needs more has no result."""

WORKERS = 2
"""Workers of the search, whose processor time together a rule gets."""


def greedy(task: Task) -> float:
    """Return the height of the strip, in cells; inf if the space is too low."""
    box = Box(task.cells)
    for item in sorted(task.items, key=lambda each: -each.volume):
        if not place_lowest([box], item):
            return math.inf
    return max(placed.center[2] + placed.item.extents[2] / 2 for placed in box.placed) / CELL


def by_peer(peer: Heightmaps | Spectral) -> Callable[[Task], float]:
    """Return the function that packs by a peer."""

    def pack(task: Task) -> float:
        packed = peer.pack(task)
        if len(packed) < len(task.items):
            return math.inf
        return max(one.centre[2] + one.item.extents[2] / 2 for one in packed) / CELL

    return pack


RULES = {
    "greedy": greedy,
    "heightmaps": by_peer(Heightmaps()),
    "spectral": by_peer(Spectral()),
}


def tried(
    types: Sequence[ItemType], side: float, rule: Callable[[Task], float], seconds: float
) -> Any:
    """Return grids, processor seconds and densities of a rule, until its time is over."""
    volume = sum(one.volume for one in types)
    runs = []
    for cells, finer in zip(CELLS, (*CELLS[1:], math.inf), strict=True):
        unit = side / (cells * CELL)
        height = min(STEP * int(HIGHEST * cells / STEP), MAX_CELLS)
        task = Task.of(items_of(types, unit), (cells, cells, height))
        started = time.process_time()
        top = rule(task) * CELL * unit
        taken = time.process_time() - started
        if taken > seconds:
            break
        if top < math.inf:
            density = round(volume / (side * side * top), 4)
            runs.append({"cells": cells, "seconds": round(taken, 1), "density": density})
        if taken * (finer / cells) ** 2 > seconds:
            break
    return runs


def rows(
    runs: Mapping[str, Mapping[str, Any]], searches: Mapping[str, Mapping[str, Any]]
) -> list[tuple[object, ...]]:
    """Return the means of the densest packings for each number of parts."""
    found = []
    for count in sorted({run["parts"] for run in runs.values()}):
        names = [name for name, run in runs.items() if run["parts"] == count and name in searches]
        ours = [searches[name]["history"][-1][1] for name in names]
        rules = [
            [max((one["density"] for one in runs[name][rule]), default=np.nan) for name in names]
            for rule in RULES
        ]
        means = (
            "none" if np.isnan(mean) else f"{mean:.3f}" for mean in np.mean((ours, *rules), axis=1)
        )
        found.append((f"{count:,}", len(names), WORKERS * SECONDS[count], *means))
    return found


def draw(runs: Mapping[str, Mapping[str, Any]], searches: Mapping[str, Mapping[str, Any]]) -> None:
    """Draw density against processor seconds: curves of the searches, points of the rules."""
    counts = sorted({run["parts"] for run in runs.values()})
    with plots.drawn(PICTURE, [[str(count) for count in counts]], 3.1 * len(counts), 3.4) as (
        figure,
        axes,
    ):
        for count in counts:
            axis = axes[str(count)]
            for name in (each for each, run in runs.items() if run["parts"] == count):
                if name in searches:
                    seconds, densities = np.transpose(searches[name]["history"])
                    axis.step(
                        WORKERS * seconds,
                        densities,
                        where="post",
                        color=plots.COLORS[0],
                        label="nest",
                    )
                for rule, color in zip(RULES, plots.COLORS[1:], strict=False):
                    own = [(one["seconds"], one["density"]) for one in runs[name][rule]]
                    if own:
                        axis.plot(*np.transpose(own), "o-", color=color, lw=0.8, ms=3, label=rule)
            axis.set(title=f"{count:,} parts", xlabel="processor seconds", xscale="log")
        axes[str(counts[0])].set_ylabel("density")
        known = [axes[str(count)].get_legend_handles_labels() for count in counts]
        unique = {label: handle for own in known for handle, label in zip(*own, strict=True)}
        names = [name for name in ("nest", *RULES) if name in unique]
        handles = [unique[name] for name in names]
        figure.legend(handles, names, loc="outside upper center", ncols=len(names))


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--parts", nargs="+", type=int, choices=SECONDS, default=[])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--table", action="store_true", help="write table and plot")
    arguments = parser.parse_args()
    file: Path = arguments.out / FILE
    runs = json.loads(file.read_text())["runs"] if file.exists() else {}
    for count in arguments.parts:
        for seed in arguments.seeds:
            name = f"{count} parts, seed {seed}"
            run = runs.setdefault(name, {"parts": count, "seed": seed})
            types, side = parts(count, seed)
            for label, rule in RULES.items():
                if label not in run:
                    run[label] = tried(types, side, rule, WORKERS * SECONDS[count])
                    print(name, label, run[label], flush=True)
                    head = {"command": "python -m benchmarks.many_rivals", "machine": machine()}
                    write_json(file, {**head, "runs": runs})
    if arguments.table and arguments.out == RESULTS:
        searches = json.loads((RESULTS / SEARCHES).read_text())["runs"]
        columns = ("parts", "sets", "processor s", "`nest`", *RULES)
        write_into_page(PAGE, markdown_table(columns, rows(runs, searches)), BLOCK)
        draw(runs, searches)


if __name__ == "__main__":
    main()
