"""Measure the speed of `PackItPhysics-v0`, and the returns of heuristics where items settle.

    .venv/bin/python -m benchmarks.physics_env
    .venv/bin/python -m benchmarks.physics_env --tasks 150    # the whole test split

The agents play the first tasks of a dataset by the rules of PackIt, and again with physics. Steps
per second are measured on a few of the tasks, one episode each. New shapes are decomposed first.
Times are CPU seconds, so that other work on the machine does not count. Prints two tables, and
writes `benchmarks/results/physics_env.json`; with --picture FILE also a picture of the first task
after the first agent's episode.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.common import argument_parser, machine, summary, write_json
from benchmarks.env import play_random
from benchmarks.physics import decompose_with_progress
from packit_sim import Agent, ShapeLibrary, Task
from packit_sim.core.confidence import Comparison, Estimate
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.episodes.episode import Episode
from packit_sim.physics.convex.settings import METHODS, DecompositionSettings
from packit_sim.physics.settings import PhysicsSettings
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
    """Measure steps and placements per CPU second: random valid actions, an episode a task."""
    env = PackItEnv(tasks, order="cycle", physics=physics, observation="features", **settings)
    rng = np.random.default_rng(seed)
    steps = placed = 0
    started = time.process_time()
    for _ in tasks:
        steps += play_random(env, rng)
        placed += len(env.episode.box.placed)
    seconds = time.process_time() - started
    return steps / seconds, placed / seconds


def play_episode(task: Task, agent: Agent, number: int, physics: PhysicsSettings | None) -> Episode:
    """Play an episode to its end, with the same random numbers with physics and without."""
    episode = Episode(task, Rules(physics=physics))
    agent.play(episode, np.random.default_rng((0, zlib.crc32(agent.name.encode()), number)))
    return episode


@dataclass(frozen=True)
class Play:
    """The outcome of a task on the grid and with physics; volumes are shares of the task's.

    `drifts` are those of the items at rest, in box units; `seconds` are CPU seconds with physics.
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
    on_the_grid = play_episode(task, agent, number, None).total
    started = time.process_time()
    episode = play_episode(task, agent, number, physics)
    seconds = time.process_time() - started
    assert isinstance(episode.box, SettlingBox)
    placed = episode.box.placed
    return Play(
        name,
        number,
        on_the_grid,
        episode.total,
        sum(one.item.volume for one in placed) / task.volume,
        sum(one.item.volume for one in placed if one.inside) / task.volume,
        tuple(one.drift for one in placed if np.isfinite(one.drift)),
        seconds,
    )


def summarise(plays: Sequence[Play]) -> dict[str, Any]:
    """Summarise an agent's returns on the grid and with physics, and its items' drifts."""
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
    box = play_episode(task, Agent.from_name(AGENTS[0]), 0, physics).box
    assert isinstance(box, SettlingBox)
    with Scene(box) as scene:
        scene.snapshot(800, 800).save(file)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--dataset", default="everyday-v1", help="a dataset's name or path")
    parser.add_argument("--split", default="test", help="split of the dataset")
    parser.add_argument("--tasks", type=int, default=10, help="play only the first N tasks")
    parser.add_argument("--agents", nargs="+", default=AGENTS, metavar="AGENT")
    parser.add_argument(
        "--method", choices=METHODS, default="coacd", help="method of convex decomposition"
    )
    parser.add_argument("--episodes", type=int, default=5, help="episodes for steps per second")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random actions")
    parser.add_argument(
        "--workers", type=int, default=0, help="number of processes; 0: one for each core"
    )
    parser.add_argument("--picture", type=Path, help="file for a picture of the first task")
    arguments = parser.parse_args()
    if arguments.tasks < 2:
        parser.error(f"--tasks {arguments.tasks}: an interval needs 2 tasks or more")
    library = ShapeLibrary.open("everyday")
    tasks = load_tasks(arguments.dataset, library, arguments.split)[: arguments.tasks]
    physics = PhysicsSettings(decomposition=DecompositionSettings(method=arguments.method))
    shapes = {item.shape.id: item.shape for task in tasks for item in task.items}
    decompose_with_progress([shapes[id] for id in sorted(shapes)], physics, arguments.workers)
    if arguments.picture is not None:
        picture(tasks[0], physics, arguments.picture)
    jobs = [(a, n, task, physics) for n, task in enumerate(tasks) for a in arguments.agents]
    with Workers(arguments.workers) as workers:
        plays = list(track(workers.as_done(play, jobs), "playing", total=len(jobs)))
    plays.sort(key=lambda one: one.number)
    rows = {a: summarise([one for one in plays if one.agent == a]) for a in arguments.agents}
    rates = {
        name: steps_a_second(tasks[: arguments.episodes], physics, arguments.seed, settings)
        for name, settings in CASES.items()
    }
    result = {
        "command": f"python -m benchmarks.physics_env --tasks {len(tasks)} "
        f"--episodes {arguments.episodes} --method {arguments.method} "
        f"--agents {' '.join(arguments.agents)}",
        "packs": f"{arguments.dataset}, {arguments.split}",
        "tasks": len(tasks),
        "items a task": float(np.mean([len(task.items) for task in tasks])),
        "episodes": arguments.episodes,
        "seed": arguments.seed,
        "settings": asdict(physics),
        "library": library.digest,
        "machine": machine(),
        "steps a second": {name: rate for name, (rate, _) in rates.items()},
        "placements a second": {name: rate for name, (_, rate) in rates.items()},
        "agents": rows,
    }
    report(Console(width=150), result)
    write_json(arguments.out / "physics_env.json", result)


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
