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
    turn : Floats
        (3, 3) the rotation of the first.
    other_turn : Floats
        (3, 3) the rotation of the second.
    shift : Floats
        (3,) from the centre of the first to that of the second, in box units.
    on_grid : bool
        Whether the second is on the grid as well.
    """

    item: Item
    other: Item
    turn: Floats
    other_turn: Floats
    shift: Floats
    on_grid: bool

    @classmethod
    def of(cls, placed: PlacedItem, other: ItemInBox) -> Pair:
        """Compute the pair of an item on the grid and one on the grid or off it."""
        if isinstance(other, PlacedItem):
            return cls.at_offset(*canonical(placed, other))
        turn = other.matrix[:3, :3] / np.cbrt(other.item.scale)
        shift = other.matrix[:3, 3] - placed.center
        own = matrix(placed.item.rotation)
        return cls(placed.item, other.item, own, turn, shift, on_grid=False)

    @classmethod
    def at_offset(cls, a: Item, b: Item, offset: Triple) -> Pair:
        """Compute the pair of two items whose cell boxes are an offset of grid steps apart."""
        half_cells = [
            2 * STEP * steps + own - theirs
            for steps, own, theirs in zip(offset, b.cells, a.cells, strict=True)
        ]
        shift = np.array(half_cells) * (CELL / 2)
        return cls(a, b, matrix(a.rotation), matrix(b.rotation), shift, on_grid=True)


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
