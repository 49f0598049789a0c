"""Pack parts whose best packing is known by construction, and measure what is missing.

    .venv/bin/python -m benchmarks.known_optima --seconds 60 --seeds 0 1 2
    .venv/bin/python -m benchmarks.known_optima --table

The cases are identical bricks that fill a box, a cube cut along the grid, cups that can only be
stacked, and bolts that have no place but in a tube. Each search ends when it has the optimum, or
with its time. Writes each result to `benchmarks/results/known_optima.json` at once: what has a
result is not packed again; --table writes the table of `docs/benchmarks/parts.md`.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from trimesh import Trimesh, creation

from benchmarks.common import argument_parser, machine, markdown_table, write_into_page, write_json
from packit_sim import PackedParts, PackSettings, Part, pack
from packit_sim.core.choices import Goal
from packit_sim.game.generation.puzzles import cut_puzzle
from packit_sim.parts import check

FILE = "known_optima.json"

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "parts.md"

SLACK = 1.001
"""The box's sides, relative to those of the optimum."""

SIDE_MM = 100.0
"""Side of the cube that is cut."""


class Case(NamedTuple):
    """Parts with a known optimum.

    Attributes
    ----------
    parts : list of Part
        The parts.
    box : tuple of float
        The box, in millimetres.
    objective : str
        "count", or "height".
    optimum : float
        The number of parts, or the height in millimetres.
    """

    parts: list[Part]
    box: tuple[float, float, float]
    objective: Goal
    optimum: float

    def value(self, packed: PackedParts) -> float:
        """Return what the objective counts."""
        return packed.height if self.objective == "height" else float(packed.count)

    def is_reached(self, packed: PackedParts) -> bool:
        """Return whether a packing is optimal, in height within `SLACK`."""
        if self.objective == "count":
            return packed.count == self.optimum
        return packed.count == sum(p.count for p in self.parts) and (
            packed.height <= SLACK * self.optimum
        )


def bricks() -> Case:
    """27 bricks that fill a box, if all lie alike."""
    size = np.array((20.0, 30.0, 40.0))
    brick = Part("brick", creation.box(size), count=27, rotations="axis-4")
    return Case([brick], _box(3 * size), "count", 27)


def cut_cube() -> Case:
    """The eight cuboids of a cube, which is cut by planes of the grid."""
    cube = cut_puzzle("guillotine", 8, seed=0)
    pieces = [
        Part(f"piece-{n}", placed.item.mesh.copy().apply_scale(SIDE_MM), rotations="cube")
        for n, placed in enumerate(cube.placed)
    ]
    return Case(pieces, _box(np.full(3, SIDE_MM)), "count", len(pieces))


def cups() -> Case:
    """Six cups in a box just as wide: stacked, each is a wall's thickness above the other."""
    count, radius, height, wall = 6, 30.0, 40.0, 4.0
    profile = [(0, 0), (15, 0), (radius, height), (radius, height + wall), (15, wall), (0, wall)]
    cup = creation.revolve(profile, sections=48)
    box = _box(np.array((2 * radius, 2 * radius, count * (height + wall))))
    part = Part("cup", cup, count=count, rotations="axis-4")
    return Case([part], box, "height", height + count * wall)


def bolts_in_tube() -> Case:
    """Four bolts, and a tube in which they are in a row: the box has no room beside the tube."""
    radius, length, count = 12.0, 30.0, 4
    tube = creation.annulus(radius + 0.5, radius + 3, count * (length + 0.5), sections=64)
    bolt = _bolt(radius, length)
    size = np.array((2 * (radius + 3), 2 * (radius + 3), count * (length + 0.5)))
    parts = [Part("tube", tube, rotations="axis-4"), Part("bolt", bolt, count, rotations="axis-4")]
    return Case(parts, _box(size), "count", count + 1)


CASES: dict[str, Callable[[], Case]] = {
    "27 bricks that fill a box": bricks,
    "a cube cut into 8 cuboids": cut_cube,
    "6 cups that stack": cups,
    "4 bolts in a tube": bolts_in_tube,
}


def measure(case: Case, seconds: float, seed: int, workers: int) -> dict[str, Any]:
    """Search until the optimum is found.

    Parameters
    ----------
    case : Case
        The parts.
    seconds : float
        The most seconds of the search.
    seed : int
        Its seed.
    workers : int
        Its threads; 0: one per core.

    Returns
    -------
    dict
        The value reached, whether it is the optimum, after how many seconds the last better
        packing came, and the number of problems that the check finds.
    """
    found = threading.Event()
    last = 0.0

    def better(packed: PackedParts, at: float) -> None:
        nonlocal last
        last = at
        if case.is_reached(packed):
            found.set()

    settings = PackSettings(workers=workers, stop=found)
    packed = pack(case.parts, case.box, case.objective, seconds, seed, None, better, settings)
    return {
        "value": case.value(packed),
        "optimum": case.optimum,
        "reached": case.is_reached(packed),
        "seconds": round(last, 1),
        "problems": len(check(packed).problems),
    }


def table(runs: Mapping[str, Mapping[str, Any]]) -> str:
    """Tabulate the results in Markdown: a row for each case."""
    rows = []
    for name in CASES:
        own = [run for run in runs.values() if run["case"] == name]
        if not own:
            continue
        values = ", ".join(f"{run['value']:.4g}" for run in own)
        reached = f"{sum(run['reached'] for run in own)} of {len(own)}"
        seconds = ", ".join(f"{run['seconds']:g}" for run in own)
        problems = str(sum(run["problems"] for run in own))
        rows.append((name, f"{own[0]['optimum']:g}", values, reached, seconds, problems))
    head = ("parts", "optimum", "reached by each search", "optimal", "after seconds", "problems")
    return markdown_table(head, rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--workers", type=int, default=0, help="threads; 0: one per core")
    parser.add_argument("--table", action="store_true", help="write the table of the page")
    arguments = parser.parse_args()
    file: Path = arguments.out / FILE
    runs: dict[str, Any] = json.loads(file.read_text())["runs"] if file.exists() else {}
    for name, case in CASES.items() if not arguments.table else ():
        for seed in arguments.seeds:
            key = f"{name}, seed {seed}, {arguments.seconds:g} s"
            if key in runs:
                continue
            found = measure(case(), arguments.seconds, seed, arguments.workers)
            runs[key] = {"case": name, "seed": seed, **found}
            head = {"command": "python -m benchmarks.known_optima", "machine": machine()}
            write_json(file, {**head, "runs": runs})
            print(key, found, flush=True)
    if arguments.table:
        write_into_page(PAGE, table(runs))
    print(table(runs))


def _box(size: Any) -> tuple[float, float, float]:
    x, y, z = (SLACK * float(side) for side in size)
    return x, y, z


def _bolt(radius: float, length: float) -> Trimesh:
    """Build a bolt along z: a head as wide as the tube, and a shaft."""
    profile = [(0, 0), (radius, 0), (radius, 8), (radius / 2, 8), (radius / 2, length), (0, length)]
    return creation.revolve(profile, sections=32)


if __name__ == "__main__":
    main()
