"""What `PackItPhysics-v0` costs, and how far the heuristics get where items settle.

    .venv/bin/python -m benchmarks.physics_env
    .venv/bin/python -m benchmarks.physics_env --tasks 150    # the whole test split, hours

The agents play the first tasks of a dataset by the rules of PackIt, and once more with physics.
Shapes that are new are decomposed first. Times are of the processor, so that they mean something on
a machine that does other things as well. Prints two tables, and writes
`benchmarks/results/physics_env.json`; with --picture FILE also how the first agent leaves the first
task's box.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.placement import RESULTS, summary
from packit_sim import Agent, ShapeLibrary, Task
from packit_sim.datasets.packs import load_tasks
from packit_sim.envs.env import PackItEnv
from packit_sim.envs.episode import Episode
from packit_sim.estimates import Comparison, Estimate
from packit_sim.physics.box import SettlingBox
from packit_sim.physics.decomposition import METHODS, DecompositionSettings, decompose
from packit_sim.physics.world import PhysicsSettings
from packit_sim.pictures.layouts import unplaced
from packit_sim.scene import Scene

AGENTS = (
    "largest-first/aligned/blbf",
    "largest-first/lowest/blbf",
    "largest-first/aligned/random",
    "random/aligned/blbf",
)

CASES: dict[str, dict[str, Any]] = {
    "shape selection, features": {"rotation": "aligned", "location": "blbf"},
    "all three sub-tasks, features": {},
}
"""Settings of the environment."""


def steps_a_second(
    tasks: tuple[Task, ...], physics: PhysicsSettings, seed: int, settings: dict[str, Any]
) -> tuple[float, float]:
    """Steps and placements a second of the processor: random valid actions, an episode a task."""
    env = PackItEnv(tasks, order="cycle", physics=physics, observation="features", **settings)
    rng = np.random.default_rng(seed)
    steps = placed = 0
    started = time.process_time()
    for _ in tasks:
        env.reset(seed=int(rng.integers(2**31)))
        while env.episode.end is None:
            env.step(int(rng.choice(np.flatnonzero(env.action_masks()))))
            steps += 1
        placed += len(env.episode.box.placed)
    seconds = time.process_time() - started
    return steps / seconds, placed / seconds


def played(task: Task, agent: Agent, number: int, physics: PhysicsSettings | None) -> Episode:
    """An episode at its end; the same random numbers with physics and without."""
    box = SettlingBox(task.cells, physics) if physics else None
    episode = Episode(task, box=box)
    agent.play(episode, np.random.default_rng((0, zlib.crc32(agent.name.encode()), number)))
    return episode


def of_agent(name: str, tasks: tuple[Task, ...], physics: PhysicsSettings) -> dict[str, Any]:
    """What an agent gets on the grid and with physics, and what became of the items."""
    agent = Agent.from_name(name)
    grid, returns, placed, inside, drifts, seconds = [], [], [], [], [], []
    for number, task in enumerate(track(tasks, name)):
        grid.append(played(task, agent, number, None).total)
        started = time.process_time()
        episode = played(task, agent, number, physics)
        seconds.append(time.process_time() - started)
        assert isinstance(episode.box, SettlingBox)
        lying = episode.box.placed
        returns.append(episode.total)
        placed.append(sum(one.item.volume for one in lying) / task.volume)
        inside.append(sum(one.item.volume for one in lying if one.inside) / task.volume)
        drifts += [one.drift for one in lying if np.isfinite(one.drift)]
    return {
        "return on the grid": asdict(Estimate.of(grid)),
        "return": asdict(Estimate.of(returns)),
        "difference": asdict(Comparison.of(returns, grid, 1e-9)),
        "placed": asdict(Estimate.of(placed)),
        "inside": asdict(Estimate.of(inside)),
        "drift": summary(drifts),
        "seconds a task": summary(seconds),
    }


def picture(task: Task, physics: PhysicsSettings, file: Path) -> None:
    box = played(task, Agent.from_name(AGENTS[0]), 0, physics).box
    assert isinstance(box, SettlingBox)
    with Scene(unplaced([one.item for one in box.placed], box.cells)) as scene:
        scene.snapshot(800, 800, layout=box.layout).save(file)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packs", default="everyday-v1", help="a dataset's name or path")
    parser.add_argument("--split", default="test", help="of the dataset")
    parser.add_argument("--tasks", type=int, default=10, help="from the first on")
    parser.add_argument("--agents", nargs="+", default=AGENTS, metavar="AGENT")
    parser.add_argument("--method", choices=METHODS, default="coacd", help="of convex pieces")
    parser.add_argument("--seed", type=int, default=0, help="of random actions")
    parser.add_argument("--picture", type=Path, help="file for a picture of the first task")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the JSON")
    arguments = parser.parse_args()
    library = ShapeLibrary.open("everyday")
    tasks = load_tasks(arguments.packs, library, arguments.split)[: arguments.tasks]
    physics = PhysicsSettings(decomposition=DecompositionSettings(method=arguments.method))
    shapes = {item.shape for task in tasks for item in task.items}
    for shape in track(sorted(shapes, key=lambda shape: shape.id), "decomposing"):
        decompose(shape, physics.decomposition)
    if arguments.picture is not None:
        picture(tasks[0], physics, arguments.picture)
    rows = {name: of_agent(name, tasks, physics) for name in arguments.agents}
    rates = {
        name: steps_a_second(tasks, physics, arguments.seed, settings)
        for name, settings in CASES.items()
    }
    result = {
        "command": f"python -m benchmarks.physics_env --tasks {len(tasks)} "
        f"--method {arguments.method} --agents {' '.join(arguments.agents)}",
        "packs": f"{arguments.packs}, {arguments.split}",
        "tasks": len(tasks),
        "items a task": float(np.mean([len(task.items) for task in tasks])),
        "seed": arguments.seed,
        "settings": asdict(physics),
        "library": library.digest,
        "machine": {"python": platform.python_version(), "cores": os.cpu_count()},
        "steps a second": {name: rate for name, (rate, _) in rates.items()},
        "placements a second": {name: rate for name, (_, rate) in rates.items()},
        "agents": rows,
    }
    report(Console(width=150), result)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "physics_env.json").write_text(json.dumps(result, indent=1) + "\n")


def report(console: Console, result: dict[str, Any]) -> None:
    speeds = Table("environment", "steps/s", "placements/s")
    for name, rate in result["steps a second"].items():
        speeds.add_row(name, f"{rate:.1f}", f"{result['placements a second'][name]:.1f}")
    console.print(speeds)
    table = Table("", "on the grid", "with physics", "placed", "inside", "drift", "s a task")
    for name, row in result["agents"].items():
        kinds = ("return on the grid", "return", "placed", "inside")
        table.add_row(
            name,
            *(f"{row[k]['mean']:.3f} ({row[k]['low']:.2f}, {row[k]['high']:.2f})" for k in kinds),
            f"{row['drift']['median']:.3f}",
            f"{row['seconds a task']['median']:.1f}",
        )
    console.print(table)


if __name__ == "__main__":
    main()
