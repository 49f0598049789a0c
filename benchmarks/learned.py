"""Compare trained networks with the heuristic on held-out shapes.

    .venv/bin/python -m benchmarks.learned RUN ... --out FOLDER

RUN is a folder of `packit train`; folders whose names differ in a number at the end are seeds of
one training. Each plays the 150 test tasks with its best weights, alone and with 4 beams. Prints a
table of paired comparisons, and writes `learned.json`, and a plot with the learning curves.
Rollouts that are already in the folder are not played again.
"""

from __future__ import annotations

import argparse
import bisect
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.common import plot_file, write_json
from packit_agents.learning.networks import AllPolicies
from packit_agents.learning.weights import read_weights
from packit_sim import Agent, ShapeLibrary
from packit_sim.cli.evaluations import evaluate_shown
from packit_sim.cli.terminal import console
from packit_sim.core.confidence import Comparison, Estimate, format_estimate
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.provenance import RETURN_SLACK
from packit_sim.game.evaluation.learning_curves import TrainingRecord
from packit_sim.game.paper.names import HEURISTIC
from packit_sim.render import plots
from packit_sim.rules import Rules

RANDOM = "random/aligned/blbf"
BEAMS = "+beam=4"
LEVEL = 0.7
"""The x of the reported Success@x."""


@dataclass(frozen=True)
class Row:
    """An agent, or several seeds of one with their mean return at each task.

    `success` is Success@0.7 in percent, of all seeds together; `against` names the agent that it is
    compared with.
    """

    name: str
    seeds: int
    reward: Estimate
    success: Estimate
    against: str
    comparison: Comparison

    @classmethod
    def of(
        cls, name: str, agents: Sequence[str], against: str, returns: Mapping[str, Sequence[float]]
    ) -> Row:
        own = np.array([returns[agent] for agent in agents])  # (seeds, tasks)
        means = own.mean(axis=0)
        return cls(
            name,
            len(agents),
            Estimate.of(means),
            Estimate.of(100.0 * (own >= LEVEL - RETURN_SLACK).mean(axis=0)),
            against,
            Comparison.of(means.tolist(), returns[against], RETURN_SLACK),
        )


def agent_of(run: Path) -> str:
    """Name the agent that plays with a run's best weights, by all policies it has learned."""
    file = run / "best.safetensors"
    network, _, _ = read_weights(file)
    learned = f"learned@{file}"
    return (
        "/".join([learned] * 3) if isinstance(network, AllPolicies) else f"{learned}/aligned/blbf"
    )


def draw(runs: Mapping[str, Sequence[TrainingRecord]], heuristic: Estimate, path: Path) -> None:
    """Draw validation by steps: a colour for each training, a line for each seed.

    Lines are dotted where PPO follows imitation. `heuristic` is its reward on the same tasks.
    """
    with plots.drawn(path, [["curves"]], 8, 5) as (_, axes):
        ax = axes["curves"]
        for (name, seeds), color in zip(runs.items(), cycle(plots.COLORS), strict=False):
            for n, run in enumerate(seeds):
                at = [point.steps for point in run.curve]
                means = [point.validation.mean for point in run.curve]
                imitated = bisect.bisect(at, run.settings["imitation"])
                ax.plot(at[:imitated], means[:imitated], color=color, label=None if n else name)
                ax.plot(at[imitated - 1 :], means[imitated - 1 :], color=color, linestyle=":")
                ax.plot(run.best.steps, run.best.validation.mean, "o", color=color)
        ax.set_ylim(bottom=heuristic.mean - 0.1)
        ax.axhline(heuristic.mean, color=plots.INK, linestyle="--", label="the Heuristic")
        ax.set_xlabel("steps: a heuristic is imitated (line), then PPO (dots); best: circle")
        ax.set_ylabel("Average Reward in validation")
        ax.legend(loc="lower right")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", type=Path, nargs="+", help="folders of trainings")
    parser.add_argument("--out", type=Path, required=True, help="folder for results")
    parser.add_argument(
        "--easy", action="store_true", help="play by PackIt-Easy's rules, without beams"
    )
    parser.add_argument("--tasks", type=int, default=None, help="play only the first N tasks")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    library = ShapeLibrary.open("everyday")
    tasks = load_tasks("everyday-v1", library, "test")[: arguments.tasks]
    trained: dict[str, list[str]] = {}
    curves: dict[str, list[TrainingRecord]] = {}
    for run in arguments.runs:
        name = re.sub(r"-?\d+$", "", run.name)
        trained.setdefault(name, []).append(agent_of(run))
        curves.setdefault(name, []).append(TrainingRecord.read(run))
    validation = max(run.settings["validation_tasks"] for seeds in curves.values() for run in seeds)
    rules = Rules(easy=arguments.easy)
    groups = {"random": [RANDOM], "heuristic": [HEURISTIC], **trained}
    for name, agents in trained.items():
        if len(agents) > 1:
            groups |= {f"{name}, {n}": [agent] for n, agent in enumerate(agents, start=1)}
    if not arguments.easy:
        beams = {"heuristic": [HEURISTIC], **trained}
        groups |= {name + BEAMS: [a + BEAMS for a in agents] for name, agents in beams.items()}
    names = list(dict.fromkeys(agent for agents in groups.values() for agent in agents))
    with Workers() as workers:
        rollouts = evaluate_shown(
            [Agent.from_name(agent) for agent in names],
            tasks,
            0,
            rules,
            workers=workers,
            file=arguments.out / "learned.jsonl",
        )
        played = evaluate_shown(
            [Agent.from_name(HEURISTIC)],
            load_tasks("everyday-v1", library, "validation")[:validation],
            0,
            rules,
            workers=workers,
            file=arguments.out / "validation.jsonl",
        )
    returns: dict[str, list[float]] = {}
    for rollout in rollouts:
        returns.setdefault(rollout.agent, []).append(rollout.total)
    rows = [
        Row.of(name, agents, HEURISTIC + (BEAMS if name.endswith(BEAMS) else ""), returns)
        for name, agents in groups.items()
    ]
    rows += [
        Row.of(f"{name} to random", agents, RANDOM, returns) for name, agents in trained.items()
    ]
    table = Table("", "seeds", "Average Reward", f"S@{LEVEL:g}", "ratio to the heuristic's")
    for row in rows:
        table.add_row(
            row.name,
            str(row.seeds),
            format_estimate(row.reward, ".3f"),
            format_estimate(row.success, ".1f"),
            format_estimate(row.comparison.ratio, ".3f"),
        )
    console.print(table)
    heuristic = Estimate.of([rollout.total for rollout in played])
    draw(curves, heuristic, plot_file(arguments.out, "learned"))
    content = {
        "tasks": len(tasks),
        "library": library.digest,
        "rows": [asdict(row) for row in rows],
        "validation": {
            "tasks": validation,
            "heuristic": asdict(heuristic),
            "curves": {
                name: [[point.to_json() for point in run.curve] for run in seeds]
                for name, seeds in curves.items()
            },
        },
    }
    write_json(arguments.out / "learned.json", content)


if __name__ == "__main__":
    main()
