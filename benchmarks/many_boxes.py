"""Measure how much of 200 different parts goes into boxes that don't hold all of them.

    .venv/bin/python -m benchmarks.many_boxes --seeds 1 2 3
    .venv/bin/python -m benchmarks.many_boxes --table

The parts are those of `many_parts`. The cube, or two cubes, would be full of them at a density of
1.0. `nest` (one box) and `pack` (two) search for the seconds of `SECONDS` with two workers. The
greedy rule takes the largest part first, to the lowest place of all on a grid, in 24 rotations; of
its grids in `CELLS`, the one counts that packs most in twice these seconds on its one core.
Each packing is checked by its meshes. Results are written to `benchmarks/results/many_boxes.json`
at once, and what has a result is not repeated.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.common import (
    RESULTS,
    argument_parser,
    machine,
    markdown_table,
    write_into_page,
    write_json,
)
from benchmarks.many_parts import PAGE, items_of, parts
from benchmarks.nesting.cases import place_lowest
from packit_sim import Box, ItemType, NestSettings, Part, nest, pack

BLOCK = "many boxes"
"""Between these comments the page has the table."""

FILE = "many_boxes.json"

PARTS = 200

SECONDS = 60.0

ASKED = 1.0
"""The parts' volume, as a share of that of the boxes."""

CELLS = 120, 160, 200, 240, 320
"""Cells along a side of the greedy rule's boxes."""


def sides(types: Sequence[ItemType], boxes: int) -> float:
    """Return the side of each of some cubes."""
    return float((sum(one.volume for one in types) / ASKED / boxes) ** (1 / 3))


def greedy(types: Sequence[ItemType], boxes: int, cells: int) -> float:
    """Return the share of the boxes' volume that the greedy rule fills."""
    unit = sides(types, boxes) / (cells / 100)
    kept = [Box((cells, cells, cells)) for _ in range(boxes)]
    for item in items_of(sorted(types, key=lambda each: -each.volume), unit):
        place_lowest(kept, item)
    return sum(box.density for box in kept) / boxes


def best_greedy(types: Sequence[ItemType], boxes: int) -> dict[str, Any]:
    """Return what the greedy rule packs in each grid that it is through with in time."""
    densities: dict[str, float] = {}
    seconds: dict[str, float] = {}
    for cells in CELLS:
        started = time.process_time()
        density = greedy(types, boxes, cells)
        seconds[str(cells)] = round(time.process_time() - started, 1)
        if seconds[str(cells)] > 2 * SECONDS:
            break
        densities[str(cells)] = round(density, 4)
    return {"densities": densities, "seconds": seconds}


def ours(types: Sequence[ItemType], boxes: int, seed: int) -> dict[str, Any]:
    """Return what the search packs, and the problems of its packing."""
    side = sides(types, boxes)
    if boxes == 1:
        settings = NestSettings(workers=2)
        given = types, (side, side, side), "knapsack"
        packing = nest(*given, time=SECONDS, seed=seed, settings=settings)
        volume, problems = packing.volume, packing.problems()
    else:
        own = [
            Part(one.name, trimesh.Trimesh(one.vertices, one.faces, process=False), unit="mm")
            for one in types
        ]
        size = "x".join([f"{side!r}"] * 3)
        packed = pack(own, [f"{size}mm={boxes}"], time=SECONDS, seed=seed)
        volume = packed.volume
        problems = [each for one in packed.packings for each in one.problems()]
    return {"density": round(volume / (boxes * side**3), 4), "problems": problems}


def table(runs: Sequence[Mapping[str, Any]]) -> str:
    """Tabulate the means in Markdown."""
    rows = []
    for boxes in sorted({run["boxes"] for run in runs}):
        own = [run for run in runs if run["boxes"] == boxes]
        found = [run["ours"]["density"] for run in own]
        rules = [max(run["greedy"]["densities"].values()) for run in own]
        ratios = [one / other for one, other in zip(found, rules, strict=True)]
        rows.append(
            (
                boxes,
                len(own),
                f"{np.mean(found):.3f}",
                f"{np.mean(rules):.3f}",
                f"{np.mean(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})",
                sum(len(run["ours"]["problems"]) for run in own),
            )
        )
    head = "boxes", "sets", "density", "of the greedy rule", "ratio", "problems"
    return markdown_table(head, rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[])
    parser.add_argument("--boxes", nargs="+", type=int, choices=(1, 2), default=[1, 2])
    parser.add_argument("--table", action="store_true", help="write the table into the page")
    arguments = parser.parse_args()
    file: Path = arguments.out / FILE
    runs = json.loads(file.read_text())["runs"] if file.exists() else {}
    for seed in arguments.seeds:
        for boxes in arguments.boxes:
            name = f"{boxes} boxes, seed {seed}"
            if name in runs:
                continue
            types, _ = parts(PARTS, seed)
            run = {"boxes": boxes, "seed": seed, "ours": ours(types, boxes, seed)}
            runs[name] = {**run, "greedy": best_greedy(types, boxes)}
            print(name, runs[name]["ours"]["density"], runs[name]["greedy"], flush=True)
            head = {"command": "python -m benchmarks.many_boxes", "machine": machine()}
            write_json(file, {**head, "runs": runs})
    if arguments.table and arguments.out == RESULTS:
        write_into_page(PAGE, table(list(runs.values())), BLOCK)


if __name__ == "__main__":
    main()
