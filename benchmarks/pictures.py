"""Measure pictures by renderer, size and look, and look for memory leaks.

    .venv/bin/python -m benchmarks.pictures

A box with twenty items of the built-in library: shapes and rotations drawn with seed 0, each at its
bottom-left-back-fill location. Wall times need an idle machine; CPU times, summed over all threads,
do not. Prints a table, and writes `benchmarks/results/pictures.json`.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import (
    Times,
    argument_parser,
    machine,
    resident_memory,
    summaries,
    write_json,
)
from packit_sim import Box, Item, ShapeLibrary
from packit_sim.render import renderers
from packit_sim.render.looks import Cut, Look
from packit_sim.scene import Scene

ITEMS, SEED = 20, 0
AIM = 80.0
"""Aim of the median for 512 x 512 pixels by EGL, in milliseconds."""

SNAPSHOTS = 1000
"""Number of snapshots in the search for leaks."""


def filled(library: ShapeLibrary) -> Box:
    """Fill a box with items, uniform over shapes, at an eighth of their volume."""
    rng, box = np.random.default_rng(SEED), Box()
    while len(box.placed) < ITEMS:
        shape = library[library.ids[rng.integers(len(library))]]
        box.fill(Item(shape, 0.125, int(rng.integers(24))))
    return box


def wall_and_cpu(function: Callable[[], Any], repeats: int) -> Iterator[tuple[float, float]]:
    """Yield milliseconds of wall time and of CPU time."""
    for _ in range(repeats):
        wall, processor = time.perf_counter(), time.process_time()
        function()
        yield (time.perf_counter() - wall) * 1000, (time.process_time() - processor) * 1000


def measure(renderer: str, repeats: int, snapshots: int) -> dict[str, Any]:
    """Take all measures of one renderer, in a separate process."""
    os.environ[renderers.RENDERER_VARIABLE] = renderer
    box = filled(ShapeLibrary.open("everyday"))
    wall: Times = {}
    processor: Times = {}

    def record(name: str, function: Callable[[], Any], count: int = repeats) -> None:
        pairs = list(wall_and_cpu(function, count))
        wall[name], processor[name] = map(list, zip(*pairs, strict=True))

    with Scene(box) as scene:  # compiles and probes
        scene.snapshot(64, 64)
    scenes: list[Scene] = []
    record("scene load", lambda: scenes.append(Scene(box)), 1)
    (scene,) = scenes
    try:
        record("first picture", scene.snapshot, 1)
        for side in (128, 256, 512, 1024):
            record(f"{side} x {side}", partial(scene.snapshot, side, side))
        record("512 x 512, glass", partial(scene.snapshot, look=Look(box="ghost")))
        cut = partial(scene.snapshot, look=Look(cut=Cut("y", 0.5)))
        record("512 x 512, cut open for the first time", cut, 1)
        record("512 x 512, cut open", cut)
        memory = [resident_memory() / 2**20]
        for n in range(snapshots):
            scene.snapshot(64, 64, Look(explode=n % 7 / 7))
            if (n + 1) % (snapshots // 10) == 0:
                memory.append(resident_memory() / 2**20)
    finally:
        scene.close()
    return {
        "triangles": sum(len(placed.item.shape.mesh.faces) for placed in box.placed),
        "wall, ms": summaries(wall),
        "processor, ms": summaries(processor),
        "memory over snapshots, MB": {"snapshots": snapshots, "at every tenth": memory},
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--repeats", type=int, default=31, help="number of pictures of each kind")
    arguments = parser.parse_args()
    console = Console(width=100)
    found: dict[str, Any] = {}
    for renderer in ("egl", "software"):
        with console.status(renderer), multiprocessing.get_context("spawn").Pool(1) as pool:
            found[renderer] = pool.apply(measure, (renderer, arguments.repeats, SNAPSHOTS))
    table = Table("picture", "renderer", "wall, ms (10% to 90%)", "processor, ms", "n")
    for renderer, one in found.items():
        for name, row in one["wall, ms"].items():
            table.add_row(
                name,
                renderer,
                f"{row['median']:.0f} ({row['p10']:.0f} to {row['p90']:.0f})",
                f"{one['processor, ms'][name]['median']:.0f}",
                str(row["n"]),
            )
    console.print(table)
    for renderer, one in found.items():
        memory = one["memory over snapshots, MB"]["at every tenth"]
        console.print(f"{renderer}: memory over {SNAPSHOTS} snapshots, MB: {np.round(memory, 1)}")
    median = found["egl"]["wall, ms"]["512 x 512"]["median"]
    console.print(f"512 x 512 by EGL: {median:.0f} ms in the median, aimed at {AIM:.0f}")
    load = os.getloadavg()[0]
    result = {
        "command": "python -m benchmarks.pictures",
        "machine": machine() | {"load": load},
        "items": ITEMS,
        "seed": SEED,
    } | found
    write_json(arguments.out / "pictures.json", result)


if __name__ == "__main__":
    main()
