"""Build the shape library "blockout": eight polycubes for online packing.

    python scripts/build_blockout.py [--out assets/blockout]

The result is reproducible, bit by bit. The shapes stand for those of the data set BlockOut of Zhao
et al. (ACM Transactions on Graphics, 2024), whose description leaves their cells open: we chose the
eight polycubes of four cells, mirror images counted, in a pose that lies flat. Cells are cubes of
5.9 cm; all faces are drawn in by 0.1 mm, so that shapes next to each other do not touch.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.polycubes import polycube
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries import stored

VERSION = "1"
"""Version of the library: increase it whenever a shape changes, since packs refer to it."""

CELL_CM = 5.9

INSET_CM = 0.01
"""By how much faces are drawn in: more than half of the contact tolerance, 0.0074 cm here."""

SHAPES: dict[str, tuple[Triple, ...]] = {
    "i": ((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)),
    "l": ((0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 1, 0)),
    "left-screw": ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 0, 1)),
    "o": ((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)),
    "right-screw": ((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)),
    "s": ((0, 0, 0), (1, 0, 0), (1, 1, 0), (2, 1, 0)),
    "t": ((0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0)),
    "tripod": ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
}
"""The cells of each shape."""

ASSETS = Path(__file__).resolve().parents[1] / "assets"


def build(out: Path) -> None:
    """Write the library."""
    entries = []
    for id, cells in SHAPES.items():
        mesh = polycube(cells, INSET_CM / CELL_CM)
        x, y, z = (round(CELL_CM * extent, 2) for extent in mesh.extents.tolist())
        entries.append(
            stored.entry(
                Shape.from_mesh(mesh, id, "tetracube"),
                title=f"Tetracube {id}",
                author="PackIt-Sim",
                licence="CC0-1.0",
                source="scripts/build_blockout.py",
                size_cm=(x, y, z),
            )
        )
    everything = {"train": (), "test": tuple(SHAPES), "validation": ()}
    stored.write(out, "blockout", VERSION, entries, lambda infos: everything)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ASSETS / "blockout", help="folder to write")
    build(parser.parse_args().out)
