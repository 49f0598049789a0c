"""Compare other packing methods on the same tasks, and check whether their packings are valid.

    .venv/bin/python -m benchmarks.peers --dataset everyday-v1 --split test --tasks 20

Each peer packs the items of a task, then the items of two tasks together, which never all fit in
one box. Every packing, also PackIt-Sim's own, is checked by its meshes (see `validity`). Prints
tables, and writes `benchmarks/results/peers.json` and `docs/images/benchmark-peers.png`. Packings
that are already in the file are not repeated unless the peer's settings changed.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.common import argument_parser, machine, plot_file
from benchmarks.peers import picture
from benchmarks.peers.cuboids import Cuboids
from benchmarks.peers.heightmaps import Heightmaps
from benchmarks.peers.heuristic import VoxelHeuristic
from benchmarks.peers.players import Player
from benchmarks.peers.posed import Peer
from benchmarks.peers.rows import Row, Summary, read, summaries, write
from benchmarks.peers.spectral import Spectral
from packit_sim import ShapeLibrary
from packit_sim.cli.evaluations import interval, show_agents
from packit_sim.cli.terminal import console, progress_bars
from packit_sim.core import caches
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.render import plots

AGENTS = (
    "largest-first/aligned/blbf",
    "largest-first/lowest/blbf",
    "largest-first/aligned/blbf+lns=50",
)
"""The paper's heuristic, with a free choice of rotations as other peers have, and with a search."""

OTHERS: tuple[Peer, ...] = (
    VoxelHeuristic(1),
    VoxelHeuristic(2),
    VoxelHeuristic(4),
    VoxelHeuristic(1, sampled=True),
    VoxelHeuristic(2, sampled=True),
    Spectral(1),
    Spectral(2),
    Spectral(1, sampled=True),
    Spectral(2, sampled=True),
    Heightmaps(),
    Heightmaps(sampled=True),
    Cuboids(),
)

TOGETHER = (1, 2)
"""Numbers of tasks whose items share a box."""

SAVE_SECONDS = 30.0
"""Time between saves, which is what an interrupted run can lose."""


def join_tasks(tasks: Sequence[Task], together: int) -> Iterator[Task]:
    """Join groups of consecutive tasks, with the box of the first; drop an incomplete group."""
    for n in range(0, len(tasks) - together + 1, together):
        group = tasks[n : n + together]
        items = sorted(
            (item for task in group for item in task.items),
            key=lambda item: (item.shape.id, item.scale),
        )
        yield replace(group[0], items=tuple(items), solution=()) if together > 1 else group[0]


def measure(peer: Peer, task: Task, together: int) -> Row:
    """Pack a task with cleared caches, and evaluate the packing."""
    caches.clear()
    started = time.process_time()
    packing = peer.pack(task)
    seconds = time.process_time() - started
    return Row.of(peer.name, together, task, packing, seconds)


def summary_table(rows: Sequence[Summary]) -> Table:
    """Tabulate one peer a row, by its number."""
    first = rows[0]
    alone = first.together == 1
    boxes = "one task a box" if alone else f"items of {first.together} tasks a box"
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    table.title = f"{boxes}: {first.packings} packings"
    table.caption = (
        "shares of the items' volume: packed, valid, and valid minus the first peer's; "
        "below each mean its 95% bootstrap interval; s: median processor seconds"
    )
    fourth = "all in %" if alone else "density"
    for column in ("", "volume", "valid", "minus 1's", fourth, "valid %", "pairs", "s"):
        table.add_column(column, justify="right", no_wrap=True)
    for number, each in enumerate(rows, start=1):
        table.add_row(
            str(number),
            interval(each.share, ".3f", ".2f"),
            interval(each.kept, ".3f", ".2f"),
            interval(each.difference.difference, "+.3f", "+.2f"),
            interval(each.complete, ".0f", ".0f")
            if alone
            else interval(each.kept_density, ".3f", ".2f"),
            interval(each.valid, ".0f", ".0f"),
            interval(each.pairs, ".1f", ".1f"),
            f"{each.seconds:.2g}",
        )
    return table


def settings(peer: Peer) -> Any:
    """Describe a peer's settings as in the file."""
    return json.loads(json.dumps({"kind": type(peer).__name__, **vars(peer)}))


def main() -> None:
    parser = argument_parser(__doc__, "JSON and picture")
    parser.add_argument("--dataset", default="everyday-v1", help="a dataset's name, folder or file")
    parser.add_argument("--split", default="train", help="split of the dataset")
    parser.add_argument("--library", default="everyday", help="library of its shapes")
    parser.add_argument("--tasks", type=int, default=20, help="pack only the first N tasks")
    parser.add_argument(
        "--agent", action="append", help="agent of PackIt-Sim; peers are compared with the first"
    )
    arguments = parser.parse_args()
    plots.require()
    library = ShapeLibrary.open(arguments.library)
    tasks = load_tasks(arguments.dataset, library, arguments.split)[: arguments.tasks]
    agents = tuple(dict.fromkeys(arguments.agent or AGENTS))
    free, *more = map(Player, agents)
    peers: list[Peer] = [free, Player(agents[0], skipping=False), *more, *OTHERS]
    named = "".join(f" --agent {agent}" for agent in arguments.agent or ())
    head: dict[str, Any] = {
        "command": f"python -m benchmarks.peers --dataset {arguments.dataset} "
        f"--split {arguments.split} --tasks {len(tasks)}{named}",
        "library": {"name": library.name, "digest": library.digest},
        "machine": machine(),
        "peers": {peer.name: settings(peer) for peer in peers},
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "peers.json"
    done = {(row.peer, row.together, row.task): row for row in read(file, head)}
    boxes = [(task, together) for together in TOGETHER for task in join_tasks(tasks, together)]

    def save() -> list[Summary]:
        """Write all rows, and a summary of the tasks that every peer has packed."""
        groups = [
            [done.get((peer.name, together, task.digest)) for peer in peers]
            for task, together in boxes
        ]
        rows = [row for group in groups for row in group if row is not None]
        whole = [row for group in groups if None not in group for row in group if row is not None]
        means = summaries(whole, peers[0].name)
        write(file, head, means, rows)
        return means

    if not done:
        for peer in peers:
            peer.pack(tasks[0])  # compiles
    saved = time.monotonic()
    with progress_bars() as progress:
        bar = progress.add_task("packing", total=len(boxes) * len(peers), note="")
        for task, together in boxes:
            for peer in peers:
                progress.update(bar, note=f"{peer.name}, {len(task.items)} items")
                if (peer.name, together, task.digest) not in done:
                    row = measure(peer, task, together)
                    done[peer.name, together, task.digest] = row
                progress.advance(bar)
                if time.monotonic() - saved > SAVE_SECONDS:
                    save()
                    saved = time.monotonic()
        progress.update(bar, note="")
    means = save()
    show_agents(peer.name for peer in peers)
    for together in TOGETHER:
        chosen = [each for each in means if each.together == together]
        if chosen:
            console.print(summary_table(chosen))
    plot = plot_file(arguments.out, "peers")
    picture.save(means, plot)
    console.print(f"wrote {file} and {plot}")


if __name__ == "__main__":
    main()
