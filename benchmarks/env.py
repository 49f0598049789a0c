"""Measure steps per second of the environments, on one core and with two processes.

    .venv/bin/python -m benchmarks.env

Random valid actions on the starter packs, after one warm-up episode for each task. With `--vectors`
it measures `make_vec` instead, in turns: one environment in this process, and environments in two
processes and in a process each; `--seconds 1` is enough. Prints a table, and writes `env.json` or
`env_vectors.json` in `benchmarks/results`.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Generator
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, write_json
from packit_sim import ShapeLibrary, make_vec
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


VECTORS: dict[str, tuple[int, dict[str, Any]]] = {
    "one": (1, {}),
    "8 in this process": (8, {}),
    "8 in 2 processes": (8, {"vectorization_mode": "parallel", "workers": 2}),
    "32 in 2 processes": (32, {"vectorization_mode": "parallel", "workers": 2}),
    "64 in 2 processes": (64, {"vectorization_mode": "parallel", "workers": 2}),
    "2 in processes": (2, {"vectorization_mode": "async"}),
    "8 in processes": (8, {"vectorization_mode": "async"}),
}
"""Numbers of environments, and settings of `make_vec`."""

ROUNDS = 30
"""Measurements of each vector."""

WARM_UP = 10
"""Episodes of each environment before its steps count."""


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


def vector_rates(name: str, seconds: float, seed: int) -> Generator[float, None, None]:
    """Yield the steps per second of one of `VECTORS`, measured again each time.

    Its environments choose shapes by features. Steps are those of all environments together, resets
    included.
    """
    count, how = VECTORS[name]
    settings, _ = CASES["shape selection, features"]
    envs = make_vec(
        "PackIt-v0",
        count,
        **how,
        autoreset_mode="SameStep",
        order="cycle",
        max_shapes=50,
        **settings,
    )
    rng = np.random.default_rng(seed)
    with contextlib.closing(envs):
        seen, _ = envs.reset(seed=seed)
        ended = 0
        while True:
            taken, started = 0, time.perf_counter()
            while ended < WARM_UP * envs.num_envs or time.perf_counter() - started < seconds:
                weights = rng.random(seen["action_mask"].shape) * seen["action_mask"]
                seen, _, over, *_ = envs.step(weights.argmax(axis=1))
                ended += int(over.sum())
                taken += envs.num_envs
            yield taken / (time.perf_counter() - started)


def measure_vectors(seconds: float, seed: int) -> dict[str, Any]:
    """Measure all vectors in turns, and return their rates relative to one environment's.

    There are many short measurements, since the machine's speed changes within seconds.
    """
    measured = {name: vector_rates(name, seconds, seed) for name in VECTORS}
    for rates in measured.values():
        next(rates)  # the warm-up
    rounds = [{name: next(rates) for name, rates in measured.items()} for _ in range(ROUNDS)]
    table = Table("environments", "steps/s", "times one", "middle half")
    result = {}
    for name, rates in measured.items():
        rates.close()
        found = [each[name] for each in rounds]
        times = [each[name] / each["one"] for each in rounds]
        result[name] = {"steps/s": found, "times one": times}
        low, high = np.percentile(times, (25, 75))
        middle = f"{low:.2f} to {high:.2f}"
        table.add_row(name, f"{np.median(found):.0f}", f"{np.median(times):.2f}", middle)
    Console(width=100).print(table)
    return result


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--vectors", action="store_true", help="measure make_vec instead")
    parser.add_argument("--seconds", type=float, default=10.0, help="seconds for each case")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.vectors:
        found = measure_vectors(arguments.seconds, arguments.seed)
        write_json(arguments.out / "env_vectors.json", {"machine": machine(), **found})
        return
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
