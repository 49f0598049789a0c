"""Measure the time of a network's decision, and the speed of training.

    .venv/bin/python -m benchmarks.learning

Decisions are timed over the starter tasks, observation included, with random weights (the time does
not depend on them). Training is timed over its last half, when the caches about pairs of items are
filled, with separate shares for the environments and the updates. Prints a table, and writes
`benchmarks/results/learning.json`.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, write_json
from packit_agents.learning.imitation import ImitationPPO
from packit_agents.learning.learned_policies import LearnedShape
from packit_agents.learning.networks import NetworkSettings, network
from packit_agents.learning.training import Training
from packit_agents.learning.training_settings import TrainingSettings
from packit_agents.learning.weights import write_weights
from packit_sim import Agent, ShapeLibrary
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.envs.observations import PLACEMENT_FEATURES
from packit_sim.game.episodes.episode import Episode

CASES: dict[str, tuple[NetworkSettings, str]] = {
    "packnn": (NetworkSettings(), "features"),
    "packnn, placement features": (NetworkSettings(), "placement-features"),
}
"""The network, and its observation."""


def time_decisions(settings: NetworkSettings, observation: str, folder: Path) -> dict[str, float]:
    """Measure milliseconds of a choice of a shape, on one core."""
    torch.manual_seed(0)
    count = PLACEMENT_FEATURES if observation == "placement-features" else 0
    file = folder / "random.safetensors"
    write_weights(file, network(settings, count), settings, count, {})
    agent = Agent.from_name(f"learned@{file}/aligned/blbf")
    assert isinstance(agent.shape, LearnedShape)
    rng, times = np.random.default_rng(0), []
    for warm in (False, True):
        for task in load_tasks("starter", ShapeLibrary.open("everyday")):
            episode = Episode(task)
            while episode.end is None:
                started = time.perf_counter()
                shape = agent.shape(episode, rng)
                if warm:
                    times.append(1000 * (time.perf_counter() - started))
                episode.step(shape)
                while episode.end is None and episode.stage:
                    episode.step(agent.act(episode, rng))
    low, middle, high = np.percentile(times, (5, 50, 95))
    return {"decisions": len(times), "median": middle, "5%": low, "95%": high}


def time_training(settings: NetworkSettings, observation: str, steps: int, folder: Path) -> Any:
    """Measure steps per second, and the shares of environments and updates in the time."""
    training_settings = TrainingSettings(
        network=settings,
        observation=observation,  # type: ignore[arg-type]
        packs="starter",
        split=None,
        validation=None,
        steps=steps,
        validate_every=steps,
        validation_tasks=1,
    )
    spent: dict[str, float] = {"environments": 0.0, "updates": 0.0}
    job = Training(training_settings, folder, "cpu")
    with ExitStack() as stack:
        for part, kind, name in (
            ("environments", type(job._envs), "step_wait"),
            ("updates", ImitationPPO, "train"),
        ):
            stack.enter_context(mock.patch.object(kind, name, _timed(kind, name, part, spent)))
        marks: list[tuple[int, float, dict[str, float]]] = []
        job.run(lambda at: marks.append((at.steps, time.perf_counter(), dict(spent))))
    half = next(mark for mark in marks if mark[0] >= steps / 2)
    seconds = marks[-1][1] - half[1]
    shares = {part: (marks[-1][2][part] - half[2][part]) / seconds for part in spent}
    return {
        "steps": marks[-1][0] - half[0],
        "steps/s": (marks[-1][0] - half[0]) / seconds,
        **shares,
    }


def _timed(kind: type, name: str, part: str, spent: dict[str, float]) -> Callable[..., Any]:
    plain = getattr(kind, name)

    def call(self: Any, *args: Any) -> Any:
        started = time.perf_counter()
        try:
            return plain(self, *args)
        finally:
            spent[part] += time.perf_counter() - started

    return call


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--steps", type=int, default=8192, help="steps of each training")
    parser.add_argument("--threads", type=int, default=1, help="threads of torch")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    table = Table("network", "ms a decision", "5% to 95%", "steps/s", "environments", "updates")
    result: dict[str, Any] = {
        "command": f"python -m benchmarks.learning --steps {arguments.steps}",
        "machine": machine(),
        "threads": arguments.threads,
    }
    for name, (settings, observation) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            decision = time_decisions(settings, observation, Path(folder))
            trained = time_training(settings, observation, arguments.steps, Path(folder) / "run")
        result[name] = {"decision": decision, "training": trained}
        table.add_row(
            name,
            f"{decision['median']:.1f}",
            f"{decision['5%']:.1f} to {decision['95%']:.1f}",
            f"{trained['steps/s']:.0f}",
            f"{trained['environments']:.0%}",
            f"{trained['updates']:.0%}",
        )
    Console(width=100).print(table)
    write_json(arguments.out / "learning.json", result)


if __name__ == "__main__":
    main()
