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

import json
import math
import time
from collections.abc import Mapping, Sequence
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
    machine,
    markdown_table,
    write_into_page,
    write_json,
)
from packit_sim import ItemType, MeshContainer, PackedParts, PackSettings, Part, pack
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.parts import check
from packit_sim.parts.results.pictures import draw

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

PICTURED = "estate"
"""The trunk of which a packing is drawn."""


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
    leans = [(x, lean * z / top, z) for x, z in side]
    corners = [(x, y, z) for x, inwards, z in leans for y in (inwards, width - inwards)]
    arches = tuple(Arch(wheel, -61, 286, *ends) for ends in ((-50, 137), (width - 137, width + 50)))
    return Trunk(name, tuple(corners), arches)


def grid_count(trunk: Trunk) -> int:
    """Return the most bricks of one lattice, of all orientations and offsets."""
    best = 0
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
        best = max(best, int(counts.max()))
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
    """Measure how deep a brick reaches into another, a wall or an arch.

    Parameters
    ----------
    poses : sequence of ndarray of float64, shape (4, 4)
        From a brick around the origin to the trunk.

    Returns
    -------
    float
        The largest depth in mm; 0 if there is none.
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
    container = MeshContainer(shell, name=trunk.name)
    settings = PackSettings(workers=workers)
    return pack([bricks], container, "count", seconds, settings=settings)


def measured(trunk: Trunk, rotations: str, seconds: float, workers: int) -> dict[str, Any]:
    """Pack a trunk and check it; of the last trunk, also draw the packing."""
    spent = time.process_time()
    packed = packed_trunk(trunk, rotations, seconds, workers)
    spent = time.process_time() - spent
    low = np.min(trunk.corners, axis=0)
    poses = [packed.pose(one) for one in packed.packings[0].placements]
    if trunk.name == PICTURED and rotations == SETS[-1]:
        draw(packed.packings[0], PICTURES / "benchmark-litres.png")
    return {
        "trunk": trunk.name,
        "volume": trunk.mesh.volume / 1e6,
        "rotations": rotations,
        "litres": packed.count,
        "turned": sum(not np.isin(np.abs(p[:3, :3]).round(6), (0, 1)).all() for p in poses),
        "deepest": round(deepest(trunk, [Motion.shift(low).matrix @ pose for pose in poses]), 4),
        "problems": len(check(packed).problems),
        "processor seconds": round(spent, 1),
    }


def table(content: Mapping[str, Any]) -> str:
    """Return the table of the page."""
    rows = []
    found = {(each["trunk"], each["rotations"]): each for each in content["results"]}
    for name, grid in content["grids"].items():
        own = [found[name, rotations] for rotations in SETS]
        shares = [f"{each['litres']} ({100 * each['litres'] / grid:.1f}%)" for each in own]
        rows.append(
            (
                name,
                f"{own[0]['volume']:.0f}",
                grid,
                *shares,
                own[-1]["turned"],
                f"{max(each['deepest'] for each in own):.2f} mm",
                sum(each["problems"] for each in own),
            )
        )
    head = ("trunk", "volume in litres", "grid", "24 rotations", "free", "bricks at other angles")
    return markdown_table((*head, "deepest overlap", "problems"), rows)


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each packing")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--table", action="store_true", help="only write the table")
    arguments = parser.parse_args()
    file = arguments.out / FILE
    content = json.loads(file.read_text()) if file.exists() else {"results": []}
    done = {(each["trunk"], each["rotations"]) for each in content["results"]}
    for trunk, rotations in () if arguments.table else product(trunks(), SETS):
        if (trunk.name, rotations) not in done:
            found = measured(trunk, rotations, arguments.seconds, arguments.workers)
            print(found, flush=True)
            content["results"].append(found)
            content["grids"] = {each.name: grid_count(each) for each in trunks()}
            about = {"seconds": arguments.seconds, "workers": arguments.workers}
            write_json(file, {**machine(), **content, **about})
    write_into_page(PAGE, table(content), "litres")


if __name__ == "__main__":
    main()
