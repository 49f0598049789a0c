"""Compare `packit_sim.pack` with other packers: random shapes in boxes of five sizes.

    .venv/bin/python -m benchmarks.packing_parts --selections 50 --seconds 60
    .venv/bin/python -m benchmarks.packing_parts --table

A selection has 20 to 60 shapes, whose volumes add up to 1.2 times the box's; each fits into the
box. All packers get the same items and seek the most volume: bounding boxes (packvium), heightmaps
and spectral packing, without a time limit, as in `benchmarks.peers`. Each packing is checked by its
meshes; ours also by `packit_sim.parts.check`. Writes each result to
`benchmarks/results/packing_parts.json` at once: what has a result is not packed again; --table
writes the table of `docs/benchmarks/parts.md`.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import argument_parser, machine, markdown_table, write_into_page, write_json
from benchmarks.peers.cuboids import Cuboids
from benchmarks.peers.heightmaps import Heightmaps
from benchmarks.peers.posed import Peer
from benchmarks.peers.spectral import Spectral
from benchmarks.peers.validity import QualityScores
from packit_sim import Box, Item, PackSettings, Part, ShapeLibrary, pack
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.game.datasets.packs import Pack, Task
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.parts import check
from packit_sim.parts.packings.containers import ROUNDING

LIBRARY = "everyday"

SIZES: tuple[Triple, ...] = (
    (100, 100, 100),
    (100, 100, 52),
    (100, 80, 60),
    (100, 60, 40),
    (100, 52, 52),
)
"""The boxes, in cells."""

UNIT_MM = 300.0
"""Millimetres in a box unit."""

FILE = "packing_parts.json"

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "parts.md"

BLOCK = "other packers"
"""Between these comments the page has the table."""

OURS = "packit pack"

VOLUME = 1.2
"""Volume of all items, relative to the box's."""

SPREAD = 0.5
"""Standard deviation of the logarithm of volumes."""

PEERS: tuple[Peer, ...] = (Cuboids(), Heightmaps(), Spectral())


def selection(
    library: ShapeLibrary,
    seed: int,
    cells: Triple | None = None,
    count: int | None = None,
    volume: float = VOLUME,
) -> Task:
    """Draw the items of a selection.

    Parameters
    ----------
    library : ShapeLibrary
        The shapes.
    seed : int
        The seed.
    cells : tuple of int, optional
        The box; by default one of `SIZES`, which take turns.
    count : int, optional
        The number of items; by default 20 to 60.
    volume : float
        Their volume, relative to the box's.

    Returns
    -------
    Task
        The items; each fits into the box in one of the 24 rotations.
    """
    cells = cells or SIZES[seed % len(SIZES)]
    size = np.array(cells) * CELL
    rng = np.random.default_rng(seed)
    ids = list(library)
    count = count or int(rng.integers(20, 61))
    mean = volume * float(size.prod()) / count
    items: list[Item] = []
    while len(items) < count:
        shape = library[ids[rng.integers(len(ids))]]
        own = mean * float(np.exp(rng.normal(0, SPREAD)))
        item = Item(shape, own / shape.volume)
        if _fits(item, size):
            items.append(item)
    factor = volume * float(size.prod()) / sum(item.volume for item in items)
    items = [Item(item.shape, item.scale * factor) for item in items]
    items = [item for item in items if _fits(item, size)]
    items.sort(key=lambda item: (item.shape.id, item.scale))
    return Task(tuple(items), Pack.of(Box(cells), library), ())


def _fits(item: Item, size: Any) -> bool:
    turned = np.array([item.turned(n).extents for n in range(24)])
    return bool((turned <= size * (1 + ROUNDING)).all(axis=1).any())


def parts_of(task: Task) -> list[Part]:
    """Return the items of a task as parts in millimetres; no two have the same name."""
    parts = []
    for n, item in enumerate(task.items):
        mesh = item.turned(0).mesh.copy()
        parts.append(Part(f"{n:02d} {item.shape.id}", mesh.apply_scale(UNIT_MM)))
    return parts


def measure(task: Task, seconds: float, workers: int) -> dict[str, Any]:
    """Pack a selection with all packers.

    Parameters
    ----------
    task : Task
        The selection.
    seconds : float
        The time of our search.
    workers : int
        Its processes.

    Returns
    -------
    dict
        By packer: the packed volume relative to the box's, the number of items, the wall seconds
        and the problems of the packing.
    """
    space = float(np.prod(np.array(task.cells) * CELL))
    started = time.perf_counter()
    first: list[float] = []
    found = pack(
        parts_of(task),
        tuple(side * CELL * UNIT_MM for side in task.cells),
        time=seconds,
        callback=lambda _, at: first.append(round(at, 2)),
        settings=PackSettings(workers=workers),
    )
    numbers = [placement.type for _, placement in found.placements]
    rows: dict[str, Any] = {
        OURS: {
            "volume": sum(task.items[n].volume for n in numbers) / space,
            "items": len(numbers),
            "seconds": time.perf_counter() - started,
            "first": first[0],
            "problems": len(check(found).problems),
        }
    }
    for peer in PEERS:
        started = time.perf_counter()
        packing = peer.pack(task)
        elapsed = time.perf_counter() - started
        checked = QualityScores.of(packing, task.cells)
        rows[peer.name] = {
            "volume": sum(one.item.volume for one in packing) / space,
            "items": len(packing),
            "seconds": elapsed,
            "problems": len(checked.outside) + len(checked.pairs),
        }
    return rows


def table(runs: Mapping[str, Mapping[str, Any]]) -> str:
    """Tabulate the results in Markdown: a row for each packer."""
    rows = []
    for name in (OURS, *(peer.name for peer in PEERS)):
        own = [run[name] for run in runs.values()]
        ratio = [run[OURS]["volume"] / run[name]["volume"] for run in runs.values()]
        volume = Estimate.of([each["volume"] for each in own])
        rows.append(
            (
                name,
                format_estimate(volume, ".3f"),
                "-" if name == OURS else format_estimate(Estimate.of(ratio), ".3f"),
                f"{statistics.fmean(each['items'] for each in own):.1f}",
                f"{statistics.fmean(each['seconds'] for each in own):.1f}",
                sum(each["problems"] for each in own),
            )
        )
    head = ("packer", "volume packed", "ratio of ours to it", "items", "seconds", "problems")
    return markdown_table(head, rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--selections", type=int, default=50, help="how many selections")
    parser.add_argument("--seconds", type=float, default=60.0, help="time of our search")
    parser.add_argument("--workers", type=int, default=0, help="threads; 0: one per core")
    parser.add_argument("--table", action="store_true", help="write the table of the page")
    arguments = parser.parse_args()
    file: Path = arguments.out / FILE
    setting = f"{arguments.seconds:g} s, workers {arguments.workers}"
    known: dict[str, Any] = json.loads(file.read_text())["runs"] if file.exists() else {}
    library = ShapeLibrary.open(LIBRARY)
    for number in range(0 if arguments.table else arguments.selections):
        key = f"{number}, {setting}"
        if key in known:
            continue
        task = selection(library, number)
        found = measure(task, arguments.seconds, arguments.workers)
        known[key] = {"items": len(task.items), "cells": task.cells, **found}
        head = {"command": "python -m benchmarks.packing_parts", "machine": machine()}
        write_json(file, {**head, "library": library.digest, "runs": known})
        shown = {name: round(row["volume"], 3) for name, row in found.items()}
        print(f"selection {key}: {len(task.items)} items, {shown}", flush=True)
    runs = {key: run for key, run in known.items() if key.endswith(f", {setting}")}
    if arguments.table:
        write_into_page(PAGE, table(runs), BLOCK)
    print(table(runs))


if __name__ == "__main__":
    main()
