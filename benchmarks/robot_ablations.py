"""Change one part of the robot cell at a time, and let an agent pack the same tasks.

    .venv/bin/python -m benchmarks.robot_ablations --tasks 3

Reachability in the masks, the closed loop, the radius of the cup and the edge of the box, each
against the gantry's cell of `benchmarks.robot`: level 1, seed 0, pieces by bisection, but items of
40 kg/m3. The tasks are the first of the validation split of everyday-v1. Results go into --work,
from which a run resumes. Prints a table with 95% intervals, and writes
`benchmarks/results/robot-ablations.json` after each task.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path

from benchmarks.common import argument_parser, machine, markdown_table, write_json
from packit_sim import Rules, evaluate
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.evaluation.results import Rollout
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.robot.cell import RobotCell, SuctionGripper

CELL = RobotCell(density=40.0, decomposition=DecompositionSettings(method="bisection"))
"""Items are so light that the smallest cup lifts each."""


def _cup(radius: float) -> SuctionGripper:
    """Return a gripper of one cup, which lifts the heaviest item with 5 mm too."""
    return SuctionGripper(cups=(radius,), safety=1.9)


CELLS = {
    "the cell": CELL,
    "all masks": replace(CELL, reachable=False),
    "open loop": replace(CELL, open_loop=True),
    "cup 5 mm": replace(CELL, gripper=_cup(0.005)),
    "cup 8 mm": replace(CELL, gripper=_cup(0.008)),
    "cup 12 mm": replace(CELL, gripper=_cup(0.012)),
    "edge 0.2 m": replace(CELL, edge=0.2),
    "edge 0.4 m": replace(CELL, edge=0.4),
}
"""The cells that are compared, each with one change to the first."""

COLUMNS = ("planned", "failed grasps", "no path", "collapses", "displacement", "penetration")


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--tasks", type=int, default=3)
    parser.add_argument("--agent", default="champion")
    parser.add_argument("--work", type=Path, default=Path("build/robot-ablations"))
    options = parser.parse_args()
    tasks = load_tasks("everyday-v1", split="validation")[: options.tasks]
    found: dict[str, list[Rollout]] = {}
    for count in range(1, len(tasks) + 1):
        for name, cell in CELLS.items():
            file = options.work / f"{options.agent}-{name.replace(' ', '-')}.jsonl"
            rules = Rules(robot=cell)
            found[name] = evaluate([options.agent], tasks[:count], seed=0, rules=rules, file=file)
            print(f"task {count - 1}, {name}: {found[name][-1].total:.3f}", flush=True)
        report(options, found)


def report(options: argparse.Namespace, found: dict[str, list[Rollout]]) -> None:
    """Print the table, and write the result file."""
    rows, kept = [], {}
    for name, rollouts in found.items():
        columns = {"executed": [one.total for one in rollouts]}
        columns |= {key: [one.played.scores[key] for one in rollouts] for key in COLUMNS}
        columns["seconds"] = [one.seconds for one in rollouts]
        means = {key: Estimate.of(values) for key, values in columns.items()}
        rows.append((name, len(rollouts), *(format_estimate(x, ".3f") for x in means.values())))
        kept[name] = {"cell": asdict(CELLS[name]), "tasks": len(rollouts), **columns}
    print(markdown_table(("cell", "tasks", "executed", *COLUMNS, "seconds"), rows), flush=True)
    content = {"agent": options.agent, "machine": machine(), "cells": kept}
    write_json(options.out / "robot-ablations.json", content)


if __name__ == "__main__":
    main()
