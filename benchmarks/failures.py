"""Look at what an agent leaves outside: the share of each size of items, and the worst tasks.

    .venv/bin/packit evaluate everyday-v1 --split test --agent champion --out champion.jsonl
    .venv/bin/python -m benchmarks.failures champion.jsonl everyday-v1 --split test

Prints what stays outside as two tables, and draws the tasks with the lowest returns next to their
own solutions. Writes `benchmarks/results/failures.json` and `docs/images/benchmark-failures.png`;
with several results files, such as an agent with and without a search, there is a column for each,
and the picture is of the first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.common import argument_parser, machine, markdown_table, plot_file, write_json
from packit_sim import Rollout, Task, load_tasks, read_results
from packit_sim.game.datasets.pack_files import dataset_library
from packit_sim.game.paper.figures import draw_failures

WORST = 5
"""Tasks to draw."""

MANY = 3
"""So many items outside are counted together with more."""

THIRDS = ("largest", "middle", "smallest")
"""The items of a task by volume, in three parts of the same number."""


def left_outside(rollout: Rollout, task: Task) -> list[int]:
    """Return the ranks by volume, from 0 for the largest, of the items that are not in the box."""
    packed = Counter((one.shape, one.scale) for one in rollout.pack.items)
    outside = []
    for rank, item in enumerate(sorted(task.items, key=lambda item: -item.volume)):
        if packed[item.shape.id, item.scale]:
            packed[item.shape.id, item.scale] -= 1
        else:
            outside.append(rank)
    return outside


def measures(rollouts: Sequence[Rollout], tasks: Sequence[Task]) -> dict[str, float]:
    """Compute the mean return, how many items stay outside, and of which size those are."""
    numbers: list[int] = []
    lost = np.zeros(len(THIRDS))
    for rollout in rollouts:
        task = tasks[rollout.task]
        volumes = sorted((item.volume for item in task.items), reverse=True)
        outside = left_outside(rollout, task)
        numbers.append(len(outside))
        for rank in outside:
            lost[len(THIRDS) * rank // len(volumes)] += volumes[rank] / task.volume
    counts = np.bincount(np.minimum(numbers, MANY), minlength=MANY + 1) / len(numbers)
    of_loss = lost / (lost.sum() or 1.0)
    names = [f"tasks with {n} items outside" for n in range(MANY)]
    return {
        "mean return": float(np.mean([rollout.total for rollout in rollouts])),
        **dict(zip([*names, f"tasks with {MANY} or more"], counts.tolist(), strict=True)),
        **{
            f"share of the {third} third of items in the loss": share
            for third, share in zip(THIRDS, of_loss.tolist(), strict=True)
        },
    }


def describe(rollout: Rollout, task: Task) -> tuple[object, ...]:
    """Describe what a rollout left outside, as a row of a table."""
    volumes = sorted((item.volume for item in task.items), reverse=True)
    outside = left_outside(rollout, task)
    shares = ", ".join(f"{100 * volumes[n] / task.volume:.1f}% (number {n + 1})" for n in outside)
    return rollout.task, len(volumes), f"{rollout.total:.3f}", f"{task.pack.density:.2f}", shares


def main() -> None:
    parser = argument_parser(__doc__, "the JSON and, unless it is the default, the picture")
    parser.add_argument("results", type=Path, nargs="+", help="results files of one agent each")
    parser.add_argument("dataset", help="the dataset that they played")
    parser.add_argument("--split", help="its split")
    arguments = parser.parse_args()
    tasks = load_tasks(arguments.dataset, split=arguments.split)
    played = {}
    for file in arguments.results:
        rollouts = read_results(file)
        played[rollouts[0].agent] = rollouts
    found = {agent: measures(rollouts, tasks) for agent, rollouts in played.items()}
    names = next(iter(found.values()))
    rows = [[name, *(f"{own[name]:.3f}" for own in found.values())] for name in names]
    print(markdown_table(["", *(f"`{agent}`" for agent in found)], rows))
    worst = sorted(next(iter(played.values())), key=lambda rollout: rollout.total)[:WORST]
    head = ["task", "items", "return", "density of its solution", "left outside, of all volume"]
    print(markdown_table(head, [describe(rollout, tasks[rollout.task]) for rollout in worst]))
    library = dataset_library(arguments.dataset, arguments.split)
    draw_failures(worst, tasks, library, plot_file(arguments.out, "failures"))
    result = {
        "command": "python -m benchmarks.failures",
        "dataset": arguments.dataset,
        "split": arguments.split,
        "machine": machine(),
        "agents": found,
        "worst": {rollout.task: rollout.total for rollout in worst},
    }
    write_json(arguments.out / "failures.json", result)


if __name__ == "__main__":
    main()
