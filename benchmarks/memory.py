"""Measure the memory and the speed of environments, with the default cache budgets and with others.

    .venv/bin/python -m benchmarks.memory

Random valid actions on the tasks of `everyday-v1`, each case in a fresh process, the budgets in
turn. Memory (the proportional set size) and core-seconds include child processes. Prints a table,
and writes `benchmarks/results/memory.json`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from argparse import SUPPRESS
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

import packit_sim.game.envs.vector  # noqa: F401 (registers the environments, and has the caches)
from benchmarks.common import argument_parser, machine, write_json
from packit_sim.core import caches

MIB = 2**20

BUDGETS: dict[str, dict[str, int]] = {
    "default": {},
    "large": {
        "voxels": 512 * MIB,
        "turned voxels": 512 * MIB,
        "collision meshes": 2_000_000,
        "collisions": 250_000,
        "no-fit tables": 256 * MIB,
    },
}
"""Budgets to compare; the large ones were the defaults once."""

CASES: dict[str, tuple[int, str, dict[str, Any]]] = {
    "one environment": (1, "sync", {}),
    "one environment, PackIt-Easy": (1, "sync", {"easy": True}),
    "eight in one process": (8, "vector_entry_point", {}),
    "eight in eight processes": (8, "async", {}),
}
"""Environments, Gymnasium's vectorization mode and settings."""


def processes(root: int) -> list[Path]:
    """List a process and all that it started, as folders of /proc."""
    folder = Path("/proc") / str(root)
    children = (folder / "task" / str(root) / "children").read_text().split()
    return [folder, *(each for child in children for each in processes(int(child)))]


def gigabytes() -> float:
    """Measure the memory of this process and its children, in GB of 10^9 bytes."""
    rollups = [(each / "smaps_rollup").read_text() for each in processes(os.getpid())]
    lines = [line for text in rollups for line in text.splitlines() if line.startswith("Pss:")]
    return sum(int(line.split()[1]) for line in lines) * 1024 / 1e9


def core_seconds() -> float:
    """Measure the time that cores spent on this process and its children."""
    stats = [(each / "stat").read_text().rpartition(")")[2] for each in processes(os.getpid())]
    ticks = sum(int(ticks) for text in stats for ticks in text.split()[11:13])
    return ticks / os.sysconf("SC_CLK_TCK")


def play(case: str, budgets: str, steps: int, seed: int) -> dict[str, Any]:
    """Let the environments of a case play so many steps in all; return what that took."""
    for name, budget in BUDGETS[budgets].items():
        caches.limit(name, budget)
    count, mode, settings = CASES[case]
    envs = gym.make_vec(
        "PackIt-v0",
        count,
        vectorization_mode=mode,
        tasks="everyday-v1",
        split="train",
        **settings,
    )
    rng = np.random.default_rng(seed)
    observations, _ = envs.reset(seed=seed)
    before = gigabytes()
    started = core_seconds()
    for _ in range(steps // count):
        masks = observations["action_mask"]
        actions = [int(rng.choice(np.flatnonzero(mask))) if mask.any() else 0 for mask in masks]
        observations, *_ = envs.step(np.array(actions))
    speed = steps / (core_seconds() - started)
    result = {"GB at first": before, "GB": gigabytes(), "steps per core-second": speed}
    envs.close()
    return result


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--steps", type=int, default=5000, help="steps in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--one", nargs=2, help=SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        case, budgets = arguments.one
        print(json.dumps(play(case, budgets, arguments.steps, arguments.seed)))
        return
    table = Table("environments", "budgets", "GB at first", "GB", "steps per core-second")
    result: dict[str, Any] = {
        "command": "python -m benchmarks.memory",
        "steps": arguments.steps,
        "seed": arguments.seed,
        "machine": machine(),
    }
    for case in arguments.cases:
        for budgets in BUDGETS:
            settings = ["--steps", str(arguments.steps), "--seed", str(arguments.seed)]
            command = [sys.executable, "-m", "benchmarks.memory", "--one", case, budgets, *settings]
            output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            found = json.loads(output.splitlines()[-1])
            result[f"{case}, {budgets} budgets"] = found
            table.add_row(case, budgets, *(f"{value:.3g}" for value in found.values()))
            write_json(arguments.out / "memory.json", result)
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
