"""Parts for tests of constraints, in millimetres, and packings of them in a box of 100 mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh
from trimesh import creation

from packit_sim.geometry.arrays import Floats
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement

BOX = BoxContainer((100, 100, 100))


def cuboid(low: Sequence[float], high: Sequence[float]) -> trimesh.Trimesh:
    return creation.box(bounds=np.array((low, high), dtype=float))


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    found = trimesh.util.concatenate(list(meshes))
    assert isinstance(found, trimesh.Trimesh)
    return found


def moved(mesh: trimesh.Trimesh, x: float, y: float, z: float) -> trimesh.Trimesh:
    return mesh.copy().apply_translation((x, y, z))


def turned(axis: Sequence[float], angle: float) -> Floats:
    return np.asarray(trimesh.transformations.rotation_matrix(angle, axis)[:3, :3])


def bowl(radius: float = 30, height: float = 25) -> trimesh.Trimesh:
    """A cone without a point, open at the top, 3 mm thick along z."""
    outline = [(0, 0), (radius / 3, 0), (radius, height - 3), (radius, height)]
    outline += [(radius / 3, 3), (0, 3)]
    return creation.revolve(np.array(outline, dtype=float), sections=24)


def table() -> trimesh.Trimesh:
    """60 x 60 mm, 40 mm high, on four legs."""
    legs = [cuboid((x, y, 0), (x + 6, y + 6, 36)) for x in (0, 54) for y in (0, 54)]
    return joined(*legs, cuboid((0, 0, 36), (60, 60, 40)))


def u_profile() -> trimesh.Trimesh:
    """Lies around `BAR`: a floor, a back at low x, and a roof; open towards +x."""
    return joined(
        cuboid((10, 30, 20), (60, 50, 25)),
        cuboid((10, 30, 25), (15, 50, 45)),
        cuboid((10, 30, 45), (60, 50, 50)),
    )


BAR = joined(
    cuboid((40, 5, 30), (50, 95, 40)),
    cuboid((40, 5, 0), (50, 10, 30)),
    cuboid((40, 90, 0), (50, 95, 30)),
)
"""A bar along y on two feet, through `u_profile`."""


def _cage() -> trimesh.Trimesh:
    """The edges of a cube from 30 to 70, and a cross on each face."""
    bars = []
    for axis in range(3):
        for a in (30.0, 48.0, 66.0):
            for b in (30.0, 48.0, 66.0):
                if a == b == 48:
                    continue
                low, high = np.full(3, 30.0), np.full(3, 70.0)
                low[(axis + 1) % 3], high[(axis + 1) % 3] = a, a + 4
                low[(axis + 2) % 3], high[(axis + 2) % 3] = b, b + 4
                bars.append(cuboid(low.tolist(), high.tolist()))
    return joined(*bars)


CAGE = _cage()


def packed(*meshes: trimesh.Trimesh, names: Sequence[str] = (), **settings: Any) -> Packing:
    """Each mesh where it is, as a part of its own type."""
    types = tuple(
        ItemType(names[n] if names else f"part{n}", mesh.vertices, mesh.faces)
        for n, mesh in enumerate(meshes)
    )
    places = tuple(Placement(n) for n in range(len(meshes)))
    return Packing(types, BOX, places, objective="knapsack", **settings)
