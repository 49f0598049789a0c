"""Measure the champion's decisions: how many placements it compares, and how long that takes.

    .venv/bin/python -m benchmarks.champion

Plays validation tasks of everyday-v1 without a search, and measures the processor time of each
decision. Then counts the layouts a second of `ruin-recreate`, on tasks that it does not solve
early. Prints a table, and writes `benchmarks/results/champion.json`.
"""

from __future__ import annotations

import time
from collections import defaultdict

import numpy as np
from rich.console import Console

from benchmarks.common import Times, argument_parser, machine, summaries, summary_table, write_json
from packit_agents.placements.playing import new_layout
from packit_agents.placements.policies import PlacementPolicy
from packit_agents.placements.ruin_and_recreate import RuinAndRecreate
from packit_agents.placements.scored_layout import Scorer
from packit_agents.planning.budgets import Budget
from packit_sim import Agent, Episode, Task, load_tasks
from packit_sim.game.episodes.episode import Stage

ALMOST_1000 = range(800, 1201)
"""Numbers of placements that count as about 1,000."""

DATASET = "everyday-v1"
SPLIT = "validation"


def decide(task: Task, scorer: Scorer, found: Times) -> None:
    """Play a task to the end, and measure each decision."""
    layout = new_layout(task)
    while True:
        started = time.process_time()
        placements = layout.placements()
        listed = time.process_time()
        scores = scorer(placements.features)
        scored = time.process_time()
        if not len(placements):
            return
        layout.place(placements, np.argsort(-scores, kind="stable").tolist())
        ended = time.process_time()
        decision = 1000 * (ended - started)
        found["placements in a decision"].append(len(placements))
        found["ms to list placements, with features"].append(1000 * (listed - started))
        found["ms of the network"].append(1000 * (scored - listed))
        found["ms to choose, with meshes"].append(1000 * (ended - scored))
        found["ms of a decision"].append(decision)
        if len(placements) in ALMOST_1000:
            found["ms of a decision, 800 to 1,200 placements"].append(decision)


def search(task: Task, agent: Agent, layouts: int, found: Times) -> None:
    """Measure the layouts a second of a search, unless it ends early."""
    done: list[float] = []
    started = time.process_time()
    RuinAndRecreate(Budget(rollouts=layouts))(
        agent, Episode(task), np.random.default_rng(0), lambda _, total: done.append(total)
    )
    if len(done) == layouts:
        found["layouts a second"].append(layouts / (time.process_time() - started))


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--tasks", type=int, default=50, help="number of tasks, the first")
    parser.add_argument("--layouts", type=int, default=100, help="layouts of each search")
    arguments = parser.parse_args()
    agent = Agent.from_name("champion")
    policy = agent.policy(Stage.SHAPE)
    assert isinstance(policy, PlacementPolicy)
    tasks = load_tasks(DATASET, split=SPLIT)[: arguments.tasks]
    decide(tasks[0], policy.scorer, defaultdict(list))  # kernels are compiled
    found: Times = defaultdict(list)
    for task in tasks:
        decide(task, policy.scorer, found)
    for task in tasks:
        search(task, agent, arguments.layouts, found)
    rows = summaries(found)
    Console().print(summary_table(rows, "champion", "median", ",.3g"))
    result = {
        "command": "python -m benchmarks.champion",
        "dataset": DATASET,
        "split": SPLIT,
        "tasks": len(tasks),
        "layouts": arguments.layouts,
        "machine": machine(),
        **rows,
    }
    write_json(arguments.out / "champion.json", result)


if __name__ == "__main__":
    main()
