"""Items somewhere in a box: on the grid, or anywhere in any rotation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from packit_sim.core.caches import cached_property
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import CELL, STEP, Triple
from packit_sim.geometry.motions import Motion, affine, split
from packit_sim.geometry.shapes import Item


class ItemInBox(Protocol):
    """An item somewhere in a box.

    Attributes
    ----------
    item : Item
        The item. An item off the grid keeps the rotation in which it was placed.
    center : ndarray of float64, shape (3,)
        Centre of its shape's bounding box, in box units.
    matrix : ndarray of float64, shape (4, 4)
        The shape-to-box matrix: maps the canonical mesh, `item.shape.mesh`, into the box.
    pose : Motion
        The same without the item's scale, `box_from_item`.
    linear : ndarray of float64, shape (3, 3)
        The linear part of that matrix: the item's scale and a rotation.
    vertices : ndarray of float64, shape (n, 3)
        The vertices of its mesh, in box units.
    bounds : ndarray of float64, shape (2, 3)
        Their smallest and largest coordinates.
    counts : bool
        Whether its volume counts for the box's density: items that settled count while they are
        inside the box and stable, all others always.
    """

    @property
    def item(self) -> Item: ...
    @property
    def center(self) -> Floats: ...
    @property
    def matrix(self) -> Floats: ...
    @property
    def linear(self) -> Floats: ...
    @property
    def pose(self) -> Motion: ...
    @property
    def vertices(self) -> Floats: ...
    @property
    def bounds(self) -> Floats: ...
    @property
    def counts(self) -> bool: ...


ItemT = TypeVar("ItemT")
"""A type of items in a box, an `ItemInBox`."""

_ItemT_co = TypeVar("_ItemT_co", covariant=True)


class Contents(Protocol[_ItemT_co]):
    """The contents of a box.

    Attributes
    ----------
    cells : Triple
        The cells of the box along x, y and z.
    placed : sequence of ItemInBox
        The items, in the order of placing.
    """

    @property
    def cells(self) -> Triple: ...
    @property
    def placed(self) -> Sequence[_ItemT_co]: ...


@dataclass(frozen=True)
class BoxState(Generic[ItemT]):
    """The whole state of a box, as a value.

    Attributes
    ----------
    cells : Triple
        The cells of the box along x, y and z.
    placed : tuple of ItemInBox
        The items, in the order of placing.
    """

    cells: Triple
    placed: tuple[ItemT, ...]


@dataclass(frozen=True)
class PlacedItem:
    """An item at a location of the grid.

    Attributes
    ----------
    item : Item
        The item, in its rotation.
    location : Triple
        The grid node (i, j, k) at which the min corner of its cell box is.
    """

    item: Item
    location: Triple

    @property
    def start(self) -> Triple:
        """The min corner of the cell box, in cells."""
        i, j, k = self.location
        return i * STEP, j * STEP, k * STEP

    @property
    def stop(self) -> Triple:
        """The max corner of the cell box, in cells."""
        (x, y, z), (a, b, c) = self.start, self.item.cells
        return x + a, y + b, z + c

    @cached_property
    def center(self) -> Floats:
        """Centre of the item's bounding box, (3,) in box units."""
        return (np.array(self.start) + np.array(self.stop)) / 2 * CELL

    @cached_property
    def matrix(self) -> Floats:
        """Shape-to-box matrix (4, 4): maps the canonical mesh, `item.shape.mesh`, into the box."""
        return affine(self.item.linear, self.center)

    @property
    def linear(self) -> Floats:
        """The linear part (3, 3) of that matrix."""
        return split(self.matrix)[0]

    @property
    def pose(self) -> Motion:
        """The shape-to-box matrix without the item's scale."""
        return Motion.turn(self.item.rotation, self.center)

    @property
    def vertices(self) -> Floats:
        """Vertices of the item's mesh, (n, 3) in box units."""
        return np.asarray(self.item.mesh.vertices + self.center)

    @property
    def bounds(self) -> Floats:
        """Smallest and largest coordinates of its vertices, (2, 3) in box units."""
        return _bounds(self.vertices)

    @property
    def counts(self) -> bool:
        """True: its volume counts for the box's density."""
        return True


@dataclass(frozen=True, eq=False)
class PosedItem:
    """An item anywhere, in any rotation.

    Attributes
    ----------
    item : Item
        The item, in the rotation in which it was placed.
    matrix : ndarray of float64, shape (4, 4)
        The shape-to-box matrix: the item's scale, a rotation and a translation.
    """

    item: Item
    matrix: Floats

    @classmethod
    def of(cls, placed: PlacedItem) -> PosedItem:
        """Convert an item on the grid to one off the grid, at the same place."""
        return cls(placed.item, placed.matrix)

    @classmethod
    def at(cls, item: Item, box_from_item: Motion) -> PosedItem:
        """Put an item anywhere, in any rotation."""
        return cls(item, box_from_item.scaled(np.cbrt(item.scale)))

    def moved(self, motion: Motion) -> PosedItem:
        """Return the item after a motion."""
        return PosedItem(self.item, motion.matrix @ self.matrix)

    @property
    def center(self) -> Floats:
        """Centre of the shape's bounding box, (3,) in box units."""
        return split(self.matrix)[1]

    @property
    def linear(self) -> Floats:
        """The linear part (3, 3) of the shape-to-box matrix."""
        return split(self.matrix)[0]

    @cached_property
    def pose(self) -> Motion:
        """The shape-to-box matrix without the item's scale."""
        return Motion.from_matrix(self.matrix, np.cbrt(self.item.scale))

    @cached_property
    def vertices(self) -> Floats:
        """Vertices of the item's mesh, (n, 3) in box units."""
        return np.asarray(self.item.shape.mesh.vertices @ self.linear.T + self.center)

    @cached_property
    def bounds(self) -> Floats:
        """Smallest and largest coordinates of its vertices, (2, 3) in box units."""
        return _bounds(self.vertices)

    @property
    def counts(self) -> bool:
        """True: its volume counts for the box's density."""
        return True

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PosedItem):
            return NotImplemented
        return self.item == other.item and np.array_equal(self.matrix, other.matrix)

    def __hash__(self) -> int:
        return hash((self.item, self.matrix.tobytes()))


class AtPose:
    """Base of items that have moved, and are where their posed item is.

    Attributes
    ----------
    posed : PosedItem
        The item where it is.
    """

    posed: PosedItem

    @property
    def center(self) -> Floats:
        """Centre of its shape's bounding box, (3,) in box units."""
        return self.posed.center

    @property
    def matrix(self) -> Floats:
        """Shape-to-box matrix (4, 4)."""
        return self.posed.matrix

    @property
    def linear(self) -> Floats:
        """Linear part (3, 3) of that matrix."""
        return self.posed.linear

    @property
    def pose(self) -> Motion:
        """Shape-to-box matrix without the item's scale."""
        return self.posed.pose

    @property
    def vertices(self) -> Floats:
        """Vertices of its mesh, (n, 3) in box units."""
        return self.posed.vertices

    @property
    def bounds(self) -> Floats:
        """Smallest and largest coordinates of its vertices, (2, 3) in box units."""
        return self.posed.bounds


def triangles(placed: ItemInBox) -> Floats:
    """Compute the corners of the triangles of an item's mesh, (n, 3, 3) in box units."""
    return placed.vertices[placed.item.shape.mesh.faces]


def _bounds(vertices: Floats) -> Floats:
    return np.array((vertices.min(axis=0), vertices.max(axis=0)))
