"""How the time to execute a packing grows with the number of its parts.

    .venv/bin/python -m benchmarks.robot_growth --counts 10 100
    .venv/bin/python -m benchmarks.robot_growth --counts 1000

Cubes of 20 mm, 1 mm apart, fill a box layer by layer; the gantry puts them in, in a closed loop.
Writes `benchmarks/results/robot_growth.json`; counts that it has already stay in it. A run that is
interrupted goes on where it was: every 20 parts, what it did so far is written next to that file.
"""

from __future__ import annotations

import json
import pickle
import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.common import argument_parser, machine, markdown_table, write_json
from packit_sim import DecompositionSettings, Item, RobotCell, Shape
from packit_sim.core.files import replacing
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.motions import Motion
from packit_sim.robot.executed_item import ExecutedItem
from packit_sim.robot.plans import execute_plan

SIDE, GAP = 0.020, 0.001
"""Sides and distances of the cubes, m."""

EVERY = 20
"""Parts after which what was done so far is written."""

COLUMNS = ("inside", "collapses", "seconds", "seconds a part", "robot seconds", "penetration")


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[10, 100, 1000])
    options = parser.parse_args()
    file = options.out / "robot_growth.json"
    known: dict[str, Any] = json.loads(file.read_text())["counts"] if file.exists() else {}
    for count in options.counts:
        known[str(count)] = measured(count, options.out / f"robot_growth_{count}.pickle")
        ordered = {key: known[key] for key in sorted(known, key=int)}
        write_json(file, {"machine": machine(), "counts": ordered})
        rows = [(key, *(f"{row[one]:.4g}" for one in COLUMNS)) for key, row in ordered.items()]
        print(markdown_table(("parts", *COLUMNS), rows), flush=True)


def measured(count: int, interrupted: Path) -> dict[str, float]:
    """Execute a packing of cubes in a box that is about as high as it is wide."""
    columns = int(np.ceil(np.cbrt(count)))
    layers = -(-count // columns**2)
    sides = np.array((columns, columns, layers)) * (SIDE + GAP) + GAP
    edge = float(sides.max())
    cube = Shape.from_mesh(trimesh.creation.box((1, 1, 1)), "cube")
    item = Item(cube, scale=(SIDE / edge / float(cube.mesh.extents.max())) ** 3)
    places = np.argwhere(np.ones((layers, columns, columns)))[:count, ::-1]
    corners = GAP + places * (SIDE + GAP)
    centers = (corners + SIDE / 2 - (0, 0, GAP)) / edge
    plan = [PosedItem.at(item, Motion.shift(center)) for center in centers]
    cell = RobotCell(edge=edge, decomposition=DecompositionSettings(method="bisection"))
    x, y, z = (100 * sides / edge).tolist()
    before, tried = pickle.loads(interrupted.read_bytes()) if interrupted.exists() else (0.0, ())
    start = time.process_time() - before

    def keep(tried: tuple[ExecutedItem, ...]) -> None:
        if len(tried) % EVERY == 0:
            with replacing(interrupted) as file:
                file.write(pickle.dumps((time.process_time() - start, tried)))

    done = execute_plan(plan, (x, y, z), cell, tried=tried, callback=keep)
    seconds = time.process_time() - start
    interrupted.unlink(missing_ok=True)
    return {
        "inside": done.inside,
        "collapses": done.scores["collapses"],
        "seconds": seconds,
        "seconds a part": seconds / count,
        "robot seconds": done.scores["robot seconds"],
        "penetration": done.scores["penetration"],
    }


if __name__ == "__main__":
    main()
