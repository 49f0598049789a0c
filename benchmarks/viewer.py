"""How long a page with a large pack takes: `python -m benchmarks.viewer`.

Fifty items of 50,000 triangles each. Times are of the processor, all threads together.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

from trimesh import creation

from packit_sim.box import Snapshot
from packit_sim.geometry.lattice import BOX_CELLS
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.occupancy import Placed
from packit_sim.viewing.boxes import Display, ShownBox
from packit_sim.viewing.pages import Page

ITEMS = 50
SECTIONS = (200, 127)
"""Around the ring and around its tube: 50,800 triangles."""


def pack() -> Snapshot:
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
        Placed(Item(shape, 0.01), (x, y, z))
        for shape, (x, y, z) in zip(shapes, places, strict=True)
    ]
    return Snapshot(BOX_CELLS, tuple(placed))


def seconds(work: Callable[[], None]) -> float:
    before = time.process_time()
    work()
    return time.process_time() - before


def main() -> None:
    box = pack()
    page = Page()
    shown = ShownBox(page.server)
    rows = {
        "shown for the first time": seconds(lambda: shown.show(box)),
        "one step on": seconds(lambda: shown.show(box, Display(step=25))),
        "exploded": seconds(lambda: shown.show(box, Display(explode=0.5))),
    }
    triangles = sum(len(placed.item.shape.mesh.faces) for placed in box.placed)
    kept = sum(len(handle.faces) for handle in shown.items)
    page.close()
    print(f"{ITEMS} items of {triangles:,} triangles, {kept:,} of them on the page")
    for name, taken in rows.items():
        print(f"{name}: {taken:.3f} s")


if __name__ == "__main__":
    main()
