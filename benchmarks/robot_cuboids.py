"""Let an arm pack cuboids that arrive one by one in runs of equal sizes, as a production line does.

    .venv/bin/python -m benchmarks.robot_cuboids --tasks 100

Each task draws four sizes from its number, about those of cartons in a box of 1.2 m. Runs of
3 to 8 equal cuboids follow each other until their volume is 1.1 times the box's. One is visible at
a time and is placed in one of four rotations about the vertical; the first that does not fit ends
the task, as in RoboBPP. The gantry packs a box of 0.30 m at level 1. Prints the mean share of the
box that is filled at the end, with a 95% interval, and writes
`benchmarks/results/robot-cuboids-AGENT.json` after each task, from which a run resumes.
"""

from __future__ import annotations

import json
import math
import time
from typing import Any

import numpy as np
from trimesh import creation

from benchmarks.common import argument_parser, machine, markdown_table, write_json
from packit_sim import Agent, Episode, Rules
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.packs import LibraryRef, Pack, Task
from packit_sim.geometry.lattice import BOX_CELLS
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.executed_item import Outcome
from packit_sim.robot.measures import measures
from packit_sim.robot.trajectory import Trajectory

SIZES = 4
"""Sizes in a task."""

LOW, HIGH = (0.28, 0.16, 0.14), (0.36, 0.27, 0.24)
"""Ranges of length, width and height, in box units."""

RUN = (3, 9)
"""The least number of equal cuboids in a run, and the first that is too large."""

VOLUME = 1.1
"""Volume of a task's cuboids, relative to the box's."""

COLUMNS = ("utilisation", "planned", "collapses", "failed grasps", "no path", "items", "seconds")


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--tasks", type=int, default=100)
    parser.add_argument("--agent", default="stable-champion")
    parser.add_argument("--arm", default="gantry")
    options = parser.parse_args()
    cell = RobotCell(options.arm, decomposition=DecompositionSettings(method="bisection"))
    file = options.out / f"robot-cuboids-{options.agent.replace('/', '-')}.json"
    known: dict[str, Any] = json.loads(file.read_text())["tasks"] if file.exists() else {}
    agent = Agent.from_name(options.agent)
    for number in range(options.tasks):
        key = f"{options.arm}, {number}"
        if key not in known:
            known[key] = measured(agent, cuboids(number), cell)
            write_json(file, {"machine": machine(), "tasks": known})
            print(key, known[key], flush=True)
    runs = [run for key, run in known.items() if key.startswith(f"{options.arm}, ")]
    cells = [format_estimate(Estimate.of([run[name] for run in runs]), ".3f") for name in COLUMNS]
    print(markdown_table(("agent", "tasks", *COLUMNS), [(agent.name, len(runs), *cells)]))


def cuboids(number: int) -> Task:
    """Return a task, whose number is its seed."""
    rng = np.random.default_rng(number)
    sides = rng.uniform(LOW, HIGH, (SIZES, 3)).round(3).tolist()
    items: list[Item] = []
    while plain_sum(item.volume for item in items) < VOLUME:
        x, y, z = sides[rng.integers(SIZES)]
        shape = Shape.from_mesh(creation.box((x, y, z)), f"cuboid-{x}-{y}-{z}")
        items += [Item(shape, math.hypot(x, y, z) ** 3)] * int(rng.integers(*RUN))
    return Task(tuple(items), Pack(LibraryRef("cuboids", "1", ""), BOX_CELLS, (), 0.0), ())


def measured(agent: Agent, task: Task, cell: RobotCell) -> dict[str, Any]:
    """Let an agent play a task, and measure it."""
    started = time.process_time()
    episode = Episode(task, Rules(robot=cell, buffer=1, rotations="yaw"))
    agent.play(episode, np.random.default_rng(0))
    trajectory = Trajectory.of(cell, task.cells, episode.box.placed)
    outcomes = [one.outcome for one in trajectory.attempts]
    scores = measures(trajectory, task.items)
    return {
        "utilisation": episode.box.density,
        **scores,
        "planned": scores["planned"] * task.volume,
        "items": len(outcomes),
        "outcomes": {str(one): outcomes.count(one) for one in Outcome},
        "seconds": time.process_time() - started,
    }


if __name__ == "__main__":
    main()
