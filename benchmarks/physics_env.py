"""What `PackItPhysics-v0` costs, and how far the heuristics get where items settle.

    .venv/bin/python -m benchmarks.physics_env
    .venv/bin/python -m benchmarks.physics_env --tasks 150    # the whole test split

The agents play the first tasks of a dataset by the rules of PackIt, and once more with physics;
how many steps a second it makes is measured on a few of them, an episode each, one at a time.
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
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress, track
from rich.table import Table

from benchmarks.placement import RESULTS, summary
from packit_sim import Agent, ShapeLibrary, Task
from packit_sim.core.confidence import Comparison, Estimate
from packit_sim.core.parallel import Workers
from packit_sim.datasets.pack_files import load_tasks
from packit_sim.envs.env import PackItEnv
from packit_sim.game.episode import Episode
from packit_sim.physics.convex.decomposition import decompose_all
from packit_sim.physics.settings import METHODS, DecompositionSettings, PhysicsSettings
from packit_sim.physics.settling_box import SettlingBox
from packit_sim.rules import Rules
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
    episode = Episode(task, Rules(physics=physics))
    agent.play(episode, np.random.default_rng((0, zlib.crc32(agent.name.encode()), number)))
    return episode


@dataclass(frozen=True)
class Play:
    """What became of a task, on the grid and with physics; volumes as shares of the task's.

    drifts: of the items that came to rest, in box units. seconds: of the processor, with physics.
    """

    agent: str
    number: int
    on_the_grid: float
    total: float
    placed: float
    inside: float
    drifts: tuple[float, ...]
    seconds: float


def play(name: str, number: int, task: Task, physics: PhysicsSettings) -> Play:
    agent = Agent.from_name(name)
    on_the_grid = played(task, agent, number, None).total
    started = time.process_time()
    episode = played(task, agent, number, physics)
    seconds = time.process_time() - started
    assert isinstance(episode.box, SettlingBox)
    lying = episode.box.placed
    return Play(
        name,
        number,
        on_the_grid,
        episode.total,
        sum(one.item.volume for one in lying) / task.volume,
        sum(one.item.volume for one in lying if one.inside) / task.volume,
        tuple(one.drift for one in lying if np.isfinite(one.drift)),
        seconds,
    )


def of_agent(plays: Sequence[Play]) -> dict[str, Any]:
    """What an agent gets on the grid and with physics, and what became of the items."""
    grid, returns = [one.on_the_grid for one in plays], [one.total for one in plays]
    return {
        "return on the grid": asdict(Estimate.of(grid)),
        "return": asdict(Estimate.of(returns)),
        "difference": asdict(Comparison.of(returns, grid, 1e-9)),
        "placed": asdict(Estimate.of([one.placed for one in plays])),
        "inside": asdict(Estimate.of([one.inside for one in plays])),
        "drift": summary([drift for one in plays for drift in one.drifts]),
        "seconds a task": summary([one.seconds for one in plays]),
    }


def picture(task: Task, physics: PhysicsSettings, file: Path) -> None:
    box = played(task, Agent.from_name(AGENTS[0]), 0, physics).box
    assert isinstance(box, SettlingBox)
    with Scene(box) as scene:
        scene.snapshot(800, 800).save(file)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packs", default="everyday-v1", help="a dataset's name or path")
    parser.add_argument("--split", default="test", help="of the dataset")
    parser.add_argument("--tasks", type=int, default=10, help="from the first on")
    parser.add_argument("--agents", nargs="+", default=AGENTS, metavar="AGENT")
    parser.add_argument("--method", choices=METHODS, default="coacd", help="of convex pieces")
    parser.add_argument("--episodes", type=int, default=5, help="to count steps a second in")
    parser.add_argument("--seed", type=int, default=0, help="of random actions")
    parser.add_argument("--workers", type=int, default=0, help="tasks at a time; 0: one a core")
    parser.add_argument("--picture", type=Path, help="file for a picture of the first task")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the JSON")
    arguments = parser.parse_args()
    if arguments.tasks < 2:
        parser.error(f"--tasks {arguments.tasks} tell no interval: choose 2 or more")
    library = ShapeLibrary.open("everyday")
    tasks = load_tasks(arguments.packs, library, arguments.split)[: arguments.tasks]
    physics = PhysicsSettings(decomposition=DecompositionSettings(method=arguments.method))
    shapes = {item.shape.id: item.shape for task in tasks for item in task.items}
    with Progress() as progress:
        bar = progress.add_task("decomposing", total=len(shapes))
        decompose_all(
            [shapes[id] for id in sorted(shapes)],
            physics.decomposition,
            arguments.workers,
            lambda shape, one: progress.advance(bar),
        )
    if arguments.picture is not None:
        picture(tasks[0], physics, arguments.picture)
    jobs = [(a, n, task, physics) for n, task in enumerate(tasks) for a in arguments.agents]
    with Workers(arguments.workers) as workers:
        plays = list(track(workers.as_done(play, jobs), "playing", total=len(jobs)))
    plays.sort(key=lambda one: one.number)
    rows = {a: of_agent([one for one in plays if one.agent == a]) for a in arguments.agents}
    rates = {
        name: steps_a_second(tasks[: arguments.episodes], physics, arguments.seed, settings)
        for name, settings in CASES.items()
    }
    result = {
        "command": f"python -m benchmarks.physics_env --tasks {len(tasks)} "
        f"--episodes {arguments.episodes} --method {arguments.method} "
        f"--agents {' '.join(arguments.agents)}",
        "packs": f"{arguments.packs}, {arguments.split}",
        "tasks": len(tasks),
        "items a task": float(np.mean([len(task.items) for task in tasks])),
        "episodes": arguments.episodes,
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
