"""Pack sequences of everyday objects online: learned agents beside rules.

    .venv/bin/python -m benchmarks.online_everyday --tasks 50        (an hour; resumable)
    .venv/bin/python -m benchmarks.online_everyday --tasks 20 --agent champion --agent best-fit
    .venv/bin/python -m benchmarks.online_everyday --tasks 3 --agent champion --items 1000

Sequence n of the test split is drawn with the seed 20000 + n from the items of the test packs of
everyday-v1, as `packit datasets sequences --items-of everyday-v1 --split test --seed 20000` does:
40 items, more than fit, or --items. A buffer of 5, from above only, all 24 rotations, seed 0, one
process. Prints the density of the boxes with 95% intervals, and how much denser those of the first
agent are, and writes `benchmarks/results/online_everyday.json`, or `...-ITEMS.json`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, write_json
from packit_sim import ItemSampler, Rules, ShapeLibrary, evaluate, load_tasks
from packit_sim.core.confidence import Estimate, format_estimate

AGENTS = (
    "online-champion",
    "champion",
    "best-fit",
    "largest-first/best-fit/best-fit",
    "largest-fitting-first/lowest/maximal-contact",
    "largest-first/lowest/blbf",
    "largest-first/aligned/blbf",
    "oldest-first/lowest/blbf",
)

RULES = Rules(kinematic=True, buffer=5)

SEEDS = {"train": 0, "validation": 10_000, "test": 20_000}
"""The seed of the first sequence of each split."""

ITEMS = 40


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--tasks", type=int, default=50)
    parser.add_argument("--split", default="test", choices=SEEDS)
    parser.add_argument("--items", type=int, default=ITEMS)
    parser.add_argument("--work", type=Path, default=Path("build/online"), help="for results")
    parser.add_argument("--agent", action="append", help="an agent to play; may be repeated")
    options = parser.parse_args()
    library = ShapeLibrary.open("everyday")
    sampler = ItemSampler(library, load_tasks("everyday-v1", library, options.split), options.items)
    first = SEEDS[options.split]
    tasks = [sampler.pack(first + n).task(library) for n in range(options.tasks)]
    densities, seconds = {}, {}
    for agent in options.agent or AGENTS:
        file = options.work / f"{options.split}-{agent.replace('/', '-')}.jsonl"
        rollouts = evaluate([agent], tasks, 0, rules=RULES, file=file)
        densities[agent] = np.array([rollout.pack.density for rollout in rollouts])
        seconds[agent] = float(np.median([rollout.played.seconds for rollout in rollouts]))
        print(f"{agent}: {densities[agent].mean():.3f}", flush=True)
    shown = Table("agent", "density", "the first one's is larger by", "s a task")
    best = next(iter(densities.values()))
    for agent, own in densities.items():
        gain = "" if own is best else format_estimate(Estimate.of(best - own), "+.3f")
        density = format_estimate(Estimate.of(own), ".3f")
        shown.add_row(agent, density, gain, f"{seconds[agent]:.2g}")
    Console(width=160).print(shown)
    found = {
        agent: {"densities": own.tolist(), "seconds": seconds[agent]}
        for agent, own in densities.items()
    }
    name = "online_everyday" if options.items == ITEMS else f"online_everyday-{options.items}"
    write_json(
        options.out / f"{name}.json",
        {"machine": machine(), "split": options.split, "agents": found},
    )


if __name__ == "__main__":
    main()
