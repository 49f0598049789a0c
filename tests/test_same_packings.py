"""Searches of a fixed number of passes find what they found when the record was written.

To write `references/packings.json` anew, after a change that is meant: `python -m
tests.test_same_packings`. That forgets the records of other kinds of processors; `--add` keeps
them, for a kind that has none yet or not all.
"""

import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from llvmlite.binding import get_host_cpu_name
from trimesh import creation

from packit_sim import (
    BoxContainer,
    ItemType,
    NestSettings,
    Packing,
    PackSettings,
    Part,
    WallClearance,
    nest,
    pack,
)
from packit_sim.core.choices import Goal
from tests.packed_parts import joined, moved

RECORD = Path(__file__).parent / "references" / "packings.json"

Poses = list[list[float]]
"""For each item: type, box, translation, and two entries of its rotation."""


def processor() -> str:
    """The kind of processor for which kernels are compiled."""
    return f"{sys.platform} {get_host_cpu_name()}"


def meshes(count: int) -> list[trimesh.Trimesh]:
    """Rings, cones, plates and angles of different sizes, a few millimetres each."""
    rng = np.random.default_rng(7)
    found = []
    for n in range(count):
        a, b, c = rng.uniform(6, 16, 3)
        plate = creation.box((2 * a, b, 0.3 * c))
        four = (
            creation.annulus(r_min=0.6 * a, r_max=a, height=b, sections=12),
            creation.cone(radius=a, height=2 * b, sections=10),
            plate,
            joined(plate, moved(creation.box((0.3 * a, b, c)), 0.8 * a, 0, 0.6 * c)),
        )
        found.append(four[n % 4])
    return found


def items(count: int, rotations: str = "cube") -> list[ItemType]:
    return [
        ItemType(f"item {n}", mesh.vertices, mesh.faces, demand=1 + n % 2, rotations=rotations)
        for n, mesh in enumerate(meshes(count))
    ]


def nested(
    types: Sequence[ItemType],
    container: Sequence[float] | Sequence[BoxContainer],
    objective: str,
    clearance: float = 0.0,
) -> list[Packing]:
    given = NestSettings(workers=1, iterations=40)
    return [nest(types, container, objective, seed=3, clearance=clearance, settings=given)]


def filled(box: str, objective: Goal = "volume", count: int = 6, **settings: Any) -> list[Packing]:
    parts = [Part(f"{n}", mesh, 1 + n % 3) for n, mesh in enumerate(meshes(count))]
    given = PackSettings(workers=1, iterations=20, unit="mm", **settings)
    return list(pack(parts, box, objective, seed=3, settings=given).packings)


CASES: dict[str, Callable[[], list[Packing]]] = {
    "strip": lambda: nested(items(6), (40, 36, math.inf), "strip"),
    "strip, free": lambda: nested(items(3, "axis-6"), (36, 30, math.inf), "strip", clearance=1.0),
    "knapsack": lambda: nested(items(8), (40, 36, 30), "knapsack"),
    "bins": lambda: nested(items(8), [BoxContainer((40, 36, 30))], "bins"),
    "walls": lambda: filled(
        "50x45x40mm", wall_clearance=WallClearance(sides=2, floor=1), clearance=0.5
    ),
}
"""Searches by name."""


def poses(packings: Sequence[Packing]) -> Poses:
    """Describe the items of packings in order, with numbers rounded to thousandths."""
    return [
        [one.type, n if len(packings) > 1 else one.box]
        + [round(float(x), 3) for x in (*one.pose.translation, *one.pose.rotation[0, :2])]
        for n, packing in enumerate(packings)
        for one in packing.placements
    ]


@pytest.mark.parametrize("name", CASES)
def test_a_search_finds_what_it_found(name: str) -> None:
    records = json.loads(RECORD.read_text())
    if name not in records.get(processor(), {}):
        pytest.skip("rounding, which decides between equal places, differs between processors")
    found, recorded = poses(CASES[name]()), records[processor()][name]
    assert [pose[:2] for pose in found] == [pose[:2] for pose in recorded]
    assert np.array(found) == pytest.approx(np.array(recorded), abs=0.01)


if __name__ == "__main__":
    records: dict[str, Any] = json.loads(RECORD.read_text()) if sys.argv[1:] == ["--add"] else {}
    records[processor()] = {name: poses(search()) for name, search in CASES.items()}
    kinds = [
        f"{json.dumps(kind)}: {{\n"
        + ",\n".join(f"  {json.dumps(name)}: {json.dumps(own)}" for name, own in record.items())
        + "\n}"
        for kind, record in sorted(records.items())
    ]
    RECORD.write_text("{\n" + ",\n".join(kinds) + "\n}\n")
