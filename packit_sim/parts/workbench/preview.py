"""The parts of an order next to its box, before they are packed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any

import numpy as np
import trimesh

from packit_sim.core.length_units import Unit
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.parts.packings.outlines import outline
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.boxes import BoxType
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results.pictures import shown
from packit_sim.parts.workbench.scenes import Kind, kind_color
from packit_sim.render.coloring import UNKNOWN_COLOR
from packit_sim.web.page_models import Models

MAX_COPIES = 100
"""Most parts that are shown, the first ones."""

_GAP = 0.05
"""Distance of the parts from the box and from each other, as a share of its longest side."""


def upright_shape(part: Part) -> Shape:
    """Return the shape of a part's mesh, z up."""
    vertices = part.user_from_file.direction(np.asarray(part.mesh.vertices, dtype=float))
    return Shape.repaired(trimesh.Trimesh(vertices, part.mesh.faces, process=False), part.name)[0]


def preview(
    box: BoxType,
    unit: Unit,
    ordered: Sequence[tuple[Part, Shape]],
    in_place: Sequence[tuple[Part, Shape]] = (),
) -> dict[str, Any]:
    """Return a box with parts in front of it in JSON's types, as the page shows packings.

    Parameters
    ----------
    unit : str
        The unit of the box.
    ordered : sequence of (Part, Shape)
        The parts, and their upright shapes.
    in_place : sequence of (Part, Shape)
        The same of what is in the box already.

    Returns
    -------
    dict[str, Any]
        "models", "boxes" and "kinds" as of `box_scenes`; "reach", the sides (3,) of a box that
        holds everything, in box units.
    """
    container = box.container
    cells = shown(Packing((), container, (), objective="knapsack")).cells
    reach = np.array(cells) * CELL
    gap, scale = _GAP * reach.max(), reach.max() / container.longest
    width, place = max(reach[:2]), np.array([0.0, reach[1] + gap, 0.0])
    items, kinds = [], []
    copies = ((n, *each) for n, each in enumerate(ordered) for _ in range(each[0].count))
    for n, part, shape in islice(copies, MAX_COPIES):
        low, high = _corners(part, part.scale(unit) * scale)
        sides = high - low
        if place[0] > 0 and place[0] + sides[0] > width:  # the next row
            place = np.array([0.0, reach[1] + gap, 0.0])
        items.append(_item(shape, sides, place + sides / 2))
        kinds.append(n)
        reach = np.maximum(reach, place + sides)
        place[0] += sides[0] + gap
    colors = [kind_color(n) for n in kinds] + [UNKNOWN_COLOR] * len(in_place)
    for part, shape in in_place:
        low, high = _corners(part, part.scale(unit) * scale)
        items.append(_item(shape, high - low, (low + high) / 2))
    models = Models()
    lines = outline(container) * scale
    models.add(cells, items, plain_sum(one.item.volume for one in items) or 1.0, colors, lines)
    shown_box = {
        "name": container.name,
        "parts": [ordered[n][0].name for n in kinds],
        "kinds": kinds,
        "others": [part.name for part, _ in in_place],
        "sides": list(container.size),
    }
    legend = [Kind(n, part.name, part.count).to_json() for n, (part, _) in enumerate(ordered)]
    return {
        "models": models.to_json(),
        "boxes": [shown_box],
        "kinds": legend,
        "reach": reach.tolist(),
    }


def _corners(part: Part, scale: float) -> tuple[Floats, Floats]:
    """Return the lowest and the highest corner of a part in box units."""
    vertices = np.asarray(part.mesh.vertices, dtype=float)[np.unique(part.mesh.faces)]
    turned = part.user_from_file.direction(vertices) * scale
    return turned.min(axis=0), turned.max(axis=0)


def _item(shape: Shape, sides: Floats, middle: Floats) -> PosedItem:
    return PosedItem.at(Item(shape, float(np.linalg.norm(sides)) ** 3), Motion.shift(middle))
