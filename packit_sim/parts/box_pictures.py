"""Boxes of parts in the units of pictures, viewers and pages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import trimesh

from packit_sim.geometry.lattice import CELL, Triple
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.parts.packing_search import FilledBox
from packit_sim.placement import BoxState, PosedItem
from packit_sim.scene import Scene

if TYPE_CHECKING:
    from packit_sim.parts.packed import PackedParts

_CELLS = range(100, 129)
"""How many cells the longest side may have."""

SIZE = 1200, 900
"""Pixels of a picture."""


def contents(packed: PackedParts, box: FilledBox) -> BoxState[PosedItem]:
    """Return a box as pictures show it.

    Parameters
    ----------
    packed : PackedParts
        The packed parts.
    box : FilledBox
        One of its boxes.

    Returns
    -------
    BoxState
        The collision meshes in box units: the longest side has 100 to 128 cells, so many that the
        others are nearly whole numbers of cells.
    """
    sides = np.array(box.type.size) / max(box.type.size)
    count = min(_CELLS, key=lambda n: float(np.abs(sides * n - np.round(sides * n)).max()))
    x, y, z = (max(1, int(n)) for n in np.round(sides * count))
    cells: Triple = (x, y, z)
    unit = count * CELL / max(box.type.size)
    shapes: dict[int, Shape] = {}
    placed = []
    for one in box.packing.placements:
        own = packed.task.types[one.type]
        if one.type not in shapes:
            mesh = trimesh.Trimesh(own.vertices, own.faces, process=False)
            shapes[one.type] = Shape.from_mesh(mesh, own.name, own.name)
        length = float(np.linalg.norm(own.extents)) * unit
        matrix = np.eye(4)
        matrix[:3, :3] = one.pose[:3, :3] * length
        middle = (own.low + own.high) / 2
        matrix[:3, 3] = (one.pose[:3, :3] @ middle + one.pose[:3, 3]) * unit
        placed.append(PosedItem(Item(shapes[one.type], length**3), matrix))
    return BoxState(cells, tuple(placed))


def draw(packed: PackedParts, box: FilledBox, path: str) -> None:
    """Draw a box and write the picture as PNG."""
    with Scene(contents(packed, box)) as scene:
        scene.snapshot(*SIZE).save(path)
