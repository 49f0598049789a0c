"""Measure the cost and the accuracy of convex decomposition and of settling.

    .venv/bin/python -m benchmarks.physics
    .venv/bin/python -m benchmarks.physics --dataset everyday-v1 --split test    # all 150, an hour

New shapes are decomposed first; pieces on disk are read. Times are CPU seconds, so that other work
on the machine does not count. Prints tables, and writes `benchmarks/results/physics.json`; with
--pictures FOLDER also pictures of the least stable pack before and after, `packed.png` and
`settled.png`.
"""

from __future__ import annotations

import resource
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.progress import Progress, track

from benchmarks.common import argument_parser, machine, summary, summary_table, write_json
from packit_sim import Pack, Shape, ShapeLibrary, read_packs
from packit_sim.core import caches
from packit_sim.core.parallel import Workers
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.pack_files import dataset_file
from packit_sim.physics.convex.decomposition import (
    Decomposition,
    decompose,
    decompose_all,
    decompose_anew,
)
from packit_sim.physics.penetration import penetrations, wall_penetrations
from packit_sim.physics.quality import FLOATING_HEIGHT
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.settling import Settled, settle
from packit_sim.physics.stability import stability
from packit_sim.placement import BoxState, PlacedItem, compact, disassemble, drops
from packit_sim.render.layouts import Layout
from packit_sim.scene import Scene

_T = TypeVar("_T")

PENETRATION = 0.01
"""Largest accepted depth of an item in another or in a wall: 5 mm in a box of half a metre."""

SECONDS = 3.0
"""The aim for settling a pack, in the median."""

WEIGHTLESS = 1.0
"""Seconds without gravity: any motion is then due to pieces that overlap at the start."""

MEASURED = (
    *("items", "settle, s", "simulated, s", "cut", "drift", "drift, not fitted"),
    *("deepest in another", "deepest in a wall", "stability, whole", "stability, as packed"),
    *("ways, s", "insertable", "from above", "removable", "interlocked", "floating"),
    *("pushed, s", "filled", "filled, pushed"),
)
"""The measures of a pack that are summarised."""


def cpu_timed(function: Callable[[], _T]) -> tuple[float, _T]:
    """Measure the CPU seconds of a call, child processes included; also return its result."""

    def used() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + children.ru_utime + children.ru_stime

    before = used()
    result = function()
    return used() - before, result


def decompose_with_progress(
    shapes: list[Shape], settings: PhysicsSettings, workers: int | None
) -> dict[str, Decomposition]:
    """Decompose shapes, with a progress bar; return the decompositions by id."""
    with Progress() as progress:
        task = progress.add_task("decomposing", total=len(shapes))
        found = decompose_all(
            shapes, settings.decomposition, workers, lambda shape, one: progress.advance(task)
        )
    return {shape.id: one for shape, one in zip(shapes, found, strict=True)}


def measure_decompositions(
    shapes: list[Shape], settings: PhysicsSettings, workers: int | None, anew: int
) -> dict[str, Any]:
    """Summarise the pieces of all shapes; measure the cost of decomposing some of them anew."""
    found = decompose_with_progress(shapes, settings, workers)
    reading = []
    for shape in shapes:
        caches.clear("decompositions")
        reading.append(cpu_timed(partial(decompose, shape, settings.decomposition))[0])
    concave = [shape for shape in shapes if found[shape.id].method != "convex"]
    computing = [
        cpu_timed(partial(decompose_anew, s, settings.decomposition))[0] for s in concave[:anew]
    ]
    return {
        "shapes": len(shapes),
        "methods": dict(Counter(one.method for one in found.values())),
        "problems": {id: one.problem for id, one in found.items() if one.problem},
        "pieces": summary([len(one.pieces) for one in found.values()]),
        "volume error": summary([one.volume_error for one in found.values()]),
        "volume error, size": summary([abs(one.volume_error) for one in found.values()]),
        "farthest out, canonical units": summary([max(one.distances) for one in found.values()]),
        "read, s": summary(reading),
        "made, s": summary(computing) if computing else None,
    }


def cut(settled: Settled, settings: PhysicsSettings) -> float:
    """Compute the share of the pieces' volume that was cut off where they were fitted."""
    whole = left = 0.0
    for one in settled.items:
        pieces = decompose(one.item.shape, settings.decomposition).pieces
        whole += one.item.scale * plain_sum(piece.volume for piece in pieces)
        left += plain_sum(piece.volume for piece, _ in one.parts)
    return 1 - left / whole


def drift(box: BoxState[PlacedItem], settings: PhysicsSettings, fitted: bool) -> float:
    """Measure how far overlaps alone move the farthest item, in box units."""
    weightless = replace(settings, fitted=fitted, gravity=0.0, time_limit=WEIGHTLESS)
    return max(item.farthest for item in settle(box, weightless).items)


def measure_pack(
    number: int, box: BoxState[PlacedItem], settings: PhysicsSettings
) -> tuple[int, dict[str, Any]]:
    """Take all measures of one pack; return them with its number."""
    seconds, settled = cpu_timed(lambda: settle(box, settings))
    depths = penetrations(settled)
    stable = stability(box, settings)
    routes_seconds, routes = cpu_timed(lambda: disassemble(box))
    pushed_seconds, pushed = cpu_timed(lambda: compact(box))
    return number, {
        "items": len(box.placed),
        "settle, s": seconds,
        "simulated, s": settled.seconds,
        "at rest": settled.at_rest,
        "same again": moves(stable.settled) == moves(settled),
        "cut": cut(settled, settings),
        "drift": drift(box, settings, fitted=True),
        "drift, not fitted": drift(box, settings, fitted=False),
        "energy, J": settled.energy,
        "inside": sum(item.inside for item in settled.items),
        "deepest in another": max(depths.values(), default=0.0),
        "deepest in a wall": max(wall_penetrations(settled), default=0.0),
        "too deep": [(*pair, depth) for pair, depth in depths.items() if depth > PENETRATION],
        "stability, whole": stable.whole,
        "stability, as packed": stable.as_packed,
        "ways, s": routes_seconds,
        "insertable": routes.insertable,
        "from above": routes.insertable_from_above,
        "removable": routes.removable,
        "interlocked": len(routes.interlocked),
        "floating": int((drops(box) > FLOATING_HEIGHT).sum()),
        "pushed, s": pushed_seconds,
        "filled": pushed.filled[0],
        "filled, pushed": pushed.filled[1],
        "farthest moved": [item.farthest for item in settled.items],
    }


def moves(settled: Settled) -> list[bytes]:
    return [item.move.matrix.tobytes() for item in settled.items]


def pictures(box: BoxState[PlacedItem], settings: PhysicsSettings, folder: Path) -> None:
    """Draw a pack before and after settling, by one camera that sees both."""
    with Scene(box) as scene:
        settled = settle(box, settings)
        packed, after = Layout.packed(box.placed, settled.size), Layout.settled(settled.items)
        points = np.concatenate((packed.points, after.points))
        for name, layout in (("packed", packed), ("settled", after)):
            image = scene.snapshot(800, 800, layout=replace(layout, points=points))
            image.save(folder / f"{name}.png")


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--dataset", default="starter", help="a dataset's name or path")
    parser.add_argument("--split", help="split of the dataset")
    parser.add_argument("--limit", type=int, help="evaluate only the first N packs")
    parser.add_argument("--workers", type=int, help="number of processes")
    parser.add_argument(
        "--anew",
        type=int,
        default=3,
        help="number of shapes to decompose anew, to measure the time",
    )
    parser.add_argument("--pictures", type=Path, help="folder for two pictures")
    arguments = parser.parse_args()
    library = ShapeLibrary.open("everyday")
    packs: list[Pack] = read_packs(dataset_file(arguments.dataset, arguments.split))
    boxes = [pack.contents(library) for pack in packs[: arguments.limit]]
    shapes = {p.item.shape.id: p.item.shape for box in boxes for p in box.placed}
    settings = PhysicsSettings()
    pieces = measure_decompositions(
        [shapes[id] for id in sorted(shapes)], settings, arguments.workers, arguments.anew
    )
    jobs = [(n, box, settings) for n, box in enumerate(boxes)]
    with Workers(arguments.workers or 0) as workers:
        found = dict(track(workers.as_done(measure_pack, jobs), "settling", total=len(boxes)))
    rows = [found[n] for n in range(len(boxes))]
    result = {
        "command": "python -m benchmarks.physics",
        "packs": {"dataset": arguments.dataset, "split": arguments.split, "count": len(boxes)},
        "library": library.digest,
        "machine": machine(),
        "settings": asdict(settings),
        "decompositions": pieces,
        "at rest": sum(row["at rest"] for row in rows),
        "same again": sum(row["same again"] for row in rows),
        "items inside": sum(row["inside"] for row in rows) / sum(row["items"] for row in rows),
        "pairs too deep": sum(len(row["too deep"]) for row in rows),
        **{name: summary([row[name] for row in rows]) for name in MEASURED},
        "each": rows,
    }
    console = Console(width=100)
    console.print(pieces)
    rows_shown = {name: result[name] for name in MEASURED}
    console.print(summary_table(rows_shown, "measure of a pack", "median", ".3g"))
    console.print({key: result[key] for key in ("at rest", "same again", "items inside")})
    console.print("pairs deeper than", PENETRATION, ":", result["pairs too deep"])
    write_json(arguments.out / "physics.json", result)
    if arguments.pictures is not None:
        least = min(range(len(rows)), key=lambda n: rows[n]["stability, whole"])
        pictures(boxes[least], settings, arguments.pictures)


if __name__ == "__main__":
    main()
