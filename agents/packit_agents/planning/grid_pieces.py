"""Items as sets of cubes of a coarse lattice, and how they fill a box completely.

Exact cover needs items that are unions of equal cubes, as cuboids and polycubes are.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELL, STEP, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.rules import Rules

VOLUME_SLACK = 0.01
"""Share of its volume by which an item may differ from its cubes, such as clearances."""

Cubes = npt.NDArray[np.bool_]
"""(a, b, c): the cubes of the lattice that an item fills."""


@dataclass(frozen=True)
class PieceType:
    """Equal pieces.

    Attributes
    ----------
    count : int
        The number of pieces.
    turned : Mapping of Item to Cubes
        Their different orientations: an item in a rotation, and the cubes that it fills.
    """

    count: int
    turned: Mapping[Item, Cubes]

    @property
    def is_cuboid(self) -> bool:
        """True if the piece fills its bounding box."""
        return all(bool(cubes.all()) for cubes in self.turned.values())


@dataclass(frozen=True)
class GridPieces:
    """The pieces of a task on the coarsest lattice that they share with the box.

    Attributes
    ----------
    edge : int
        Cells along a cube.
    box : tuple of int
        Cubes along the box.
    """

    edge: int
    box: Triple
    types: tuple[PieceType, ...]

    @classmethod
    def of(cls, items: Sequence[Item], cells: Triple, rules: Rules) -> GridPieces:
        """Find the lattice.

        Parameters
        ----------
        cells : tuple of int
            Cells of the box.
        rules : Rules
            The rules, whose rotations are allowed.

        Returns
        -------
        GridPieces
            The pieces.

        Raises
        ------
        ArgumentError
            If an item is no union of cubes on the grid, or the items don't fill the box.
        """
        for edge in _edges(items, cells):
            if all(_cubes(item, edge) is not None for item in items):
                break
        else:
            strange = next(item for item in items if _cubes(item, STEP) is None)
            raise ArgumentError(
                "exact cover needs cuboids or polycubes on the grid: shape "
                f"{strange.shape.id!r} at scale {strange.scale:g} is no union of cubes of "
                f"{STEP} cells"
            )
        a, b, c = (count // edge for count in cells)
        found = sum(int(_known_cubes(item, edge).sum()) for item in items)
        if found != a * b * c:
            raise ArgumentError(
                f"exact cover needs items that fill the box: they have {found} of {a * b * c} cubes"
            )
        return cls(edge, (a, b, c), tuple(_types(items, edge, rules)))

    def placed(self, turned: Item, corner: Triple) -> PlacedItem:
        """Return an item with its low corner at a cube."""
        x, y, z = (at * self.edge // STEP for at in corner)
        return PlacedItem(turned, (x, y, z))


def _edges(items: Sequence[Item], cells: Triple) -> Iterator[int]:
    """Yield the edges of cubes of which all bounding boxes may consist, the longest first."""
    common = math.gcd(*cells, *(count for item in items for count in item.cells))
    yield from (edge for edge in range(common, 0, -1) if common % edge == 0 and edge % STEP == 0)


def _cubes(item: Item, edge: int) -> Cubes | None:
    """Return the cubes that an item fills; None if it fills one partly."""
    if any(count % edge for count in item.cells):
        return None
    a, b, c = (count // edge for count in item.cells)
    shares = item.outer.reshape(a, edge, b, edge, c, edge).mean(axis=(1, 3, 5))
    cubes: Cubes = shares > 0
    volume = cubes.sum() * (edge * CELL) ** 3
    is_union = (shares[cubes] == 1).all() and abs(item.volume / volume - 1) < VOLUME_SLACK
    return cubes if is_union else None


def _known_cubes(item: Item, edge: int) -> Cubes:
    """Return the cubes of an item that fills none partly."""
    cubes = _cubes(item, edge)
    assert cubes is not None
    return cubes


def _types(items: Sequence[Item], edge: int, rules: Rules) -> Iterator[PieceType]:
    """Group items of equal shape and scale."""
    for first, count in Counter(item.turned(0) for item in items).items():
        turned: dict[tuple[Triple, bytes], Item] = {}
        for one in rules.by_alignment(first):
            turned.setdefault((one.cells, _known_cubes(one, edge).tobytes()), one)
        yield PieceType(count, {one: _known_cubes(one, edge) for one in turned.values()})
