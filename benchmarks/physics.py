"""What it costs to take shapes apart and to let packs settle, and how far one can trust it.

    .venv/bin/python -m benchmarks.physics
    .venv/bin/python -m benchmarks.physics --packs everyday-v1 --split test    # all 150, an hour

Shapes that are new are decomposed first; what is kept from before is read. Times are of the
processor, in seconds, so that they mean something on a machine that does other things as well.
Prints tables, and writes `benchmarks/results/physics.json`; with --pictures FOLDER also how the
least stable pack stands before and after, `packed.png` and `settled.png`.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
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
from rich.table import Table

from benchmarks.placement import RESULTS, summary
from packit_sim import Pack, Shape, ShapeLibrary, read_packs
from packit_sim.core import caches
from packit_sim.core.parallel import Workers
from packit_sim.datasets.pack_files import dataset_file
from packit_sim.engine.compaction import compact, drops
from packit_sim.engine.disassembly import disassemble
from packit_sim.physics.convex.decomposition import decompose, decompose_all, decompose_anew
from packit_sim.physics.penetration import penetrations, wall_penetrations
from packit_sim.physics.quality import FLOATS
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.settling import Settled, settle
from packit_sim.physics.stability import stability
from packit_sim.placement import BoxState, PlacedItem
from packit_sim.render.layouts import Layout
from packit_sim.scene import Scene

_T = TypeVar("_T")

PENETRATION = 0.01
"""Box units: how deep settled items may be in each other or in a wall, 5 mm of half a metre."""

SECONDS = 3.0
"""The aim for settling a pack, in the median."""

WEIGHTLESS = 1.0
"""Seconds without gravity: what moves then is driven by pieces that overlap at the start."""

MEASURED = (
    *("items", "settle, s", "simulated, s", "cut", "drift", "drift, not fitted"),
    *("deepest in another", "deepest in a wall", "stability, whole", "stability, as packed"),
    *("ways, s", "insertable", "from above", "removable", "interlocked", "floating"),
    *("pushed, s", "filled", "filled, pushed"),
)
"""Of each pack; what is summed up over them."""


def timed(function: Callable[[], _T]) -> tuple[float, _T]:
    """Seconds of the processor, those of processes that ended meanwhile too; and the answer."""

    def used() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + children.ru_utime + children.ru_stime

    before = used()
    answer = function()
    return used() - before, answer


def decompositions(
    shapes: list[Shape], settings: PhysicsSettings, workers: int | None, anew: int
) -> dict[str, Any]:
    """What pieces come out, of all shapes; and what that costs, for some of them anew."""
    with Progress() as progress:
        task = progress.add_task("decomposing", total=len(shapes))
        all_found = decompose_all(
            shapes,
            settings.decomposition,
            workers,
            lambda shape, one: progress.advance(task),
        )
    found = {shape.id: one for shape, one in zip(shapes, all_found, strict=True)}
    reading = []
    for shape in shapes:
        caches.clear("decompositions")
        reading.append(timed(partial(decompose, shape, settings.decomposition))[0])
    hollow = [shape for shape in shapes if found[shape.id].method != "convex"]
    making = [timed(partial(decompose_anew, s, settings.decomposition))[0] for s in hollow[:anew]]
    return {
        "shapes": len(shapes),
        "methods": dict(Counter(one.method for one in found.values())),
        "problems": {id: one.problem for id, one in found.items() if one.problem},
        "pieces": summary([len(one.pieces) for one in found.values()]),
        "volume error": summary([one.volume_error for one in found.values()]),
        "volume error, size": summary([abs(one.volume_error) for one in found.values()]),
        "farthest out, canonical units": summary([max(one.distances) for one in found.values()]),
        "read, s": summary(reading),
        "made, s": summary(making) if making else None,
    }


def drift(box: BoxState[PlacedItem], settings: PhysicsSettings, fitted: bool) -> float:
    """How far the farthest item is driven by overlaps alone, in box units."""
    weightless = replace(settings, fitted=fitted, gravity=0.0, limit=WEIGHTLESS)
    return max(item.farthest for item in settle(box, weightless).items)


def of_pack(
    number: int, box: BoxState[PlacedItem], settings: PhysicsSettings
) -> tuple[int, dict[str, Any]]:
    """All that is measured of one pack, with its number."""
    seconds, settled = timed(lambda: settle(box, settings))
    depths = penetrations(settled)
    stable = stability(box, settings)
    ways_seconds, ways = timed(lambda: disassemble(box))
    pushed_seconds, pushed = timed(lambda: compact(box))
    return number, {
        "items": len(box.placed),
        "settle, s": seconds,
        "simulated, s": settled.seconds,
        "at rest": settled.at_rest,
        "same again": moves(stable.settled) == moves(settled),
        "cut": settled.cut,
        "drift": drift(box, settings, fitted=True),
        "drift, not fitted": drift(box, settings, fitted=False),
        "energy, J": settled.energy,
        "inside": sum(item.inside for item in settled.items),
        "deepest in another": max(depths.values(), default=0.0),
        "deepest in a wall": max(wall_penetrations(settled), default=0.0),
        "too deep": [(*pair, depth) for pair, depth in depths.items() if depth > PENETRATION],
        "stability, whole": stable.whole,
        "stability, as packed": stable.as_packed,
        "ways, s": ways_seconds,
        "insertable": ways.insertable,
        "from above": ways.insertable_from_above,
        "removable": ways.removable,
        "interlocked": len(ways.interlocked),
        "floating": int((drops(box) > FLOATS).sum()),
        "pushed, s": pushed_seconds,
        "filled": pushed.filled[0],
        "filled, pushed": pushed.filled[1],
        "farthest moved": [item.farthest for item in settled.items],
    }


def moves(settled: Settled) -> list[bytes]:
    return [item.move.tobytes() for item in settled.items]


def pictures(box: BoxState[PlacedItem], settings: PhysicsSettings, folder: Path) -> None:
    """Before and after, by one camera that sees both whole."""
    with Scene(box) as scene:
        settled = settle(box, settings)
        packed, after = Layout.packed(box.placed, settled.size), Layout.settled(settled.items)
        points = np.concatenate((packed.points, after.points))
        for name, layout in (("packed", packed), ("settled", after)):
            image = scene.snapshot(800, 800, layout=replace(layout, points=points))
            image.save(folder / f"{name}.png")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packs", default="starter", help="a dataset's name or path")
    parser.add_argument("--split", help="of the dataset")
    parser.add_argument("--limit", type=int, help="packs, from the first on")
    parser.add_argument("--workers", type=int, help="shapes, and packs, at a time")
    parser.add_argument("--anew", type=int, default=3, help="shapes to take apart for their time")
    parser.add_argument("--pictures", type=Path, help="folder for two pictures")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the JSON")
    arguments = parser.parse_args()
    library = ShapeLibrary.open("everyday")
    packs: list[Pack] = read_packs(dataset_file(arguments.packs, arguments.split))
    boxes = [pack.contents(library) for pack in packs[: arguments.limit]]
    shapes = {p.item.shape.id: p.item.shape for box in boxes for p in box.placed}
    settings = PhysicsSettings()
    pieces = decompositions(
        [shapes[id] for id in sorted(shapes)], settings, arguments.workers, arguments.anew
    )
    jobs = [(n, box, settings) for n, box in enumerate(boxes)]
    with Workers(arguments.workers or 0) as workers:
        found = dict(track(workers.as_done(of_pack, jobs), "settling", total=len(boxes)))
    rows = [found[n] for n in range(len(boxes))]
    result = {
        "command": "python -m benchmarks.physics",
        "packs": {"dataset": arguments.packs, "split": arguments.split, "count": len(boxes)},
        "library": library.digest,
        "machine": {"python": platform.python_version(), "cores": os.cpu_count()},
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
    table = Table("of a pack", "median", "10% to 90%", "n")
    for name in MEASURED:
        row = result[name]
        table.add_row(
            name, f"{row['median']:.3g}", f"{row['p10']:.3g} to {row['p90']:.3g}", str(row["n"])
        )
    console.print(table)
    console.print({key: result[key] for key in ("at rest", "same again", "items inside")})
    console.print("pairs deeper than", PENETRATION, ":", result["pairs too deep"])
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "physics.json").write_text(json.dumps(result, indent=1) + "\n")
    if arguments.pictures is not None:
        least = min(range(len(rows)), key=lambda n: rows[n]["stability, whole"])
        pictures(boxes[least], settings, arguments.pictures)


if __name__ == "__main__":
    main()
