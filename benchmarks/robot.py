"""Let an arm pack the boxes that an agent plans, with the loop closed and open.

    .venv/bin/python -m benchmarks.robot --tasks 50
    .venv/bin/python -m benchmarks.robot --tasks 50 --arm panda --closed
    .venv/bin/python -m benchmarks.robot --tasks 6 --agent champion
    .venv/bin/python -m benchmarks.robot --tasks 6 --level 2 --closed

The first tasks of a dataset, level 1 or --level 2, a box of 0.30 m, seed 0, one process. Pieces
come from bisection, which takes about a second a shape. Results and trajectories go into --work,
from which a run resumes; `packit verify` recomputes them. Prints a table with 95% intervals and the
failures, and writes `benchmarks/results/robot-ARM-AGENT-DATASET.json`, or `...-level-2.json`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, write_json
from packit_sim import Rules, ShapeLibrary, evaluate
from packit_sim.core.confidence import Comparison, Estimate, format_estimate
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.evaluation.results import Rollout, stored_trajectory
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.executed_item import Outcome, movement
from packit_sim.robot.measures import MEASURES, resting_poses

FAILURES = ("no grasp", "no path", "lost", "displaced", "collapsed", "not inside")
"""Outcomes of items that are counted; displaced: at rest more than 2 cm or 15 degrees from plan."""

UNITS = {"displacement": "m", "turn": "degrees", "penetration": "m"}
"""The units of the measures, by the last word of a row."""


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--dataset", default="everyday-v1")
    parser.add_argument("--split", default="test")
    parser.add_argument("--tasks", type=int, default=50)
    parser.add_argument("--work", type=Path, default=Path("build/robot"), help="for trajectories")
    parser.add_argument("--arm", default="gantry")
    parser.add_argument("--level", type=int, default=1)
    parser.add_argument("--agent", default="stable-champion")
    parser.add_argument("--closed", action="store_true", help="only the closed loop")
    options = parser.parse_args()
    pieces = DecompositionSettings(method="bisection")
    closed = RobotCell(options.arm, level=options.level, decomposition=pieces)
    cells = {"closed loop": closed}
    if not options.closed:
        cells["open loop"] = replace(closed, open_loop=True)
    start = options.dataset if options.arm == "gantry" else f"{options.dataset}-{options.arm}"
    start += _level(options)
    files = {name: options.work / f"{start}-{name.replace(' ', '-')}.jsonl" for name in cells}
    tasks = load_tasks(options.dataset, split=options.split)[: options.tasks]
    found: dict[str, list[Rollout]] = {}
    for count in range(1, len(tasks) + 1):  # so that a run that is stopped has both for each task
        for name, cell in cells.items():
            rules = Rules(robot=cell)
            found[name] = evaluate(
                [options.agent], tasks[:count], seed=0, rules=rules, file=files[name]
            )
            rollout = found[name][-1]
            print(f"task {count - 1}, {name}: {rollout.total:.3f} of {rollout.played.scores}")
    items = {name: failures(files[name], one) for name, one in found.items()}
    report(options, cells, found, items)


def failures(file: Path, rollouts: Sequence[Rollout]) -> dict[str, int]:
    """Count the items of each of `FAILURES`, and all that were tried, in recorded trajectories."""
    library = ShapeLibrary.open(rollouts[0].pack.library.name)
    counts = dict.fromkeys(("tried", *FAILURES), 0)
    for rollout in rollouts:
        trajectory = stored_trajectory(file, rollout, library)
        ends = resting_poses(trajectory)
        for n, one in enumerate(trajectory.attempts):
            counts["tried"] += 1
            if one.outcome is not Outcome.PLACED:
                counts[one.outcome.value] += 1
                continue
            counts["displaced"] += movement(one.planned, ends[n][n]) > 1
            counts["collapsed"] += any(movement(ends[n][n], end[n]) > 1 for end in ends[n + 1 :])
            counts["not inside"] += not trajectory.cell.holds(trajectory.cells, ends[-1][n])
    return counts


def report(
    options: argparse.Namespace,
    cells: dict[str, RobotCell],
    found: dict[str, list[Rollout]],
    items: dict[str, dict[str, int]],
) -> None:
    """Print the table, and write the result file."""
    table = Table("mean of tasks", *found)
    rows = {}
    for name, rollouts in found.items():
        columns = {"executed": [one.total for one in rollouts]}
        columns |= {key: [one.played.scores[key] for one in rollouts] for key in MEASURES}
        planned, total = columns["planned"], columns["executed"]
        columns["loss"] = [a - b for a, b in zip(planned, total, strict=True)]
        columns["processor seconds"] = [one.seconds for one in rollouts]
        rows[name] = {key: Estimate.of(values) for key, values in columns.items()}
        rows[name]["largest penetration"] = Estimate(max(columns["penetration"]), None, None)
    for key in next(iter(rows.values())):
        unit = UNITS.get(key.split()[-1])
        shown = f"{key}, {unit}" if unit else key
        table.add_row(shown, *(format_estimate(row[key], ".4f") for row in rows.values()))
    for key in next(iter(items.values())):
        table.add_row(f"items: {key}", *(str(row[key]) for row in items.values()))
    totals = [[one.total for one in rollouts] for rollouts in found.values()]
    loop = Comparison.of(totals[0], totals[1], 1e-9).difference if len(totals) == 2 else None
    if loop is not None:
        table.add_row("closed minus open", format_estimate(loop, "+.4f"))
    Console().print(table)
    result = {
        "dataset": options.dataset,
        "split": options.split,
        "agent": options.agent,
        "tasks": len(totals[0]),
        "machine": machine(),
        "cells": {name: asdict(cell) for name, cell in cells.items()},
        "means": {
            name: {key: asdict(one) for key, one in row.items()} for name, row in rows.items()
        },
        "closed minus open": None if loop is None else asdict(loop),
        "items": items,
        "each": {
            name: [
                {"task": r.task, "executed": r.total, "seconds": r.seconds, **r.played.scores}
                for r in rollouts
            ]
            for name, rollouts in found.items()
        },
    }
    name = f"robot-{options.arm}-{options.agent}-{options.dataset}{_level(options)}.json"
    write_json(options.out / name, result)


def _level(options: argparse.Namespace) -> str:
    return "" if options.level == 1 else f"-level-{options.level}"


if __name__ == "__main__":
    main()
