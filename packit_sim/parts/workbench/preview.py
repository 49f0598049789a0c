"""The parts of an order next to its box, before they are packed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any

import numpy as np
import trimesh

from packit_sim.core.length_units import Unit
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.parts.packings.outlines import outline
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results.pictures import shown
from packit_sim.render.coloring import PALETTE
from packit_sim.web.page_models import Models

MAX_COPIES = 100
"""Most parts that are shown, the first ones."""

_GAP = 0.05
"""Distance of the parts from the box and from each other, as a share of its longest side."""


def upright_shape(part: Part) -> Shape:
    """Return the shape of a part's mesh, z up."""
    vertices = part.user_from_file.direction(np.asarray(part.mesh.vertices, dtype=float))
    return Shape.repaired(trimesh.Trimesh(vertices, part.mesh.faces, process=False), part.name)[0]


def preview(box: BoxType, unit: Unit, ordered: Sequence[tuple[Part, Shape, int]]) -> dict[str, Any]:
    """Return a box with parts in front of it in JSON's types, as the page shows packings.

    Parameters
    ----------
    unit : str
        The unit of the box.
    ordered : sequence of (Part, Shape, int)
        The parts, their upright shapes, and how many of each.

    Returns
    -------
    dict[str, Any]
        "models" of `Models`; "parts", the name of each item; "reach", the sides (3,) of a box that
        holds everything, in box units.
    """
    container = box.container
    cells = shown(Packing((), container, (), objective="knapsack")).cells
    reach = np.array(cells) * CELL
    gap, scale = _GAP * reach.max(), reach.max() / container.longest
    width, place = max(reach[:2]), np.array([0.0, reach[1] + gap, 0.0])
    items, names, colors = [], [], []
    copies = ((n, each) for n, each in enumerate(ordered) for _ in range(each[2]))
    for n, (part, shape, _) in islice(copies, MAX_COPIES):
        vertices = np.asarray(part.mesh.vertices)[np.unique(part.mesh.faces)]
        sides = np.abs(part.user_from_file.direction(np.ptp(vertices, axis=0)))
        sides *= part.scale(unit) * scale
        if place[0] > 0 and place[0] + sides[0] > width:  # the next row
            place = np.array([0.0, reach[1] + gap, 0.0])
        item = Item(shape, float(np.linalg.norm(sides)) ** 3)
        items.append(PosedItem.at(item, Motion.shift(place + sides / 2)))
        names.append(part.name)
        colors.append(PALETTE[n % len(PALETTE)])
        reach = np.maximum(reach, place + sides)
        place[0] += sides[0] + gap
    models = Models()
    lines = outline(container) * scale
    models.add(cells, items, plain_sum(one.item.volume for one in items) or 1.0, colors, lines)
    return {"models": models.to_json(), "parts": names, "reach": reach.tolist()}
