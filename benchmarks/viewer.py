"""Measure the viewer's page with a large pack: showing it, stepping through it, exploding it.

    .venv/bin/python -m benchmarks.viewer

Fifty items of 50,800 triangles each. Times are CPU times of all threads together, so that other
work on the machine does not count. Prints a table, and writes `benchmarks/results/viewer.json`.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from functools import partial

from rich.console import Console
from trimesh import creation

from benchmarks.common import argument_parser, machine, summaries, summary_table, write_json
from packit_sim.geometry.lattice import BOX_CELLS
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import BoxState, PlacedItem
from packit_sim.render.looks import Cut
from packit_sim.web.box_view import BoxView, DisplaySettings
from packit_sim.web.web_page import WebPage

ITEMS = 50
SECTIONS = (200, 127)
"""Segments around the ring and around its tube: 50,800 triangles."""


def pack() -> BoxState[PlacedItem]:
    """Create rings of different widths on a lattice, no two of the same shape."""
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


def cpu_milliseconds(work: Callable[[], None]) -> float:
    """Measure the CPU time of one call, in milliseconds."""
    before = time.process_time()
    work()
    return (time.process_time() - before) * 1000


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument(
        "--repeats", type=int, default=11, help="repetitions of all but the first display"
    )
    arguments = parser.parse_args()
    console = Console(width=100)
    with console.status("creating the pack"):
        box = pack()
    page = WebPage()
    try:
        view = BoxView(page.server)
        times = {"shown for the first time": [cpu_milliseconds(partial(view.show, box))]}
        repeats = range(1, arguments.repeats + 1)
        for name, displays in {
            "a step": [DisplaySettings(step=n) for n in repeats],
            "moved apart": [DisplaySettings(explode=n / 10) for n in repeats],
            "cut open": [DisplaySettings(cut=Cut("y", 0.5 + n / 100)) for n in repeats],
        }.items():
            times[name] = [cpu_milliseconds(partial(view.show, box, one)) for one in displays]
        kept = sum(len(handle.faces) for handle in view.items)
    finally:
        page.close()
    triangles = sum(len(placed.item.shape.mesh.faces) for placed in box.placed)
    result = {
        "command": "python -m benchmarks.viewer",
        "machine": machine(),
        "items": ITEMS,
        "triangles": triangles,
        "triangles on the page": kept,
        "processor, ms": summaries(times),
    }
    console.print(summary_table(summaries(times), "update", "CPU time, ms", ".1f"))
    console.print(f"{ITEMS} items of {triangles:,} triangles, {kept:,} of them on the page")
    write_json(arguments.out / "viewer.json", result)


if __name__ == "__main__":
    main()
