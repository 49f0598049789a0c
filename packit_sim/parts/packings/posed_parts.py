"""The parts of a packing as items of the engine: for pictures and for physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from packit_sim.geometry.items import BoxState, PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.simplification import reduced, triangle_limit
from packit_sim.parts.packings.outlines import outline_body
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement

MAX_TRIANGLES = 2**18
"""Maximum number of triangles of all shapes of a box that is shown: EGL can draw twice as many."""


def posed(packing: Packing, side: float = 1.0) -> list[PosedItem]:
    """Return the parts of a packing where they are, as items of the engine.

    Parameters
    ----------
    side : float, default: 1.0
        The container's longest side that is not infinite, in box units.

    Returns
    -------
    list of PosedItem
        An item for each placement; equal types share their shapes.
    """
    scale = side / packing.container.longest
    found = []
    for placement in packing.placements:
        item_type = packing.types[placement.type]
        diagonal = float(np.linalg.norm(item_type.extents))
        box_from_item = placement.pose.at(placement.apply(item_type.middle) * scale)
        size = diagonal * scale * placement.scale
        found.append(PosedItem(Item(item_type.shape, size**3), box_from_item.scaled(size)))
    return found


def contents(packing: Packing, numbers: Sequence[int], side: float = 4.0) -> BoxState[PosedItem]:
    """Return a box with some of the parts of a packing, to be shown.

    Parameters
    ----------
    numbers : sequence of int
        The numbers of the placements.
    side : float, default: 4.0
        The box's longest side that is not infinite, in box units: the more, the less its sides
        are rounded.

    Returns
    -------
    BoxState
        The box, and the parts in this order. A strip is as high as its highest part. Shapes are
        reduced if they have more than `MAX_TRIANGLES` together.
    """
    unit = CELL * packing.container.longest / side
    a, b, c = (max(1, round(one / unit)) for one in packing.sides)
    items = posed(packing, side)
    found = [items[n] for n in numbers]
    shapes = {one.item.shape for one in found}
    limit = triangle_limit([len(each.mesh.faces) for each in shapes], MAX_TRIANGLES)
    return BoxState((a, b, c), tuple(_reduced(one, limit) for one in found))


def outline_items(packing: Packing, side: float = 4.0) -> tuple[PosedItem, ...]:
    """Return the lines of a packing's container as an item for pictures; none for a box.

    Parameters
    ----------
    side : float, default: 4.0
        The container's longest side, in box units.

    Returns
    -------
    tuple of PosedItem
        At most one.
    """
    lines = outline_body(packing.container)
    if lines is None:
        return ()
    alone = replace(packing, types=(lines,), placements=(Placement(0),), containers=())
    return tuple(posed(alone, side))


def _reduced(one: PosedItem, triangles: int) -> PosedItem:
    item = Item(reduced(one.item.shape, triangles), one.item.scale)
    return one if item.shape is one.item.shape else replace(one, item=item)
