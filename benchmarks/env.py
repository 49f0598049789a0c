"""Measure steps per second of the environments, on one core and with two processes.

    .venv/bin/python -m benchmarks.env

Random valid actions on the starter packs, after one warm-up episode for each task. Prints a table,
and writes `benchmarks/results/env.json`.
"""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, write_json
from packit_sim import ShapeLibrary
from packit_sim.game.envs.env import PackItEnv

PAPER = 0.39
"""Shape-Selection steps per second of the paper's training: 200,000 in 6 days."""

CASES: dict[str, tuple[dict[str, Any], float]] = {
    "shape selection, features": (
        {"rotation": "aligned", "location": "blbf", "observation": "features"},
        3000,
    ),
    "all three sub-tasks, features": ({"observation": "features"}, 1000),
    "all three sub-tasks, voxels": ({"observation": "voxels"}, 60),
    "PackIt-Easy, features": ({"easy": True, "observation": "features"}, 200),
    "kinematic, all three sub-tasks, features": ({"kinematic": True, "observation": "features"}, 0),
}
"""Settings of the environment, and the aim in steps per second, 0 for none."""


def play_random(env: PackItEnv, rng: np.random.Generator) -> int:
    """Play an episode of random valid actions; return the number of steps."""
    env.reset(seed=int(rng.integers(2**31)))
    steps = 0
    while env.episode.end is None:
        env.step(int(rng.choice(np.flatnonzero(env.action_masks()))))
        steps += 1
    return steps


def steps_a_second(settings: dict[str, Any], seconds: float, seed: int) -> tuple[float, int]:
    """Measure steps per second, resets included; also return the number of steps."""
    env = PackItEnv(order="cycle", max_shapes=50, **settings)
    rng = np.random.default_rng(seed)
    for _ in env.tasks:
        play_random(env, rng)
    taken, started = 0, time.perf_counter()
    while time.perf_counter() - started < seconds:
        taken += play_random(env, rng)
    return taken / (time.perf_counter() - started), taken


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="seconds for each case")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    table = Table("environment", "steps/s", "aim", "2 processes", "times the paper's")
    result: dict[str, Any] = {
        "command": "python -m benchmarks.env",
        "seconds": arguments.seconds,
        "seed": arguments.seed,
        "library": ShapeLibrary.open("everyday").digest,
        "machine": machine(),
    }
    for name, (settings, aim) in CASES.items():
        rate, taken = steps_a_second(settings, arguments.seconds, arguments.seed)
        with ProcessPoolExecutor(2) as pool:
            jobs = [
                pool.submit(steps_a_second, settings, arguments.seconds, seed) for seed in (1, 2)
            ]
            both = sum(job.result()[0] for job in jobs)
        result[name] = {"steps/s": rate, "steps": taken, "aim": aim, "two processes": both}
        table.add_row(name, f"{rate:.0f}", f"{aim or ''}", f"{both:.0f}", f"{rate / PAPER:,.0f}")
    Console(width=100).print(table)
    write_json(arguments.out / "env.json", result)


if __name__ == "__main__":
    main()
