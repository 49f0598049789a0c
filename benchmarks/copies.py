"""Count how many copies of each of five parts fit into a box, beside a grid of bounding boxes.

    .venv/bin/python -m benchmarks.copies --seconds 60
    .venv/bin/python -m benchmarks.copies --boat 3DBenchy.3mf --seconds 60

The parts are a bracket and a gear made by formula, and a cup, a rowboat and a doll of `everyday`,
with a longest side of 60 mm; the box is 300 mm wide each way, the clearance 1 mm. `--boat` packs
copies of a mesh file, which is not part of the project, into 165 x 165 x 320 mm. Two workers;
seconds are of the wall. Each packing is checked by the meshes. Writes
`benchmarks/results/copies.json` and the table of `docs/benchmarks/parts.md`.
"""

from __future__ import annotations

import json
import math
import time
from itertools import permutations
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
from packit_sim import ItemType, NestSettings, Packing, ShapeLibrary, nest
from packit_sim.parts.packings.builtin_instances import gear

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "parts.md"

BLOCK = "copies"
"""Between these comments the page has the table."""

FILE = "copies.json"

LONGEST = 60.0
"""The longest side of a part, in mm."""

BOX = 300.0, 300.0, 300.0

CHAMBER = 165.0, 165.0, 320.0

CLEARANCE = 1.0

FULLEST = 0.7
"""Share of the box that copies fill at most, for their number."""


def bracket() -> trimesh.Trimesh:
    """Return an L of two plates, half as wide as long, and a tenth as thick."""
    plates = [
        trimesh.creation.box(bounds=[(0, 0, 0), (10, 5, 1)]),
        trimesh.creation.box(bounds=[(0, 0, 0), (1, 5, 10)]),
    ]
    joined: trimesh.Trimesh = trimesh.boolean.union(plates, engine="manifold")
    return joined


def parts() -> dict[str, trimesh.Trimesh]:
    """Return the meshes of the five parts by name."""
    library = ShapeLibrary.open("everyday")
    found = {"bracket": bracket(), "gear": gear(np.random.default_rng(0))}
    for name, shape in (("cup", "cup"), ("boat", "rowboat"), ("figurine", "doll")):
        found[name] = trimesh.Trimesh(library[shape].mesh.vertices, library[shape].mesh.faces)
    for mesh in found.values():
        mesh.apply_scale(LONGEST / max(mesh.extents))
    return found


def grid(mesh: trimesh.Trimesh, size: tuple[float, float, float]) -> int:
    """Return how many bounding boxes fit in a grid, turned as is best."""
    return max(
        math.prod(
            int((side + CLEARANCE) / (own + CLEARANCE))
            for side, own in zip(size, sides, strict=True)
        )
        for sides in permutations(mesh.extents)
    )


def measure(
    mesh: trimesh.Trimesh, size: tuple[float, float, float], seconds: float
) -> dict[str, Any]:
    """Fill a box with copies of a mesh."""
    demand = int(FULLEST * math.prod(size) / abs(mesh.volume))
    history: list[tuple[float, int]] = []
    started = time.perf_counter()

    def note(packing: Packing, _: float) -> None:
        history.append((round(time.perf_counter() - started, 1), len(packing.placements)))

    part = ItemType("part", mesh.vertices, mesh.faces, demand=min(demand, 10 * grid(mesh, size)))
    settings = NestSettings(workers=2)
    packing = nest([part], size, "knapsack", seconds, 0, CLEARANCE, note, settings)
    return {
        "copies": len(packing.placements),
        "grid": grid(mesh, size),
        "history": history,
        "seconds": round(time.perf_counter() - started, 1),
        "problems": packing.problems(),
    }


def table(runs: dict[str, dict[str, Any]]) -> str:
    """Tabulate the runs in Markdown."""
    rows = [
        (
            name,
            run["history"][0][0],
            run["history"][0][1],
            run["seconds"],
            run["copies"],
            run["grid"],
            f"{run['copies'] / run['grid']:.2f}",
            len(run["problems"]),
        )
        for name, run in runs.items()
    ]
    ratios = [run["copies"] / run["grid"] for run in runs.values()]
    head = (
        "part",
        "first after, s",
        "copies in it",
        "time, s",
        "copies at the end",
        "in a grid",
        "ratio",
        "problems",
    )
    return markdown_table(head, rows) + f"\nMean ratio {np.mean(ratios):.2f}.\n"


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--boat", type=Path, help="a mesh file for the chamber")
    arguments = parser.parse_args()
    file = arguments.out / FILE
    runs = json.loads(file.read_text())["runs"] if file.exists() else {}
    if arguments.boat:
        found = measure(trimesh.load_mesh(arguments.boat), CHAMBER, arguments.seconds)
        print(arguments.boat.name, found)
        return
    for name, mesh in parts().items():
        runs[name] = measure(mesh, BOX, arguments.seconds)
        print(name, runs[name]["history"][0], runs[name]["copies"], runs[name]["grid"], flush=True)
        head = {"command": "python -m benchmarks.copies", "machine": machine()}
        write_json(file, {**head, "seconds": arguments.seconds, "runs": runs})
    if arguments.out == RESULTS:
        write_into_page(PAGE, table(runs), BLOCK)


if __name__ == "__main__":
    main()
