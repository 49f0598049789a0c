"""Two items relative to each other: the arguments of all tests of their surfaces."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.items import ItemInBox, PlacedItem
from packit_sim.geometry.lattice import CELL, STEP, Triple
from packit_sim.geometry.shapes import Item


class Pair(NamedTuple):
    """Two items; the first one's centre is the origin.

    Attributes
    ----------
    item : Item
        The first item. If it is off the grid, in the canonical rotation: then shift and loose turn
        are in its own frame.
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
    def of(cls, placed: ItemInBox, other: ItemInBox) -> Pair:
        """Compute the pair of two items, each on the grid or off it."""
        if not isinstance(placed, PlacedItem):
            back = placed.pose.rotation.T
            shift, turn = back @ (other.center - placed.center), back @ other.pose.rotation
            return cls(placed.item.turned(0), other.item, shift, np.ascontiguousarray(turn))
        if isinstance(other, PlacedItem):
            return cls.at_offset(*canonical(placed, other))
        shift = other.center - placed.center
        return cls(placed.item, other.item, shift, np.ascontiguousarray(other.pose.rotation))

    @classmethod
    def at_offset(cls, a: Item, b: Item, offset: Triple) -> Pair:
        """Compute the pair of two items whose cell boxes are an offset of grid steps apart."""
        return cls(a, b, shifts_at(a, b, np.array(offset)), None)

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


def canonical_offsets(item: Item, locations: Ints, other: PlacedItem) -> tuple[Item, Item, Ints]:
    """Put two items in the same order as `canonical`, for many locations of the first.

    Parameters
    ----------
    item : Item
        An item, in its rotation.
    locations : ndarray of int64, shape (n, 3)
        Its locations.
    other : PlacedItem
        Another item.

    Returns
    -------
    a, b : Item
        The two items.
    offsets : ndarray of int64, shape (n, 3)
        The second's offsets from the first, in grid steps.
    """
    offsets = np.array(other.location) - locations
    if other.item.key < item.key:
        return other.item, item, -offsets
    if other.item.key == item.key:
        x, y, z = offsets.T
        is_first = (x > 0) | (x == 0) & ((y > 0) | (y == 0) & (z >= 0))
        offsets = np.where(is_first[:, None], offsets, -offsets)
    return item, other.item, offsets


def shifts_at(a: Item, b: Item, offsets: Ints) -> Floats:
    """Compute the shifts (..., 3) of a `Pair` whose cell boxes are offsets (..., 3) apart."""
    half_cells = 2 * STEP * offsets + np.subtract(b.cells, a.cells)
    return np.asarray(half_cells * (CELL / 2), dtype=np.float64)


@cache
def matrix(rotation: int) -> Floats:
    """Look up the matrix (3, 3) of a rotation."""
    return rotations.MATRICES[rotation].astype(float)


@cache
def relative_turn(rotation: int, other: int) -> tuple[Ints, Floats]:
    """Compute the second rotation as seen from the first.

    Parameters
    ----------
    rotation : int
        One of the 24 rotations.
    other : int
        Another one.

    Returns
    -------
    turn : ndarray of int64, shape (2, 3)
        The turn, as in `crossing_kernels.relation`.
    to_first : ndarray of float64, shape (3, 3)
        The inverse of the first rotation.
    """
    to_first = rotations.MATRICES[rotation].T
    turn = to_first @ rotations.MATRICES[other]
    return np.stack((np.abs(turn).argmax(axis=1), turn.sum(axis=1))), to_first.astype(float)
