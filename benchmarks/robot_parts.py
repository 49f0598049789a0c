"""Let an arm execute packings of library parts that `packit pack` found, in their order.

    .venv/bin/python -m benchmarks.robot_parts --packings 20
    .venv/bin/python -m benchmarks.robot_parts --packings 20 --stable 5
    .venv/bin/python -m benchmarks.robot_parts --packings 20 --open

The selections are those of `benchmarks.packing_parts`, in boxes of 300 mm and less: parts that come
straight from above, 1 mm apart and 1 mm from the walls. Packings go into --work, from which a run
resumes. Prints a table with 95% intervals, and writes `benchmarks/results/robot-parts.json` after
each packing.
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.common import argument_parser, machine, markdown_table, write_json
from benchmarks.packing_parts import LIBRARY, UNIT_MM, parts_of, selection
from packit_sim import PackSettings, ShapeLibrary, pack
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.geometry.lattice import CELL
from packit_sim.parts.results.execution import execute_packing
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.executed_item import Outcome

SETTINGS = PackSettings(insertable=True, clearance=1.0, wall_clearance=1.0, unit="mm", workers=1)

COLUMNS = ("parts executed", "executed", "collapses", "displacement", "penetration", "seconds")


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--packings", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=60.0, help="time of the search")
    parser.add_argument("--stable", type=float, help="mm that parts may move under gravity")
    parser.add_argument("--arm", default="gantry")
    parser.add_argument("--open", action="store_true", help="the open loop")
    parser.add_argument("--work", type=Path, default=Path("build/robot-parts"))
    options = parser.parse_args()
    cell = RobotCell(
        options.arm,
        open_loop=options.open,
        decomposition=DecompositionSettings(method="bisection"),
    )
    settings = replace(SETTINGS, stable=options.stable)
    name = f"stable {options.stable:g} mm" if options.stable else "any"
    loop = f"{name}, {options.arm}, {'open' if options.open else 'closed'} loop"
    file = options.out / "robot-parts.json"
    known: dict[str, Any] = json.loads(file.read_text())["runs"] if file.exists() else {}
    library = ShapeLibrary.open(LIBRARY)
    for number in range(options.packings):
        key = f"{number}, {loop}"
        if key not in known:
            record = packed(library, number, options.seconds, options.work / name, settings)
            known[key] = measured(record, cell)
            write_json(file, {"machine": machine(), "runs": known})
            print(key, known[key], flush=True)
    runs = [run for key, run in known.items() if key.endswith(f", {loop}")]
    cells = [format_estimate(Estimate.of([run[name] for run in runs]), ".4f") for name in COLUMNS]
    print(markdown_table(("loop", "packings", *COLUMNS), [(loop, len(runs), *cells)]))


def packed(
    library: ShapeLibrary, number: int, seconds: float, work: Path, settings: PackSettings
) -> Path:
    """Pack a selection, unless that was done, and return its record."""
    folder = work / f"{number:02d}"
    if not (folder / "packing.json").exists():
        task = selection(library, number)
        sides = tuple(side * CELL * UNIT_MM for side in task.cells)
        pack(parts_of(task), sides, time=seconds, seed=number, out=folder, settings=settings)
    return folder / "packing.json"


def measured(record: Path, cell: RobotCell) -> dict[str, Any]:
    """Execute a packing of one box."""
    started = time.process_time()
    (box,) = execute_packing(record, cell)
    outcomes = [one.outcome for one in box.trajectory.attempts]
    return {
        "parts": len(outcomes),
        "parts executed": box.inside / len(outcomes),
        "executed": box.executed,
        "outcomes": {str(one): outcomes.count(one) for one in Outcome},
        **box.scores,
        "seconds": time.process_time() - started,
    }


if __name__ == "__main__":
    main()
