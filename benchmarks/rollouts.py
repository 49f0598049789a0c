"""Compare the speed of rollouts, searches and environments of two checkouts, in pairs.

    .venv/bin/python -m benchmarks.rollouts --against ../before    (some minutes)

A process for each checkout plays the same work, in turns, and measures its processor time. Work on
a task begins with rounds that fill the caches. The results of both checkouts must be the same.
Prints a table, and writes `benchmarks/results/rollouts.json`. Without `--against` it measures this
checkout alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from argparse import SUPPRESS
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, write_json
from benchmarks.env import CASES
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.task_source import TaskSource
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode

CHECKOUT = Path(__file__).parents[1]

WORK = (
    "largest-fitting-first/lowest/maximal-contact",
    "largest-fitting-first/lowest/blbf",
    "largest-first/aligned/blbf",
    "largest-fitting-first/lowest/maximal-contact+lns=30",
    "shape selection, features",
    "all three sub-tasks, features",
    "PackIt-Easy, features",
)
"""Names of agents and of the environments of `benchmarks.env`."""

RESAMPLES = 10_000


def play_agent(name: str, number: int, seed: int) -> tuple[int, str]:
    """Play a task of `everyday-v1`; return the number of rollouts, and what was played."""
    agent, task = _agent(name), _validation().tasks[number]
    rollouts = 1

    def on_progress(count: int, best: float) -> None:
        nonlocal rollouts
        rollouts = count

    episode = Episode(task)
    agent.play(episode, np.random.default_rng(seed), on_progress)
    placed = [(p.item.shape.id, p.item.rotation, p.location) for p in episode.box.placed]
    return rollouts, f"{placed} {episode.total!r}"


def play_env(name: str, number: int, seed: int) -> tuple[int, str]:
    """Play random valid actions in a task of an environment; return the steps, and the rewards."""
    env, rng = _env(name), np.random.default_rng(seed)
    observation, info = env.reset(seed=seed, options={"task": number % len(env.tasks)})
    played: list[Any] = []
    while env.episode.end is None:
        action = int(rng.choice(np.flatnonzero(info["action_mask"])))
        observation, reward, _, _, info = env.step(action)
        played.append((action, reward))
    return len(played), f"{played} {observation['box'].sum()!r}"


@cache
def _agent(name: str) -> Agent:
    return Agent.from_name(name)


@cache
def _validation() -> TaskSource:
    return TaskSource("everyday-v1", None, "validation", "cycle", None)


@cache
def _env(name: str) -> PackItEnv:
    return PackItEnv(order="cycle", max_shapes=50, **CASES[name][0])


def serve() -> None:
    """Play what each line of the standard input asks for; answer with a line."""
    for line in sys.stdin:
        name, number, seeds = json.loads(line)
        play: Callable[[str, int, int], tuple[int, str]]
        play = play_env if name in CASES else play_agent
        count, digest, started = 0, hashlib.sha256(), time.process_time()
        for seed in seeds:
            played, result = play(name, number, seed)
            count += played
            digest.update(result.encode())
        seconds = time.process_time() - started
        sys.stdout.write(json.dumps([count, seconds, digest.hexdigest()]) + "\n")
        sys.stdout.flush()


class Player:
    """A process that plays with the code of a checkout."""

    def __init__(self, checkout: Path) -> None:
        paths = os.pathsep.join(map(str, (checkout, checkout / "agents")))
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__, "--serve"],
            env={**os.environ, "PYTHONPATH": paths},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def play(self, name: str, number: int, seeds: list[int]) -> tuple[int, float, str]:
        """Play a task once for each seed; return the count, the seconds and a digest."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps([name, number, seeds]) + "\n")
        self._process.stdin.flush()
        count, seconds, digest = json.loads(self._process.stdout.readline())
        return count, seconds, digest

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def measure(players: list[Player], name: str, tasks: int, warm: int, rounds: int) -> dict[str, Any]:
    """Measure one kind of work; the first player is this checkout."""
    taken = np.zeros((len(players), tasks))
    count, same = 0, True
    for task in range(tasks):
        for player in players:
            player.play(name, task, list(range(warm)))
        for seed in range(warm, warm + rounds):
            order = players if seed % 2 else players[::-1]  # who comes first may be slower
            results = {id(player): player.play(name, task, [seed]) for player in order}
            played = [results[id(player)] for player in players]
            count += played[0][0]
            same &= len({(result[0], result[2]) for result in played}) == 1
            taken[:, task] += [result[1] for result in played]
    row: dict[str, Any] = {
        "tasks": tasks,
        "rounds": rounds,
        "count": count,
        "per second": (count / taken.sum(axis=1)).tolist(),
    }
    if len(players) > 1:
        drawn = np.random.default_rng(0).integers(tasks, size=(RESAMPLES, tasks))
        ratios = taken[1, drawn].sum(axis=1) / taken[0, drawn].sum(axis=1)
        row["ratio"] = float(taken[1].sum() / taken[0].sum())
        row["interval"] = np.percentile(ratios, (2.5, 97.5)).tolist()
        row["same results"] = same
    return row


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--against", type=Path, help="the other checkout, with the same datasets")
    parser.add_argument("--work", nargs="+", default=list(WORK), help="agents and environments")
    parser.add_argument("--tasks", type=int, default=10, help="the first tasks of the dataset")
    parser.add_argument("--warm", type=int, default=40, help="rounds of a task before it is timed")
    parser.add_argument("--rounds", type=int, default=5, help="rounds of a task that are timed")
    parser.add_argument("--serve", action="store_true", help=SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve()
        return
    if arguments.against and not (arguments.against / "packit_sim").is_dir():
        parser.error(f"--against {arguments.against}: it holds no packit_sim")
    checkouts = [CHECKOUT] + ([arguments.against.resolve()] if arguments.against else [])
    players = [Player(checkout) for checkout in checkouts]
    table = Table("work", "per second", "before", "ratio", "95%", "same results")
    result: dict[str, Any] = {
        "command": "python -m benchmarks.rollouts --against CHECKOUT",
        "machine": machine(),
        "warm rounds": arguments.warm,
    }
    for name in arguments.work:
        warm = 2 if "+" in name else arguments.warm
        row = result[name] = measure(players, name, arguments.tasks, warm, arguments.rounds)
        cells = [f"{rate:,.1f}" for rate in row["per second"]]
        if "ratio" in row:
            low, high = row["interval"]
            cells += [f"{row['ratio']:.2f}", f"{low:.2f} to {high:.2f}", str(row["same results"])]
        table.add_row(name, *cells)
        write_json(arguments.out / "rollouts.json", result)
    for player in players:
        player.close()
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
