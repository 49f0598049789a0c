"""Compare packings within limits with plain ones that happen to keep them.

    .venv/bin/python -m benchmarks.limits --sets 20 --seconds 1

A set has four copies each of eight bodies made by formula, of random sizes and densities, whose
volumes add up to 1.2 times the box's. Twenty plain runs pack it; their median mass and median
number of parts are the limits, one after the other and both. A run within the limits is compared
with the best of the plain runs that keep them, by volume. Writes `benchmarks/results/limits.json`.
"""

from __future__ import annotations

import statistics
from typing import Any

import numpy as np
import trimesh
from trimesh import creation

from benchmarks.common import argument_parser, machine, write_json
from packit_sim import BoxType, Limits, PackedParts, PackSettings, Part, pack

FILE = "limits.json"

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


def compare(seed: int, seconds: float) -> list[dict[str, Any]]:
    """Pack a set with three kinds of limits.

    Returns
    -------
    list of dict of str to object
        For each kind, the volumes and whether the limits are kept.
    """
    parts = bodies(seed)

    def packed(limits: Limits, number: int = 0) -> PackedParts:
        box = BoxType((SIDE_MM,) * 3, limits=limits)
        return pack(parts, box, time=seconds, seed=number, settings=PackSettings(workers=1))

    plain = [packed(Limits(), number) for number in range(PLAIN)]
    mass = statistics.median_low(each.mass or 0.0 for each in plain)
    count = statistics.median_low(each.count for each in plain)
    found = []
    for limits in (Limits(mass), Limits(None, count), Limits(mass, count)):
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
                "limits": limits.text(masses, (0.0, 0.0)),
                "is kept": not limits.faults(masses),
                "volume": own.volume,
                "plain runs that keep them": len(keeping),
                "best of these": best,
                "ratio": None if best is None else own.volume / best,
            }
        )
    return found


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=1.0)
    args = parser.parse_args()
    results: list[dict[str, Any]] = []
    for seed in range(args.sets):
        results += compare(seed, args.seconds)
        write_json(args.out / FILE, machine() | {"seconds": args.seconds, "results": results})
        for each in results[-3:]:
            print(each, flush=True)
    ratios = [each["ratio"] for each in results if each["ratio"] is not None]
    kept = sum(each["is kept"] for each in results)
    print(f"kept: {kept} of {len(results)}, least ratio {min(ratios):.3f}, {len(ratios)} ratios")


if __name__ == "__main__":
    main()
