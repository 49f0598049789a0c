"""Let a gantry pack the boxes that the champion plans, with the loop closed and open.

    .venv/bin/python -m benchmarks.robot --tasks 50

The first tasks of a dataset, level 1, a box of 0.30 m, seed 0, one process. Pieces come from
bisection, which takes about a second a shape. Results and trajectories go into --work, from which a
run resumes; `packit verify` recomputes them. Prints a table with 95% intervals, and writes
`benchmarks/results/robot.json`.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, write_json
from packit_sim import Rules, evaluate
from packit_sim.core.confidence import Comparison, Estimate, format_estimate
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.evaluation.results import Rollout
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.measures import MEASURES

AGENT = "champion"

CELLS = {
    "closed loop": RobotCell(decomposition=DecompositionSettings(method="bisection")),
    "open loop": RobotCell(decomposition=DecompositionSettings(method="bisection"), open_loop=True),
}


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--dataset", default="everyday-v1")
    parser.add_argument("--split", default="test")
    parser.add_argument("--tasks", type=int, default=50)
    parser.add_argument("--work", type=Path, default=Path("build/robot"), help="for trajectories")
    options = parser.parse_args()
    tasks = load_tasks(options.dataset, split=options.split)[: options.tasks]
    found: dict[str, list[Rollout]] = {}
    for count in range(1, len(tasks) + 1):  # so that a run that is stopped has both for each task
        for name, cell in CELLS.items():
            file = options.work / f"{options.dataset}-{name.replace(' ', '-')}.jsonl"
            rules = Rules(robot=cell)
            found[name] = evaluate([AGENT], tasks[:count], seed=0, rules=rules, file=file)
            rollout = found[name][-1]
            print(f"task {count - 1}, {name}: {rollout.total:.3f} of {rollout.played.scores}")
    report(options.out, options.dataset, options.split, found)


def report(out: Path, dataset: str, split: str, found: dict[str, list[Rollout]]) -> None:
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
        table.add_row(key, *(format_estimate(row[key], ".4f") for row in rows.values()))
    closed, opened = ([one.total for one in rollouts] for rollouts in found.values())
    loop = Comparison.of(closed, opened, 1e-9)
    table.add_row("closed minus open", format_estimate(loop.difference, "+.4f"))
    Console().print(table)
    result = {
        "dataset": dataset,
        "split": split,
        "agent": AGENT,
        "tasks": loop.pairs,
        "machine": machine(),
        "cells": {name: asdict(cell) for name, cell in CELLS.items()},
        "means": {
            name: {key: asdict(one) for key, one in row.items()} for name, row in rows.items()
        },
        "closed minus open": asdict(loop.difference),
        "each": {
            name: [
                {"task": r.task, "executed": r.total, "seconds": r.seconds, **r.played.scores}
                for r in rollouts
            ]
            for name, rollouts in found.items()
        },
    }
    write_json(out / "robot.json", result)


if __name__ == "__main__":
    main()
