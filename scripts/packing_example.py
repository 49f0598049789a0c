"""Pack kitchen things into a box, for the README: python scripts/packing_example.py [FOLDER].

Shapes of the built-in library at their usual sizes. Each can be put in by straight moves, and rests
on the floor or on others. Writes `film-parts.gif` and `packed-parts.png` to docs/images, or to the
folder.
"""

from __future__ import annotations

import sys
from pathlib import Path

from packit_sim import PackSettings, Part, ShapeLibrary, pack
from packit_sim.parts import Constraints, check, filter_packing, lowered, removable, table
from packit_sim.parts.results.film import film_packing
from packit_sim.parts.results.pictures import draw

IMAGES = Path(__file__).parents[1] / "docs" / "images"

BOX = "300x240x200mm"

SECONDS = 60.0

THINGS = {
    "apple": (85, 3),
    "banana": (170, 1),
    "bowl-2": (190, 1),
    "bowl-3": (170, 1),
    "bread": (220, 1),
    "chef-knife": (260, 1),
    "coffee-mug": (135, 2),
    "creamer": (110, 1),
    "fork": (190, 2),
    "ladle": (280, 1),
    "milk-carton": (200, 1),
    "mug": (130, 1),
    "round-plate": (230, 1),
    "salt-shaker": (90, 2),
    "saucepan": (290, 1),
    "spoon": (180, 2),
    "sugar-bowl": (130, 1),
    "teapot": (220, 1),
    "tumbler-1": (150, 2),
    "wine-glass": (210, 1),
}
"""The diagonal of a shape in millimetres, and how many there are of it."""


def main(folder: Path) -> None:
    library = ShapeLibrary.open("everyday")
    parts = [
        Part(name, library[name].mesh.copy().apply_scale(diagonal), count)
        for name, (diagonal, count) in THINGS.items()
    ]
    packed = pack(parts, BOX, time=SECONDS, settings=PackSettings(removable=True))
    found = check(packed)
    print(table(packed, found))
    assert found.problems == ()
    resting = lowered(packed.packings[0])
    resting = filter_packing(resting, Constraints(removable=True)).packing
    print(f"{len(resting.placements)} parts after they came to rest")
    assert resting.problems() == [] and removable(resting).stuck == ()
    draw(resting, folder / "packed-parts.png")
    film_packing(folder / "film-parts.gif", resting)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES)
