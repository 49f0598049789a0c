"""Pack sequences of BlockOut's kind online, by our agents, next to published results.

    .venv/bin/python -m benchmarks.online                  (an hour; resumable)
    .venv/bin/python -m benchmarks.online --sequences 50 --agent "oldest-first/lowest/blbf+lns=10"
    .venv/bin/python -m benchmarks.online --sequences 500 --agent "knows all arrivals"

Sequence n is drawn with the seed n. Each agent plays each sequence with each buffer, by the
kinematic rule, with rotations about the vertical axis only. The number of packed shapes of each
game is kept in `benchmarks/results/online.json`; games that it contains are not played again.

"knows all arrivals" is no agent of the game: a beam of 1,000 states, by the bundled values of
columns, that sees the whole sequence. What it packs can be packed; more may be possible.

Utilisation is the nominal volume of the packed shapes, each four cubes of 0.059 m, over that of the
published bin, 0.32 x 0.32 x 0.30 m.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, write_json
from packit_agents.online.column_kernels import plan
from packit_agents.online.policies import bundled_tables
from packit_sim import Agent, Rules, ShapeLibrary, Task, evaluate
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.game.generation.sequences import SequenceSampler

AGENTS = ("best-fit/best-fit/best-fit", "oldest-first/lowest/blbf", "blockout", "blockout-ahead")

KNOWING = "knows all arrivals"

WIDTH = 1_000
"""States that it keeps after each placement."""

BUFFERS = (1, 3, 5, 10)

PUBLISHED = {1: 71.0, 3: 71.7, 5: 74.8, 10: 78.0}
"""Mean utilisation of IR-BPP on BlockOut in percent, 2,000 sequences, by the size of the buffer."""

CELL_CM = 5.9
CELLS = (20, 20, 20)
SHARE = 100 * 4 * CELL_CM**3 / (32 * 32 * 30)
"""Share of the published bin that a shape fills, in percent."""

CHECKPOINT = 10
"""Games after which results are written."""


def play(runs: dict[str, Any], file: Path, agent: str, buffer: int, sequences: int) -> None:
    """Play the games of an agent with a buffer that are not in the results yet."""
    sampler = SequenceSampler(ShapeLibrary.open("blockout"), CELLS, CELL_CM)
    rules = Rules(kinematic=True, buffer=buffer, rotations="yaw")
    run = runs.setdefault(agent, {}).setdefault(str(buffer), {"packed": [], "seconds": 0.0})
    player = None if agent == KNOWING else Agent.from_name(agent)
    for seed in range(len(run["packed"]), sequences):
        started = time.thread_time()
        task = sampler.pack(seed).task(sampler.library)
        if player is None:
            packed = pack_knowing(task, buffer)
        else:
            (rollout,) = evaluate([player], [task], 0, rules=rules, numbers=[seed])
            packed = len(rollout.pack.items)
        run["packed"].append(packed)
        run["seconds"] += time.thread_time() - started
        if seed % CHECKPOINT == CHECKPOINT - 1 or seed == sequences - 1:
            write_json(file, runs)


def pack_knowing(task: Task, buffer: int) -> int:
    """Return how many shapes a beam packs that knows all arrivals."""
    tables = bundled_tables()
    shapes = np.array([tables.game.shape(item) for item in task.arriving.items])
    counts = np.bincount(shapes[:buffer], minlength=len(tables.game.shapes))
    heights = tables.game.heights(())
    arrays = tables.game.arrays, tables.arrays(buffer)
    _, packed = plan(heights, counts, shapes[buffer:], *arrays, len(shapes), WIDTH, 0)
    return int(packed)


def rows(runs: dict[str, Any]) -> list[list[str]]:
    """Tabulate the published utilisations and ours: agent, one by buffer, sequences, seconds."""
    found = [["IR-BPP (published)", *(f"{PUBLISHED[b]:.1f}" for b in BUFFERS), "2,000", ""]]
    for agent, by_buffer in runs.items():
        row = [agent]
        for buffer in BUFFERS:
            packed = by_buffer.get(str(buffer), {"packed": []})["packed"]
            row.append(
                format_estimate(Estimate.of(SHARE * np.array(packed)), ".1f") if packed else ""
            )
        played = [len(run["packed"]) for run in by_buffer.values()]
        seconds = sum(run["seconds"] for run in by_buffer.values()) / sum(played)
        found.append([*row, f"{min(played)}", f"{seconds:.2g}"])
    return found


def main() -> None:
    """Play what is missing, and print the table."""
    parser = argument_parser(__doc__)
    parser.add_argument("--sequences", type=int, default=500, help="number of sequences")
    parser.add_argument("--agent", action="append", help="an agent to play; may be repeated")
    parser.add_argument(
        "--buffer", type=int, action="append", choices=BUFFERS, help="a buffer; may be repeated"
    )
    arguments = parser.parse_args()
    file = arguments.out / "online.json"
    runs = json.loads(file.read_text()) if file.exists() else {}
    for buffer in arguments.buffer or BUFFERS:
        for agent in arguments.agent or AGENTS:
            play(runs, file, agent, buffer, arguments.sequences)
    shown = Table("agent", *(f"buffer {buffer}" for buffer in BUFFERS), "sequences", "s a sequence")
    for row in rows(runs):
        shown.add_row(*row)
    Console(width=160).print(shown)


if __name__ == "__main__":
    main()
