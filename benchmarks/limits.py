"""Compare packings within limits with plain ones that happen to keep them.

    .venv/bin/python -m benchmarks.limits --sets 20 --passes 400
    .venv/bin/python -m benchmarks.limits --table

A set has four copies each of eight bodies made by formula, of random sizes and densities, whose
volumes add up to 1.2 times the box's. Twenty plain runs pack it; their median mass and median
number of parts are the limits, one after the other and both. A run within the limits is compared
with the best of the plain runs that keep them, by volume. All runs have the same number of passes,
so that the results are the same on any machine. Writes each set to `benchmarks/results/limits.json`
at once: what has a result is not packed again; --table writes the table of
`docs/benchmarks/parts.md`.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import trimesh
from trimesh import creation

from benchmarks.common import argument_parser, machine, markdown_table, write_into_page, write_json
from benchmarks.packing_parts import PAGE
from packit_sim import BoxType, Limits, PackedParts, PackSettings, Part, pack
from packit_sim.core.confidence import Estimate, format_estimate

FILE = "limits.json"

BLOCK = "limits"
"""Between these comments the page has the table."""

SIDE_MM = 200.0

PLAIN = 20
"""Plain runs of a set."""


def bodies(seed: int) -> list[Part]:
    """Return the parts of a set."""
    rng = np.random.default_rng(seed)
    kinds = (_block, _cylinder, _ball, _cone)
    meshes = [kinds[n % len(kinds)](*rng.uniform(0.5, 1.5, 3)) for n in range(8)]
    factor = (1.2 * SIDE_MM**3 / sum(4 * mesh.volume for mesh in meshes)) ** (1 / 3)
    densities = np.exp(rng.normal(0, 0.7, len(meshes)))
    parts = []
    for n, (mesh, density) in enumerate(zip(meshes, densities, strict=True)):
        mesh.apply_scale(factor)
        parts.append(Part(f"part {n}", mesh, 4, rotations="upright", density=float(density)))
    return parts


def _block(x: float, y: float, z: float) -> trimesh.Trimesh:
    return creation.box((x, y, z))


def _cylinder(x: float, _: float, z: float) -> trimesh.Trimesh:
    return creation.cylinder(x / 2, z, sections=16)


def _ball(x: float, _: float, __: float) -> trimesh.Trimesh:
    return creation.icosphere(1, x / 2)


def _cone(x: float, _: float, z: float) -> trimesh.Trimesh:
    return creation.cone(x / 2, z, sections=16)


def compare(seed: int, passes: int) -> list[dict[str, Any]]:
    """Pack a set with three kinds of limits.

    Returns
    -------
    list of dict of str to object
        For each kind, the volumes and whether the limits are kept.
    """
    parts = bodies(seed)

    def packed(limits: Limits, number: int = 0) -> PackedParts:
        box = BoxType((SIDE_MM,) * 3, limits=limits)
        settings = PackSettings(workers=1, iterations=passes)
        return pack(parts, box, seed=number, settings=settings)

    plain = [packed(Limits(), number) for number in range(PLAIN)]
    mass = statistics.median_low(each.mass or 0.0 for each in plain)
    count = statistics.median_low(each.count for each in plain)
    kinds = {"mass": Limits(mass), "parts": Limits(None, count), "both": Limits(mass, count)}
    found = []
    for kind, limits in kinds.items():
        own = packed(limits)
        masses = [own.part(one).mass for _, one in own.placements]
        keeping = [
            each.volume
            for each in plain
            if not limits.faults([each.part(one).mass for _, one in each.placements])
        ]
        best = max(keeping, default=None)
        found.append(
            {
                "set": seed,
                "kind": kind,
                "limits": limits.text(masses, (0.0, 0.0)),
                "is kept": not limits.faults(masses),
                "volume": own.volume,
                "plain runs": [each.volume for each in plain],
                "plain runs that keep them": len(keeping),
                "best of these": best,
                "ratio": None if best is None else own.volume / best,
            }
        )
    return found


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the page."""
    rows = []
    for kind in [*dict.fromkeys(each["kind"] for each in results), "all"]:
        own = [each for each in results if kind in (each["kind"], "all")]
        ratios = [each["ratio"] for each in own if each["ratio"] is not None]
        plain = [statistics.fmean(each["plain runs"]) / max(each["plain runs"]) for each in own]
        rows.append(
            (
                kind,
                len(own),
                f"{statistics.fmean(each['plain runs that keep them'] for each in own):.1f}",
                f"{statistics.fmean(plain):.3f}",
                format_estimate(Estimate.of(ratios), ".3f"),
                f"{min(ratios):.3f} to {max(ratios):.3f}",
                f"{sum(each >= 0.95 for each in ratios)} of {len(ratios)}",
                sum(not each["is kept"] for each in own),
            )
        )
    head = (
        *("limits on", "runs", "of 20 keep them", "mean of plain runs to their best"),
        *("ratio to the best that keeps them", "range", "at least 0.95", "limits broken"),
    )
    return markdown_table(head, rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--passes", type=int, default=400, help="of each run")
    parser.add_argument("--table", action="store_true", help="only write the table")
    arguments = parser.parse_args()
    file = arguments.out / FILE
    content = json.loads(file.read_text()) if file.exists() else {"results": []}
    results: list[dict[str, Any]] = content["results"]
    if not arguments.table:
        for seed in range(arguments.sets):
            if seed in {each["set"] for each in results}:
                continue
            results += compare(seed, arguments.passes)
            write_json(file, {**machine(), "passes": arguments.passes, "results": results})
            for each in results[-3:]:
                print(seed, each["kind"], each["ratio"], each["is kept"], flush=True)
    write_into_page(PAGE, table(results), BLOCK)


if __name__ == "__main__":
    main()
