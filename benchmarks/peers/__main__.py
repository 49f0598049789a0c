"""Other ways of packing on the same tasks, and whether what they make holds.

    .venv/bin/python -m benchmarks.peers --packs everyday-v1 --split test --tasks 20

Each peer packs what fits of a task's items, then of the items of two tasks together, of which no
box holds all. Every packing, PackIt-Sim's own too, is checked by its meshes (see `validity`).
Prints tables, and writes `benchmarks/results/peers.json` and `.png`; what the file holds already
is not packed again, unless a peer's settings changed.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.peers import picture
from benchmarks.peers.cuboids import Cuboids
from benchmarks.peers.heightmaps import Heightmaps
from benchmarks.peers.heuristic import VoxelHeuristic
from benchmarks.peers.players import Player
from benchmarks.peers.posed import Peer
from benchmarks.peers.rows import Row, Summary, read, summaries, write
from benchmarks.peers.spectral import Spectral
from packit_sim import ShapeLibrary
from packit_sim.cli.console import console, progress_bars
from packit_sim.cli.evaluation_commands import interval, show_agents
from packit_sim.core import caches
from packit_sim.datasets.pack_files import load_tasks
from packit_sim.datasets.packs import Task
from packit_sim.render import plots

AGENTS = (
    "largest-first/aligned/blbf",
    "largest-first/lowest/blbf",
    "largest-first/aligned/blbf+lns=50",
)
"""The paper's heuristic, the same free to turn items as the others are, and with a search."""

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
"""How many tasks' items go to one box."""

RESULTS = Path(__file__).parents[1] / "results"

SAVE_SECONDS = 30.0
"""Between writings: what a kill can lose, and the packing under way."""


def joined(tasks: Sequence[Task], together: int) -> Iterator[Task]:
    """So many neighbours at a time as one, with the first one's box; the rest is left over."""
    for n in range(0, len(tasks) - together + 1, together):
        some = tasks[n : n + together]
        items = sorted(
            (item for task in some for item in task.items),
            key=lambda item: (item.shape.id, item.scale),
        )
        yield replace(some[0], items=tuple(items), solution=()) if together > 1 else some[0]


def packed(peer: Peer, task: Task, together: int) -> Row:
    """One packing, from the meshes on, and what it is worth."""
    caches.clear()
    started = time.process_time()
    packing = peer.pack(task)
    seconds = time.process_time() - started
    return Row.of(peer.name, together, task, packing, seconds)


def table(made: Sequence[Summary]) -> Table:
    """One peer a row, by its number."""
    of = made[0]
    alone = of.together == 1
    boxes = "one task a box" if alone else f"items of {of.together} tasks a box"
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    table.title = f"{boxes}: {of.packings} packings"
    table.caption = (
        "shares of the items' volume: packed, what of it holds, and that less the first's; "
        "below each mean its 95% bootstrap interval; s: median processor seconds"
    )
    fourth = "all in %" if alone else "density"
    for column in ("", "volume", "holds", "less 1's", fourth, "valid %", "pairs", "s"):
        table.add_column(column, justify="right", no_wrap=True)
    for number, each in enumerate(made, start=1):
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
    """A peer's, as the file has them."""
    return json.loads(json.dumps({"kind": type(peer).__name__, **vars(peer)}))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packs", default="everyday-v1", help="a dataset's name, folder or file")
    parser.add_argument("--split", default="train", help="which of its splits")
    parser.add_argument("--library", default="everyday", help="of its shapes")
    parser.add_argument("--tasks", type=int, default=20, help="only so many, the first")
    parser.add_argument(
        "--agent", action="append", help="PackIt-Sim's; the first is what others compare with"
    )
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for JSON and picture")
    arguments = parser.parse_args()
    plots.require()
    library = ShapeLibrary.open(arguments.library)
    tasks = load_tasks(arguments.packs, library, arguments.split)[: arguments.tasks]
    agents = tuple(dict.fromkeys(arguments.agent or AGENTS))
    free, *more = map(Player, agents)
    peers: list[Peer] = [free, Player(agents[0], skipping=False), *more, *OTHERS]
    named = "".join(f" --agent {agent}" for agent in arguments.agent or ())
    head: dict[str, Any] = {
        "command": f"python -m benchmarks.peers --packs {arguments.packs} "
        f"--split {arguments.split} --tasks {len(tasks)}{named}",
        "library": {"name": library.name, "digest": library.digest},
        "machine": {"python": platform.python_version(), "cores": os.cpu_count()},
        "peers": {peer.name: settings(peer) for peer in peers},
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "peers.json"
    done = {(row.peer, row.together, row.task): row for row in read(file, head)}
    boxes = [(task, together) for together in TOGETHER for task in joined(tasks, together)]

    def keep() -> list[Summary]:
        """Writes the rows that there are, and a summary of the tasks that every peer has packed."""
        groups = [
            [done.get((peer.name, together, task.digest)) for peer in peers]
            for task, together in boxes
        ]
        rows = [row for group in groups for row in group if row is not None]
        whole = [row for group in groups if None not in group for row in group if row is not None]
        made = summaries(whole, peers[0].name)
        write(file, head, made, rows)
        return made

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
                    row = packed(peer, task, together)
                    done[peer.name, together, task.digest] = row
                progress.advance(bar)
                if time.monotonic() - saved > SAVE_SECONDS:
                    keep()
                    saved = time.monotonic()
        progress.update(bar, note="")
    made = keep()
    show_agents(peer.name for peer in peers)
    for together in TOGETHER:
        some = [each for each in made if each.together == together]
        if some:
            console.print(table(some))
    picture.save(made, arguments.out / "peers.png")
    console.print(f"kept in {file} and beside it")


if __name__ == "__main__":
    main()
