"""Compare the largest scale that `packit_sim.fit` finds with the known one, for 20 pairs.

    .venv/bin/python -m benchmarks.fit --seconds 20

The pairs are regular bodies in regular containers, shapes in themselves, and long or flat parts
that only fit diagonally. Each scale is checked by the meshes. Writes
`benchmarks/results/fit.json`, and the table in `docs/benchmarks/parts.md`.
"""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh import creation

from benchmarks.common import (
    argument_parser,
    machine,
    markdown_table,
    write_into_page,
    write_json,
)
from packit_sim import (
    BoxContainer,
    CylinderContainer,
    ItemType,
    MeshContainer,
    PackSettings,
    Part,
    fit,
)
from packit_sim.parts.packings.containers import Container

FILE = "fit.json"

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "parts.md"

THIN = 1e-3
"""Thickness of the plate and of the rod."""


@dataclass(frozen=True)
class Pair:
    """A part and a container.

    Attributes
    ----------
    scale : float
        The largest scale, by geometry.
    why : str
        Where that is from.
    """

    name: str
    part: trimesh.Trimesh
    container: Container
    scale: float
    why: str
    rotations: str = "free"


def _inside(mesh: trimesh.Trimesh) -> MeshContainer:
    return MeshContainer(ItemType("container", mesh.vertices, mesh.faces))


def _solid(corners: Any) -> trimesh.Trimesh:
    return trimesh.convex.convex_hull(np.array(corners, float))


def _joined(*boxes: Any) -> trimesh.Trimesh:
    solids = [creation.box(bounds=bounds) for bounds in boxes]
    joined = trimesh.boolean.union(solids, engine="manifold")
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def pairs() -> list[Pair]:
    """Return the pairs: cubes have the side 1, and balls the radius 1."""
    cube, ball = creation.box((1, 1, 1)), creation.icosphere(subdivisions=4)
    tetrahedron = _solid([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
    octahedron = _solid([*np.eye(3), *-np.eye(3)])
    bracket = _joined(((0, 0, 0), (3, 1, 1)), ((0, 0, 0), (1, 2, 1)))
    bar = (1.5, 0.5, 0.5)
    cross = _joined(*((np.negative(np.roll(bar, n)), np.roll(bar, n)) for n in range(3)))
    stairs = _joined(((0, 0, 0), (3, 2, 1)), ((0, 0, 0), (2, 2, 2)), ((0, 0, 0), (1, 2, 3)))
    box, can = BoxContainer((1, 1, 1)), CylinderContainer
    own, croft = "a shape in itself", "Croft, 1980"
    return [
        Pair("cube in itself", cube, _inside(cube), 1.0, own),
        Pair("tetrahedron in itself", tetrahedron, _inside(tetrahedron), 1.0, own),
        Pair("octahedron in itself", octahedron, _inside(octahedron), 1.0, own),
        Pair("bracket in itself", bracket, _inside(bracket), 1.0, own),
        Pair("cross in itself", cross, _inside(cross), 1.0, own),
        Pair("stairs in itself", stairs, _inside(stairs), 1.0, own),
        Pair("cube in ball", cube, _inside(ball), 2 / math.sqrt(3), "its diagonal"),
        Pair("octahedron in ball", octahedron, _inside(ball), 1.0, "its diagonal"),
        Pair("ball in cube", ball, box, 0.5, "its diameter"),
        Pair("ball in tetrahedron", ball, _inside(tetrahedron), 1 / math.sqrt(3), "inscribed ball"),
        Pair("ball in octahedron", ball, _inside(octahedron), 1 / math.sqrt(3), "inscribed ball"),
        Pair("ball in bracket", ball, _inside(bracket), 0.5, "its thickness"),
        Pair("tetrahedron in cube", tetrahedron, box, 0.5, croft),
        Pair("octahedron in cube", octahedron, box, 0.75, croft),
        Pair("cube in octahedron", cube, _inside(octahedron), 2 * math.sqrt(2) - 2, croft),
        Pair("octahedron in tetrahedron", octahedron, _inside(tetrahedron), 1.0, croft),
        Pair("cube in upright cylinder", cube, can(2, 5), math.sqrt(2), "diagonal of its base"),
        Pair(
            "block that may not turn",
            creation.box((3, 2, 1)),
            BoxContainer((2, 3, 1)),
            2 / 3,
            "its longest side",
            "fixed",
        ),
        Pair("rod in cube", creation.box((1, THIN, THIN)), box, math.sqrt(3), "the diagonal"),
        Pair("plate in cube", creation.box((1, 1, THIN)), box, 0.75 * 2**0.5, "Prince Rupert"),
    ]


def measured(pair: Pair, seconds: float) -> dict[str, Any]:
    """Fit the part of a pair."""
    start = clock.perf_counter()
    part = Part(pair.name, pair.part, rotations=pair.rotations)
    found = fit(part, pair.container, seconds, settings=PackSettings(unit="mm"))
    return {
        "pair": pair.name,
        "known": pair.scale,
        "why": pair.why,
        "found": found.scale,
        "difference": found.scale / pair.scale - 1,
        "problems": found.packing.problems(),
        "seconds": clock.perf_counter() - start,
    }


def table(results: list[dict[str, Any]]) -> str:
    """Return the table of the page."""
    head = ["part and container", "known", "by", "found", "difference", "seconds"]
    rows = [
        (
            each["pair"],
            f"{each['known']:.4f}",
            each["why"],
            f"{each['found']:.4f}",
            f"{100 * each['difference']:+.2f}%",
            f"{each['seconds']:.1f}",
        )
        for each in results
    ]
    return markdown_table(head, rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    args = parser.parse_args()
    results = []
    for pair in pairs():
        results.append(measured(pair, args.seconds))
        print(results[-1], flush=True)
    write_json(args.out / FILE, machine() | {"seconds": args.seconds, "results": results})
    write_into_page(PAGE, table(results), "fit")
    worst = max(abs(each["difference"]) for each in results)
    valid = sum(not each["problems"] for each in results)
    print(f"{valid} of {len(results)} valid, largest difference {100 * worst:.2f}%")


if __name__ == "__main__":
    main()
