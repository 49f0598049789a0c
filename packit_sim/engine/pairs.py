"""Two items relative to each other: what the tests of their surfaces depend on."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from packit_sim.engine.items import ItemInBox, PlacedItem
from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import CELL, STEP, Triple
from packit_sim.geometry.shapes import Item


class Pair(NamedTuple):
    """Two items; the first one's centre is the origin.

    Attributes
    ----------
    item : Item
        The first item, on the grid.
    other : Item
        The second item.
    shift : Floats
        (3,) from the centre of the first to that of the second, in box units.
    loose_turn : Floats or None
        (3, 3) the rotation of the second if it is off the grid.
    """

    item: Item
    other: Item
    shift: Floats
    loose_turn: Floats | None

    @classmethod
    def of(cls, placed: PlacedItem, other: ItemInBox) -> Pair:
        """Compute the pair of an item on the grid and one on the grid or off it."""
        if isinstance(other, PlacedItem):
            return cls.at_offset(*canonical(placed, other))
        turn = other.matrix[:3, :3] / np.cbrt(other.item.scale)
        return cls(placed.item, other.item, other.matrix[:3, 3] - placed.center, turn)

    @classmethod
    def at_offset(cls, a: Item, b: Item, offset: Triple) -> Pair:
        """Compute the pair of two items whose cell boxes are an offset of grid steps apart."""
        half_cells = [
            2 * STEP * steps + own - theirs
            for steps, own, theirs in zip(offset, b.cells, a.cells, strict=True)
        ]
        return cls(a, b, np.array(half_cells) * (CELL / 2), None)

    @property
    def turn(self) -> Floats:
        """The rotation of the first, (3, 3)."""
        return matrix(self.item.rotation)

    @property
    def other_turn(self) -> Floats:
        """The rotation of the second, (3, 3)."""
        return matrix(self.other.rotation) if self.loose_turn is None else self.loose_turn


def canonical(a: PlacedItem, b: PlacedItem) -> tuple[Item, Item, Triple]:
    """Put two items in a fixed order; return the second's offset from the first, in grid steps."""
    if (b.item.key, b.location) < (a.item.key, a.location):
        a, b = b, a
    (i, j, k), (u, v, w) = a.location, b.location
    return a.item, b.item, (u - i, v - j, w - k)


@cache
def matrix(rotation: int) -> Floats:
    """Look up the matrix (3, 3) of a rotation."""
    return rotations.MATRICES[rotation].astype(float)
