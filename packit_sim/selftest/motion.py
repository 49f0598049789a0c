"""The kinematic rule by brute force: items move out of the box in small steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELL, CONTACT_TOLERANCE, FINE, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import LooseMesh


class Paths:
    """Straight moves of an item up from locations of a box.

    Parameters
    ----------
    cells : Triple
        The cells of the box along x, y and z.
    placed : sequence of PlacedItem
        The items in the box.
    item : Item
        The item to lift.
    """

    def __init__(self, cells: Triple, placed: Sequence[PlacedItem], item: Item) -> None:
        self._height = cells[2] * CELL
        self._placed = placed
        self._item = item
        self._mesh = _shrunk(item, np.zeros(3))
        self._meshes = [_shrunk(other.item, other.center) for other in placed]

    def is_blocked(self, location: Triple) -> bool:
        """Decide whether the meshes cross at one of the steps, each a fine cell long."""
        start = PlacedItem(self._item, location).center
        half = self._item.extents / 2
        for other, mesh in zip(self._placed, self._meshes, strict=True):
            reach = half + other.item.extents / 2
            if (np.abs(start - other.center)[:2] >= reach[:2]).any():
                continue
            above = other.center[2] - start[2]
            first, last = max(0.0, above - reach[2]), min(above + reach[2], self._height)
            for rise in np.arange(first, last, FINE):
                if mesh.crosses(self._mesh, start + np.array((0, 0, rise))):
                    return True
        return False


def _shrunk(item: Item, center: Floats) -> LooseMesh:
    """Create an item's mesh, half the contact tolerance shorter on each side."""
    factor = np.maximum(item.extents - CONTACT_TOLERANCE, 0) / item.extents
    return LooseMesh(item.mesh.vertices * factor + center, np.asarray(item.shape.mesh.faces))
