"""Measure how the cost of a sample in a separation of many different parts grows with their number.

    .venv/bin/python -m benchmarks.many_samples
    .venv/bin/python -m benchmarks.many_samples --table

The parts are those of `many_parts`. Each set is constructed and goes to a grid of cells, in a strip
that is lower by 5%. All items that are in conflict there move once, with so many samples that
nothing else counts. The numbers are medians of seven rounds, each of which takes all sets in turn.
Results are written to `benchmarks/results/many_samples.json`; `--table` writes the table of
`docs/benchmarks/nesting-many.md`.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from statistics import median
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
from benchmarks.many_parts import PAGE, parts
from packit_sim.parts.nesting.build import build
from packit_sim.parts.nesting.cell_filling import cell_side, filled_cells
from packit_sim.parts.nesting.cell_orders import hardest_first
from packit_sim.parts.nesting.cell_separation import CellSeparation
from packit_sim.parts.nesting.cell_separation_kernels import separate_cells
from packit_sim.parts.nesting.cells import Cells, cells_of
from packit_sim.parts.nesting.filling import tops
from packit_sim.parts.nesting.problem import Problem, boxes_of
from packit_sim.parts.nesting.settings import DEFAULT_SETTINGS
from packit_sim.parts.nesting.tasks import SearchTask, Solution

BLOCK = "many samples"
"""Between these comments the page has the table."""

FILE = "many_samples.json"

COUNTS = 20, 100, 300, 1000

SAMPLES = 300
"""Samples of a move near the item, and as many in the whole strip."""

ROUNDS = 7
"""Measurements of each set, in turn with those of the others."""

LOWER = 0.05
"""Share of the height by which the strip is lower."""


def separation(count: int) -> tuple[Problem, Cells, CellSeparation]:
    """Return an attempt to pack so many parts into a strip that is too low."""
    types, side = parts(count, 1)
    problem = build(types, side, 0.0, by_cells=True, has_fields=False)
    volumes = np.array([each.volume for each in types])
    task = SearchTask(np.arange(count), volumes, volumes, ((side, side, math.inf),))
    rng, boxes, order = np.zeros(1, np.uint64), boxes_of([task.size]), hardest_first(problem, task)
    poses = filled_cells(problem, task, task.unplaced, boxes, order, rng)
    height = float(tops(problem, task, poses).max())
    cells = cells_of(problem, cell_side(problem, task))
    less = math.ceil(LOWER * height / cells.side)
    solution = Solution((height,), poses, boxes)
    return problem, cells, CellSeparation(task, solution, cells.side, less)


def measured(problem: Problem, cells: Cells, attempt: CellSeparation) -> tuple[int, float]:
    """Return how many items moved, and the samples in a second of processor time."""
    settings = DEFAULT_SETTINGS
    weights = *settings.weight_growth, settings.weight_decay
    rng = np.zeros(1, np.uint64)
    state, grid, size = attempt.on_grid(cells)
    given = problem, cells, state, grid, size
    separate_cells(*given, 0, (SAMPLES, SAMPLES), weights, rng)  # compares surfaces
    moved = int((grid.shared.max(axis=1) > 0).sum())
    started = time.process_time()
    separate_cells(*given, 1, (SAMPLES, SAMPLES), weights, rng)
    return moved, 2 * SAMPLES * moved / (time.process_time() - started)


def table(found: Mapping[str, Mapping[str, Any]]) -> str:
    rows = [
        (f"{int(count):,}", own["moved"], f"{own['samples a second']:,}")
        for count, own in found.items()
    ]
    return markdown_table(("parts", "moved", "samples a second"), rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--table", action="store_true", help="only write the table of the page")
    options = parser.parse_args()
    file = options.out / FILE
    if not options.table:
        attempts = {count: separation(count) for count in options.counts}
        for attempt in attempts.values():
            measured(*attempt)  # the first time includes compilation
        found: dict[int, list[tuple[int, float]]] = {count: [] for count in attempts}
        for _ in range(ROUNDS):
            for count, attempt in attempts.items():
                found[count].append(measured(*attempt))
        counts = {
            str(count): {
                "moved": own[0][0],
                "samples a second": round(median(rate for _, rate in own)),
            }
            for count, own in found.items()
        }
        print(table(counts))
        write_json(file, {"machine": machine(), "counts": counts})
    elif options.out == RESULTS:
        write_into_page(PAGE, table(json.loads(file.read_text())["counts"]), BLOCK)


if __name__ == "__main__":
    main()
