"""What networks cost: the time of a decision, and how fast they are trained.

    .venv/bin/python -m benchmarks.learning

Decisions are timed over the starter tasks, observation included, with weights of chance (the time
does not depend on them). Training is timed over its last half, when what is known about pairs of
items helps, and apart: in the environments, in updates. Prints a table, and writes
`benchmarks/results/learning.json`.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
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

from benchmarks.placement import RESULTS
from packit_agents.learning.imitation import ImitationPPO
from packit_agents.learning.learned_policies import LearnedShape
from packit_agents.learning.networks import NetworkSettings, network
from packit_agents.learning.training import Training
from packit_agents.learning.training_settings import TrainingSettings
from packit_agents.learning.weights import write_weights
from packit_sim import Agent, ShapeLibrary
from packit_sim.datasets.pack_files import load_tasks
from packit_sim.envs.observations import PLACEMENT_FEATURES
from packit_sim.game.episode import Episode

CASES: dict[str, tuple[NetworkSettings, str]] = {
    "packnn": (NetworkSettings(), "features"),
    "packnn, placement features": (NetworkSettings(), "placement-features"),
}
"""The network, and what it sees."""


def decisions(settings: NetworkSettings, observation: str, folder: Path) -> dict[str, float]:
    """Milliseconds of a choice of a shape, on one core."""
    torch.manual_seed(0)
    count = PLACEMENT_FEATURES if observation == "placement-features" else 0
    file = folder / "chance.safetensors"
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


def training(settings: NetworkSettings, observation: str, steps: int, folder: Path) -> Any:
    """Steps a second, and the shares of the time."""
    told = TrainingSettings(
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
    job = Training(told, folder, "cpu")
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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=8192, help="of each training")
    parser.add_argument("--threads", type=int, default=1, help="of torch")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the JSON")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    table = Table("network", "ms a decision", "5% to 95%", "steps/s", "environments", "updates")
    result: dict[str, Any] = {
        "command": f"python -m benchmarks.learning --steps {arguments.steps}",
        "machine": {"python": platform.python_version(), "cores": os.cpu_count()},
        "threads": arguments.threads,
    }
    for name, (settings, observation) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            asked = decisions(settings, observation, Path(folder))
            trained = training(settings, observation, arguments.steps, Path(folder) / "run")
        result[name] = {"decision": asked, "training": trained}
        table.add_row(
            name,
            f"{asked['median']:.1f}",
            f"{asked['5%']:.1f} to {asked['95%']:.1f}",
            f"{trained['steps/s']:.0f}",
            f"{trained['environments']:.0%}",
            f"{trained['updates']:.0%}",
        )
    Console(width=100).print(table)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "learning.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
