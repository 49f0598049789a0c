"""Compare `packit_sim.pack` with other packers: random shapes in boxes of five sizes.

    .venv/bin/python -m benchmarks.packing_parts --selections 50 --seconds 60
    .venv/bin/python -m benchmarks.packing_parts --table

A selection has 20 to 60 shapes, whose volumes add up to 1.2 times the box's; each fits into the
box. All packers get the same items and seek the most volume: bounding boxes (packvium), heightmaps
and spectral packing, without a time limit, as in `benchmarks.peers`. Each packing is checked by its
meshes; ours also by `PackedParts.verify`. Prints the ratios, and writes each result to
`benchmarks/results/packing_parts.json` at once: what has a result is not packed again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import argument_parser, machine, write_json
from benchmarks.peers.cuboids import Cuboids
from benchmarks.peers.heightmaps import Heightmaps
from benchmarks.peers.posed import Peer
from benchmarks.peers.spectral import Spectral
from benchmarks.peers.validity import QualityScores
from packit_sim import Box, Item, PackSettings, Part, ShapeLibrary, pack
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.datasets.packs import Pack, Task
from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.parts.part_sizes import fits

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

VOLUME = 1.2
"""Volume of all items, relative to the box's."""

SPREAD = 0.5
"""Standard deviation of the logarithm of volumes."""

PEERS: tuple[Peer, ...] = (Cuboids(), Heightmaps(), Spectral())


def selection(library: ShapeLibrary, number: int) -> Task:
    """Draw the items of a selection, and its box.

    Parameters
    ----------
    library : ShapeLibrary
        The shapes.
    number : int
        The number of the selection: the seed, and the box by turns.

    Returns
    -------
    Task
        The items; each fits into the box in one of the 24 rotations.
    """
    cells = SIZES[number % len(SIZES)]
    size = np.array(cells) * CELL
    rng = np.random.default_rng(number)
    ids = list(library)
    count = int(rng.integers(20, 61))
    mean = VOLUME * float(size.prod()) / count
    items: list[Item] = []
    while len(items) < count:
        shape = library[ids[rng.integers(len(ids))]]
        volume = mean * float(np.exp(rng.normal(0, SPREAD)))
        item = Item(shape, volume / shape.volume)
        if _fits(item, size):
            items.append(item)
    factor = VOLUME * float(size.prod()) / sum(item.volume for item in items)
    items = [Item(item.shape, item.scale * factor) for item in items]
    items = [item for item in items if _fits(item, size)]
    items.sort(key=lambda item: (item.shape.id, item.scale))
    return Task(tuple(items), Pack.of(Box(cells), library), ())


def _fits(item: Item, size: Any) -> bool:
    turned = np.array([item.turned(n).extents for n in range(24)])
    return fits(turned, size.tolist(), 0.0)


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
    parts = []
    for n, item in enumerate(task.items):
        mesh = item.turned(0).mesh.copy()
        parts.append(Part(f"{n:02d} {item.shape.id}", mesh.apply_scale(UNIT_MM)))
    started = time.perf_counter()
    first: list[float] = []
    found = pack(
        parts,
        tuple(side * CELL * UNIT_MM for side in task.cells),
        time=seconds,
        callback=lambda _, at: first.append(round(at, 2)),
        settings=PackSettings(workers=workers),
    )
    numbers = [placement.type for _, placement in found.placements]
    rows: dict[str, Any] = {
        "ours": {
            "volume": sum(task.items[n].volume for n in numbers) / space,
            "items": len(numbers),
            "seconds": time.perf_counter() - started,
            "first": first[0],
            "problems": len(found.verify()),
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


def ratios(runs: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield each peer's name and the mean ratio of our volume to its, with the interval."""
    for peer in PEERS:
        sample = [run["ours"]["volume"] / run[peer.name]["volume"] for run in runs.values()]
        yield peer.name, format_estimate(Estimate.of(sample), ".3f")


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--selections", type=int, default=50, help="how many selections")
    parser.add_argument("--seconds", type=float, default=60.0, help="time of our search")
    parser.add_argument("--workers", type=int, default=0, help="processes; 0: one per core")
    parser.add_argument(
        "--table", action="store_true", help="print the results, and search nothing"
    )
    arguments = parser.parse_args()
    file: Path = arguments.out / "packing_parts.json"
    known: dict[str, Any] = json.loads(file.read_text())["runs"] if file.exists() else {}
    library = ShapeLibrary.open(LIBRARY)
    for number in range(0 if arguments.table else arguments.selections):
        key = f"{number}, {arguments.seconds:g} s"
        if key in known:
            print(f"selection {key}: done before")
            continue
        task = selection(library, number)
        known[key] = {
            "items": len(task.items),
            "cells": task.cells,
            **measure(task, arguments.seconds, arguments.workers),
        }
        head = {"command": "python -m benchmarks.packing_parts", "machine": machine()}
        write_json(file, {**head, "library": library.digest, "runs": known})
        shown = {
            name: round(row["volume"], 3)
            for name, row in known[key].items()
            if name not in ("items", "cells")
        }
        print(f"selection {key}: {len(task.items)} items, {shown}")
    runs = {key: run for key, run in known.items() if key.endswith(f", {arguments.seconds:g} s")}
    if runs:
        problems = sum(
            run[name]["problems"]
            for run in runs.values()
            for name in run
            if isinstance(run[name], dict)
        )
        print(f"{len(runs)} selections, {problems} problems")
        for name, ratio in ratios(runs):
            print(f"volume packed, relative to {name}: {ratio}")


if __name__ == "__main__":
    main()
