"""Measure the luggage volume of three trunks in bricks of one litre, as ISO 3832 counts it.

    .venv/bin/python -m benchmarks.litres --seconds 60
    .venv/bin/python -m benchmarks.litres --table

The bricks are 200 x 100 x 50 mm. The trunks are made by formula: a convex shell with a slanted lid,
less two wheel arches. Each is packed with the 24 rotations and with free ones. A grid is next to
that: all bricks parallel, at the points of one lattice of bricks, in the best of the six
orientations and of all offsets by whole steps of 5 mm, each brick decided by the formula. Packings
are checked by separating axes, which share nothing with PackIt-Sim. Writes
`benchmarks/results/litres.json` at once, the table in `docs/benchmarks/parts.md`, and a picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from trimesh import creation

from benchmarks.common import (
    PICTURES,
    argument_parser,
)
from packit_sim import ItemType, MeshContainer, PackedParts, PackSettings, Part, pack
from packit_sim.geometry.arrays import Floats
from packit_sim.parts import check

FILE = "litres.json"

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "parts.md"

BRICK = (200.0, 100.0, 50.0)
"""Sides in mm."""

STEP = 5
"""Offsets of a grid, in mm."""

SECTIONS = 48
"""Corners of a wheel arch."""

SETS = ("cube", "free")
"""Sets of rotations."""


@dataclass(frozen=True)
class Arch:
    """A wheel arch: a cylinder along y.

    Attributes
    ----------
    x, z : float
        Its axis.
    low, high : float
        Where it begins and ends along y.
    """

    x: float
    z: float
    radius: float
    low: float
    high: float

    @property
    def corners(self) -> Floats:
        """The corners (n, 3) of its mesh, a prism."""
        angles = 2 * math.pi * np.arange(SECTIONS) / SECTIONS
        circle = np.column_stack((np.cos(angles), np.sin(angles))) * self.radius + (self.x, self.z)
        ends = (self.low, self.high)
        return np.array([(x, y, z) for y in ends for x, z in circle])


@dataclass(frozen=True)
class Trunk:
    """A trunk: x points to the back of the car, y across it, z up; lengths in mm.

    Attributes
    ----------
    corners : tuple of (float, float, float)
        The corners of its convex shell.
    """

    name: str
    corners: tuple[tuple[float, float, float], ...]
    arches: tuple[Arch, ...]

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The closed surface."""
        shell = trimesh.convex.convex_hull(np.array(self.corners))
        arches = [trimesh.convex.convex_hull(each.corners) for each in self.arches]
        return trimesh.boolean.difference([shell, *arches], engine="manifold")

    @property
    def walls(self) -> tuple[Floats, Floats]:
        """The normals (n, 3) and distances (n,) of the walls of the shell."""
        planes = np.unique(ConvexHull(np.array(self.corners)).equations.round(9), axis=0)
        return planes[:, :3], -planes[:, 3]


def trunks() -> list[Trunk]:
    """Return the trunks."""
    return [
        _trunk("hatchback", [(0, 0), (764, 0), (764, 322), (566, 556), (38, 556)], 1012, 0, 268),
        _trunk("saloon", [(0, 0), (1058, 0), (1058, 351), (887, 464), (94, 464)], 1034, 0, 314),
        _trunk("estate", [(0, 0), (1117, 0), (1117, 297), (823, 663), (52, 663)], 1026, 71, 402),
    ]


def _trunk(
    name: str, side: Sequence[tuple[float, float]], width: float, lean: float, wheel: float
) -> Trunk:
    """Return a trunk by its outline in x and z; its sides lean inwards to the top."""
    top = max(z for _, z in side)
    corners = tuple((x, abs(y - lean * z / top), z) for x, z in side for y in (0.0, width))
    corners = tuple(
        (x, lean * z / top if n % 2 == 0 else width - lean * z / top, z)
        for n, (x, _, z) in enumerate(corners)
    )
    arches = tuple(Arch(wheel, -61, 286, *ends) for ends in ((-50, 137), (width - 137, width + 50)))
    return Trunk(name, corners, arches)


def grid_count(trunk: Trunk) -> tuple[int, tuple[float, ...]]:
    """Return the most bricks of one lattice, and their sides along x, y and z."""
    best: tuple[int, tuple[float, ...]] = (0, BRICK)
    low, high = np.min(trunk.corners, axis=0), np.max(trunk.corners, axis=0)
    for sides in permutations(BRICK):
        axes = [np.arange(a, b - s + 1e-9, STEP) for a, b, s in zip(low, high, sides, strict=True)]
        is_inside = _inside(trunk, axes, np.array(sides))
        steps = [int(side) // STEP for side in sides]
        wide = [-(-n // s) * s for n, s in zip(is_inside.shape, steps, strict=True)]
        padded = np.zeros(wide, bool)
        padded[tuple(map(slice, is_inside.shape))] = is_inside
        split = [n for whole, s in zip(wide, steps, strict=True) for n in (whole // s, s)]
        counts = padded.reshape(split).sum(axis=(0, 2, 4))
        best = max(best, (int(counts.max()), sides))
    return best


def _inside(trunk: Trunk, axes: Sequence[Floats], sides: Floats) -> Any:
    """Return whether bricks with these lower corners are inside: bool [x, y, z]."""
    x, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
    found = np.ones([len(each) for each in axes], bool)
    for normal, distance in zip(*trunk.walls, strict=True):
        far = np.maximum(normal * sides, 0).sum()
        found &= normal[0] * x + normal[1] * y + normal[2] * z + far <= distance + 1e-6
    for arch in trunk.arches:
        dx = np.maximum(np.maximum(x - arch.x, arch.x - x - sides[0]), 0)
        dz = np.maximum(np.maximum(z - arch.z, arch.z - z - sides[2]), 0)
        inner = arch.radius * math.cos(math.pi / SECTIONS)
        is_near = (dx**2 + dz**2 < inner**2 - 1e-6) & (y < arch.high) & (y + sides[1] > arch.low)
        found &= ~is_near
    return found


def deepest(trunk: Trunk, poses: Sequence[Floats]) -> float:
    """Return how deep a brick reaches into another, a wall or an arch, in mm; at least 0.

    Parameters
    ----------
    poses : sequence of ndarray of float64, shape (4, 4)
        From a brick around the origin to the trunk.
    """
    corners = np.array(list(product(*((-s / 2, s / 2) for s in BRICK))))
    bricks = [(pose[:3, :3].T, corners @ pose[:3, :3].T + pose[:3, 3]) for pose in poses]
    normals, distances = trunk.walls
    found = [float((points @ normals.T - distances).max()) for _, points in bricks]
    middles = np.array([points.mean(axis=0) for _, points in bricks])
    reach = np.linalg.norm(BRICK)
    for a, b in combinations(range(len(bricks)), 2):
        if np.linalg.norm(middles[a] - middles[b]) < reach:
            found.append(_overlap(*bricks[a], *bricks[b]))
    for arch in trunk.arches:
        points = arch.corners
        edges = np.diff(points[:SECTIONS], axis=0, append=points[:1])
        sides = np.cross(edges, (0, 1, 0)) / np.linalg.norm(edges, axis=1)[:, None]
        found += [_overlap(*each, np.array((*sides, (0, 1, 0))), points) for each in bricks]
    return max(0.0, *found)


def _overlap(axes: Floats, corners: Floats, others: Floats, points: Floats) -> float:
    """Return the least depth of two convex bodies along face normals and products of edges."""
    crossed = np.cross(axes[:, None], others[None]).reshape(-1, 3)
    lengths = np.linalg.norm(crossed, axis=1)
    crossed = crossed[lengths > 1e-9] / lengths[lengths > 1e-9, None]
    tried = np.concatenate((axes, others, crossed))
    one, other = corners @ tried.T, points @ tried.T
    depths = np.minimum(one.max(axis=0) - other.min(axis=0), other.max(axis=0) - one.min(axis=0))
    return float(depths.min())


def packed_trunk(trunk: Trunk, rotations: str, seconds: float, workers: int) -> PackedParts:
    """Pack as many bricks as fit."""
    mesh = trunk.mesh
    shell = ItemType(trunk.name, mesh.vertices, mesh.faces)
    bricks = Part("brick", creation.box(BRICK), 10_000, rotations=rotations, as_many_as_fit=True)
    settings = PackSettings(workers=workers)
    return pack(
        [bricks], MeshContainer(shell, name=trunk.name), "count", seconds, 0, None, None, settings
    )


def measured(
    trunk: Trunk, rotations: str, seconds: float, workers: int, out: Path
) -> dict[str, Any]:
    """Pack a trunk, check it, and write a picture of it."""
    packed = packed_trunk(trunk, rotations, seconds, workers)
    poses = [packed.pose(one) for one in packed.packings[0].placements]
    low = np.min(trunk.corners, axis=0)
    inside = [np.vstack((np.column_stack((p[:3, :3], p[:3, 3] + low)), p[3])) for p in poses]
    return {
        "trunk": trunk.name,
        "rotations": rotations,
        "litres": packed.count,
        "deepest": round(deepest(trunk, inside), 4),
        "problems": len(check(packed).problems),
    }


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--table", action="store_true", help="only write the table")
    arguments = parser.parse_args()
    for trunk in trunks():
        print(trunk.name, trunk.mesh.volume / 1e6, grid_count(trunk), flush=True)
        for rotations in SETS:
            print(
                measured(trunk, rotations, arguments.seconds, arguments.workers, PICTURES),
                flush=True,
            )


if __name__ == "__main__":
    main()
