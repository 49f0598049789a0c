"""Compare densities in a cylinder and in closed meshes with those in a box of equal volume.

    .venv/bin/python -m benchmarks.containers --selections 5 --seconds 60 --workers 2
    .venv/bin/python -m benchmarks.containers --table

A selection has eight copies each of eight random shapes of `everyday`, whose volumes add up to 1.2
times the container's. All containers have the volume of a cube of 300 mm; the meshes are made by
formula. Each packing is checked by its files. Writes each result to
`benchmarks/results/containers.json` at once: what has a result is not packed again; --table writes
the table of `docs/benchmarks/parts.md`.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh
from trimesh import creation

from benchmarks.common import argument_parser, machine, markdown_table, write_into_page, write_json
from benchmarks.packing_parts import LIBRARY, PAGE, UNIT_MM, parts_of, selection
from packit_sim import (
    BoxType,
    CylinderContainer,
    ItemType,
    MeshContainer,
    PackSettings,
    ShapeLibrary,
    pack,
)
from packit_sim.core.confidence import Estimate
from packit_sim.parts import check

FILE = "containers.json"

BLOCK = "containers"
"""Between these comments the page has the table."""

COUNT = 8
"""Shapes of a selection."""

COPIES = 8
"""Copies of each."""


def containers() -> dict[str, BoxType | CylinderContainer | MeshContainer]:
    """Return the containers by name, each of the same volume."""
    side = UNIT_MM
    return {
        "box": BoxType((side, side, side)),
        "cylinder": CylinderContainer(2 * side / math.sqrt(math.pi), side),
        "L-shaped case": _mesh("L-shaped case", _case()),
        "trunk": _mesh("trunk", _trunk()),
        "bottle": _mesh("bottle", _bottle()),
    }


def _mesh(name: str, mesh: trimesh.Trimesh) -> MeshContainer:
    mesh.apply_scale(UNIT_MM / np.cbrt(mesh.volume))
    return MeshContainer(ItemType(name, mesh.vertices, mesh.faces), name=name)


def _case() -> trimesh.Trimesh:
    """A block of 2 x 2 x 1 without a quarter."""
    whole = creation.box(bounds=((0, 0, 0), (2, 2, 1)))
    quarter = creation.box(bounds=((1, 1, -1), (3, 3, 2)))
    return trimesh.boolean.difference([whole, quarter], engine="manifold")


def _trunk() -> trimesh.Trimesh:
    """0.9 x 1 x 0.45, with a slanted lid and an arch for a wheel at each side."""
    side = [(0, 0), (0.9, 0), (0.9, 0.3), (0.7, 0.45), (0, 0.45)]
    shell = trimesh.convex.convex_hull(np.array([(x, y, z) for y in (0, 1) for x, z in side]))
    turn = trimesh.transformations.rotation_matrix(math.pi / 2, (1, 0, 0))
    arch = creation.cylinder(0.18, 0.3, sections=48).apply_transform(turn)
    arches = [arch.copy().apply_translation((0.3, y, 0.06)) for y in (0, 1)]
    return trimesh.boolean.difference([shell, *arches], engine="manifold")


def _bottle() -> trimesh.Trimesh:
    """A body of radius 1, round shoulders, and a neck of radius 0.4."""
    shoulder = [(math.cos(a), 2 + math.sin(a)) for a in np.linspace(0, math.acos(0.4), 9)]
    outline = [(0, 0), (1, 0), *shoulder, (0.4, 3.4), (0, 3.4)]
    return creation.revolve(np.array(outline), sections=48)


def measure(seed: int, name: str, seconds: float, workers: int) -> dict[str, Any]:
    """Pack a selection into a container.

    Parameters
    ----------
    name : str
        The container's name.
    seconds : float
        The time of the command.
    workers : int
        Searches at a time.

    Returns
    -------
    dict
        The density, the number of parts, the seconds and the problems of the packing.
    """
    task = selection(ShapeLibrary.open(LIBRARY), seed, (100, 100, 100), COUNT)
    parts = [replace(each, count=COPIES) for each in parts_of(task)]
    for each in parts:
        each.mesh.apply_scale(COPIES ** (-1 / 3))
    start = time.perf_counter()
    settings = PackSettings(workers=workers)
    packed = pack(parts, containers()[name], time=seconds, seed=seed, settings=settings)
    spent = time.perf_counter() - start
    return {
        "density": round(packed.density, 4),
        "parts": packed.count,
        "seconds": round(spent, 1),
        "problems": len(check(packed).problems),
    }


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the page."""
    rows = []
    known = {(each["selection"], each["container"]): each for each in results}
    for name in dict.fromkeys(each["container"] for each in results):
        own = [each for each in results if each["container"] == name]
        ratios = [each["density"] / known[each["selection"], "box"]["density"] for each in own]
        rows.append(
            (
                name,
                len(own),
                f"{Estimate.of([each['density'] for each in own]).mean:.3f}",
                f"{Estimate.of(ratios).mean:.3f} ({min(ratios):.3f} to {max(ratios):.3f})",
                f"{sum(each['parts'] for each in own) / len(own):.1f}",
                sum(each["problems"] for each in own),
            )
        )
    head = ("container", "selections", "density", "ratio to the box (range)", "parts", "problems")
    return markdown_table(head, rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--selections", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each command")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--table", action="store_true", help="only write the table")
    arguments = parser.parse_args()
    file = arguments.out / FILE
    content = json.loads(file.read_text()) if file.exists() else {"results": []}
    results: list[dict[str, Any]] = content["results"]
    if not arguments.table:
        done = {(each["selection"], each["container"]) for each in results}
        for seed in range(arguments.selections):
            for name in containers():
                if (seed, name) in done:
                    continue
                found = measure(seed, name, arguments.seconds, arguments.workers)
                print(seed, name, found, flush=True)
                results.append({"selection": seed, "container": name, **found})
                about = {"seconds": arguments.seconds, "workers": arguments.workers}
                write_json(file, {**machine(), **about, "results": results})
    write_into_page(PAGE, table(results), BLOCK)


if __name__ == "__main__":
    main()
