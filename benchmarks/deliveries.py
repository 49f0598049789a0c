"""Pack parts for several stops through a door at the side, and compare with no order.

    .venv/bin/python -m benchmarks.deliveries --sets 20
    .venv/bin/python -m benchmarks.deliveries --table

A set has two copies each of ten random shapes of `everyday`, for 2 to 4 stops that take turns
among the shapes, whose volumes add up to 0.6 of a cube of 300 mm; the door is at each side in turn.
Each set is packed with and without `order="delivery"`, with limited passes of the search, so that
the results are repeatable. The order is checked by FCL, which the search does not use for that:
parts leave one after the other, the last placed first, in small steps straight through the door.
Writes each result to `benchmarks/results/deliveries.json` at once: what has a result is not packed
again; --table writes the table of `docs/benchmarks/parts.md`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import fcl
import numpy as np
from trimesh import Trimesh

from benchmarks.common import argument_parser, machine, markdown_table, write_into_page, write_json
from benchmarks.packing_parts import LIBRARY, PAGE, UNIT_MM, parts_of, selection
from packit_sim import PackedParts, PackSettings, Part, ShapeLibrary, pack
from packit_sim.core.choices import Door
from packit_sim.core.confidence import Estimate
from packit_sim.parts import check

FILE = "deliveries.json"

BLOCK = "deliveries"
"""Between these comments the page has the table."""

SHAPES, COPIES, VOLUME = 10, 2, 0.6
"""Shapes of a set, copies of each, and the volume of all relative to the box's."""

DOORS: tuple[Door, ...] = ("x+", "y-", "x-", "y+")

CLEARANCE_MM = 1.0

STEP_MM = 2.0
"""Length of a step on the way out: less than the thickness of most parts."""

DRAWN_IN = 0.999
"""Scale of a part that moves: exact sweeps let parts touch."""

PASSES = 100, 5
"""Passes of a search without stops, and of each of the four or more searches for a stop."""


def parts_of_set(seed: int) -> list[Part]:
    """Return the parts of a set, with their stops."""
    task = selection(ShapeLibrary.open(LIBRARY), seed, (100, 100, 100), SHAPES, VOLUME)
    stops = 2 + seed % 3
    parts = []
    for n, each in enumerate(parts_of(task)):
        each.mesh.apply_scale(COPIES ** (-1 / 3))
        parts.append(replace(each, count=COPIES, stop=1 + n % stops))
    return parts


def violations(packed: PackedParts, door: Door) -> list[str]:
    """Return what is wrong with the order of unloading, the reverse of that of the placements."""
    return [fault for box in range(len(packed.packings)) for fault in _unloaded(packed, box, door)]


def _unloaded(packed: PackedParts, box: int, door: Door) -> Iterator[str]:
    axis, sign = "xyz".index(door[0]), 1 if door[1] == "+" else -1
    placements = packed.packings[box].placements
    inside = [_posed(packed, box, n) for n in range(len(placements))]
    bodies = [_body(mesh) for mesh in inside]
    side = packed.packings[box].container.size[axis]
    last = 0
    for n in reversed(range(len(inside))):
        part = packed.part(placements[n]).part
        if (part.stop or 0) < last:
            yield f"{part.name} is for stop {part.stop}, but leaves after one for stop {last}"
        last = max(last, part.stop or 0)
        low, high = inside[n].bounds
        across = [d for d in range(3) if d != axis]
        near = [
            m
            for m in range(n)
            if (inside[m].bounds[0] < high)[across].all()
            and (inside[m].bounds[1] > low)[across].all()
        ]
        reach = side - low[axis] if sign > 0 else high[axis]
        met = _met(_body(_drawn_in(inside[n])), [bodies[m] for m in near], axis, sign, reach)
        if met:
            yield f"{part.name} for stop {part.stop} meets another part on its way out"


def _met(
    body: fcl.CollisionObject,
    others: Sequence[fcl.CollisionObject],
    axis: int,
    sign: int,
    reach: float,
) -> bool:
    """Return whether a body meets others on its way out."""
    for distance in np.arange(0.0, reach + STEP_MM, STEP_MM):
        body.setTranslation(np.eye(3)[axis] * sign * distance)
        if any(fcl.collide(body, other) for other in others):
            return True
    return False


def _posed(packed: PackedParts, box: int, number: int) -> Trimesh:
    placement = packed.packings[box].placements[number]
    mesh = packed.part(placement).part.mesh.copy()
    return mesh.apply_transform(packed.pose(placement))


def _drawn_in(mesh: Trimesh) -> Trimesh:
    middle = mesh.bounds.mean(axis=0)
    return Trimesh(middle + (mesh.vertices - middle) * DRAWN_IN, mesh.faces, process=False)


def _body(mesh: Trimesh) -> fcl.CollisionObject:
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(mesh.vertices, mesh.faces)
    model.endModel()
    return fcl.CollisionObject(model)


def measure(seed: int) -> dict[str, Any]:
    """Pack a set with and without the order.

    Returns
    -------
    dict
        The door and the stops; the density, the number of parts and the core-seconds of each; the
        violations and problems of the packing with the order, and how many parts of the other one
        can't leave in the order of their stops.
    """
    parts, door = parts_of_set(seed), DOORS[seed % len(DOORS)]
    found: dict[str, Any] = {"door": door, "stops": max(part.stop or 0 for part in parts)}
    for name, passes in zip(("any order", "delivery"), PASSES, strict=True):
        settings = PackSettings(CLEARANCE_MM, workers=1, iterations=passes)
        if name == "delivery":
            settings = replace(settings, door=door, order="delivery")
        start = time.process_time()
        packed = pack(parts, (UNIT_MM,) * 3, seed=seed, settings=settings)
        spent = time.process_time() - start
        found[name] = {
            "density": round(packed.density, 4),
            "parts": packed.count,
            "core-seconds": round(spent, 1),
            "violations": len(violations(_by_stops(packed), door)),
            "problems": len(check(packed).problems),
        }
    return found


def _by_stops(packed: PackedParts) -> PackedParts:
    """Return a packing with the parts of the last stop first, those of a stop as they were."""
    packings = [
        replace(
            packing,
            placements=tuple(
                sorted(packing.placements, key=lambda one: -(packed.part(one).part.stop or 0))
            ),
        )
        for packing in packed.packings
    ]
    return replace(packed, packings=tuple(packings))


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the page."""
    rows = []
    for stops in (2, 3, 4, 0):
        own = [each for each in results if stops in (0, each["stops"])]
        if not own:
            continue
        plain, ordered = ([each[name] for each in own] for name in ("any order", "delivery"))
        ratios = [b["density"] / a["density"] for a, b in zip(plain, ordered, strict=True)]
        rows.append(
            (
                stops or "all",
                len(own),
                *(
                    f"{Estimate.of([e['density'] for e in two]).mean:.3f}"
                    for two in (plain, ordered)
                ),
                f"{Estimate.of(ratios).mean:.2f} ({min(ratios):.2f} to {max(ratios):.2f})",
                *(sum(each["violations"] for each in two) for two in (plain, ordered)),
                sum(each["problems"] for each in ordered),
            )
        )
    head = (
        *("stops", "sets", "density in any order", "by stops", "ratio (range)"),
        *("parts in the way, any order", "by stops", "problems"),
    )
    return markdown_table(head, rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--table", action="store_true", help="only write the table")
    arguments = parser.parse_args()
    file = arguments.out / FILE
    content = json.loads(file.read_text()) if file.exists() else {"results": []}
    results: list[dict[str, Any]] = content["results"]
    done = {each["set"] for each in results}
    for seed in range(0 if arguments.table else arguments.sets):
        if seed not in done:
            found = measure(seed)
            print(seed, found, flush=True)
            results.append({"set": seed, **found})
            write_json(file, {**machine(), "passes": PASSES, "results": results})
    write_into_page(PAGE, table(results), BLOCK)


if __name__ == "__main__":
    main()
