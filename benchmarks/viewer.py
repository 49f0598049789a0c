"""What a page with a large pack costs: to show it, to go through its steps, to move it apart.

    .venv/bin/python -m benchmarks.viewer

Fifty items of 50,800 triangles each. Times are of the processor, all threads together, so that they
mean something on a machine that does other things as well. Prints a table, and writes
`benchmarks/results/viewer.json`.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table
from trimesh import creation

from benchmarks.placement import RESULTS, summaries
from packit_sim.geometry.lattice import BOX_CELLS
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import BoxState, PlacedItem
from packit_sim.render.looks import Cut
from packit_sim.viewer.box_view import BoxView, DisplaySettings
from packit_sim.viewer.web_page import WebPage

ITEMS = 50
SECTIONS = (200, 127)
"""Around the ring and around its tube: 50,800 triangles."""


def pack() -> BoxState[PlacedItem]:
    """Rings of different widths, on a lattice: no two are the same shape."""
    rings = [
        creation.torus(
            0.5, 0.05 + 0.003 * n, major_sections=SECTIONS[0], minor_sections=SECTIONS[1]
        )
        for n in range(ITEMS)
    ]
    shapes = [Shape.from_mesh(ring, f"ring-{n}") for n, ring in enumerate(rings)]
    places = itertools.islice(itertools.product((0, 6, 12, 18), repeat=3), ITEMS)
    placed = [
        PlacedItem(Item(shape, 0.01), (x, y, z))
        for shape, (x, y, z) in zip(shapes, places, strict=True)
    ]
    return BoxState(BOX_CELLS, tuple(placed))


def milliseconds(work: Callable[[], None]) -> float:
    """Of the processor."""
    before = time.process_time()
    work()
    return (time.process_time() - before) * 1000


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the JSON")
    parser.add_argument("--repeats", type=int, default=11, help="of all but the first display")
    arguments = parser.parse_args()
    console = Console(width=100)
    with console.status("making the pack"):
        box = pack()
    page = WebPage()
    try:
        shown = BoxView(page.server)
        times = {"shown for the first time": [milliseconds(partial(shown.show, box))]}
        repeats = range(1, arguments.repeats + 1)
        for name, displays in {
            "a step": [DisplaySettings(step=n) for n in repeats],
            "moved apart": [DisplaySettings(explode=n / 10) for n in repeats],
            "cut open": [DisplaySettings(cut=Cut("y", 0.5 + n / 100)) for n in repeats],
        }.items():
            times[name] = [milliseconds(partial(shown.show, box, one)) for one in displays]
        kept = sum(len(handle.faces) for handle in shown.items)
    finally:
        page.close()
    triangles = sum(len(placed.item.shape.mesh.faces) for placed in box.placed)
    result = {
        "command": "python -m benchmarks.viewer",
        "machine": {"python": platform.python_version(), "cores": os.cpu_count()},
        "items": ITEMS,
        "triangles": triangles,
        "triangles on the page": kept,
        "processor, ms": summaries(times),
    }
    table = Table("what", "processor, ms", "10% to 90%", "n")
    for name, row in summaries(times).items():
        table.add_row(
            name, f"{row['median']:.1f}", f"{row['p10']:.1f} to {row['p90']:.1f}", str(row["n"])
        )
    console.print(table)
    console.print(f"{ITEMS} items of {triangles:,} triangles, {kept:,} of them on the page")
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "viewer.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
