"""Polycubes in a box of whole cubes that is filled from above: only column heights matter."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import cached_property
from packit_sim.core.choices import RotationSet
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry import rotations
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELL, STEP, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.winding import winding_numbers
from packit_sim.rules import Rules

Cubes = tuple[Triple, ...]
"""The cubes of a polycube, sorted, from (0, 0, 0) on: their min corners."""

_CUBE = STEP * CELL
"""Side of a cube, a step of the grid, in box units."""

_INSET = 0.02
"""Largest share of a cube's side by which a mesh may be drawn in."""

MAX_SIDE = 12
"""Cubes along a side of a box, at most: tables of values grow with the fourth power of its height.
"""

MAX_SHAPES = 100
"""Shapes of a game, at most."""

FORM_START = 5
"""Index of the first column in the row of a form (see `ColumnGame.forms`)."""


@dataclass(frozen=True)
class ColumnGame:
    """A box of whole cubes, the polycubes that arrive, and the rotations that they may have.

    Items come straight down, so that what can still be placed only depends on how high each column
    of cubes is filled, and no location is better than the lowest.

    Attributes
    ----------
    sides : tuple of int
        Cubes along x, y and z.
    shapes : tuple of Cubes
        The polycubes that arrive, each with the same probability, in rotation 0.
    rotations : str
        The rotations that items may have (see `Rules.rotations`).
    """

    sides: Triple
    shapes: tuple[Cubes, ...]
    rotations: RotationSet

    def __post_init__(self) -> None:
        if not 2 <= min(self.sides) <= max(self.sides) <= MAX_SIDE:
            raise ArgumentError(
                f"a box of {' x '.join(map(str, self.sides))} cubes is not possible for values of "
                f"columns: choose 2 to {MAX_SIDE} cubes along each side"
            )
        if not 1 <= len(self.shapes) <= MAX_SHAPES:
            raise ArgumentError(
                f"{len(self.shapes)} shapes are not possible for values of columns: choose 1 to "
                f"{MAX_SHAPES}"
            )
        for shape in self.shapes:
            least = tuple(map(min, zip(*shape, strict=True)))
            if (
                least != (0, 0, 0)
                or max(map(max, shape)) >= MAX_SIDE
                or len(set(shape)) != len(shape)
            ):
                raise ArgumentError(f"{shape} are not the cubes of a polycube from (0, 0, 0) on")

    @classmethod
    def of(cls, cells: Triple, items: Iterable[Item], rotations: RotationSet) -> ColumnGame:
        """Create the game of a box and the different items that arrive.

        Returns
        -------
        ColumnGame
            The game.

        Raises
        ------
        ArgumentError
            If an item is no polycube whose cubes are a grid step wide.
        """
        x, y, z = (count // STEP for count in cells)
        return cls((x, y, z), tuple(sorted({cubes(item) for item in items})), rotations)

    @cached_property
    def forms(self) -> npt.NDArray[np.int64]:
        """The polycubes in their different rotations, a row each, those of one shape together.

        A row holds the rotation, the extents along x, y and z, and the number of columns; for each
        column its x, its y, its bottom and its top follow.
        """
        return self._forms[0]

    @cached_property
    def firsts(self) -> npt.NDArray[np.int64]:
        """The first form of each shape, and their number: int64 (shapes + 1,)."""
        return self._forms[1]

    @cached_property
    def _forms(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        rows: list[list[int]] = []
        firsts = [0]
        allowed = Rules(rotations=self.rotations).allowed_rotations
        for shape in self.shapes:
            known: dict[Cubes, int] = {}
            for rotation in allowed:
                known.setdefault(_turned(shape, rotation), rotation)
            rows += [_row(turned, rotation) for turned, rotation in known.items()]
            firsts.append(len(rows))
        found = np.zeros((len(rows), max(map(len, rows))), dtype=np.int64)
        for row, values in zip(found, rows, strict=True):
            row[: len(values)] = values
        return found, np.array(firsts)

    @property
    def arrays(self) -> tuple[npt.NDArray[np.int64], ...]:
        """The game as kernels take it."""
        return np.array(self.sides), self.firsts, self.forms

    @property
    def most_shapes(self) -> int:
        """Shapes that fill the box at most, by their volume."""
        return math.prod(self.sides) // min(map(len, self.shapes))

    def heights(self, placed: Iterable[PlacedItem]) -> npt.NDArray[np.int64]:
        """Compute how high the columns are filled, in cubes: int64 (x * y,)."""
        found = np.zeros(self.sides[:2], dtype=np.int64)
        for one in placed:
            for x, y, z in np.add(cubes(one.item), one.location).tolist():
                found[x, y] = max(found[x, y], z + 1)
        return found.ravel()

    def shape(self, item: Item) -> int | None:
        """Return the number of an item's shape; None if it is none of those that arrive."""
        own = cubes(item.turned(0))
        return self.shapes.index(own) if own in self.shapes else None


@lru_cache(maxsize=512)
def cubes(item: Item) -> Cubes:
    """Find the cubes of an item in its rotation.

    Returns
    -------
    Cubes
        The cubes.

    Raises
    ------
    ArgumentError
        If it is no polycube whose cubes are a grid step wide, drawn in by 2% of that at most.
    """
    mesh = item.mesh
    low = np.asarray(mesh.bounds[0], dtype=np.float64)
    sides = np.rint(item.extents / _CUBE).astype(int)
    corners = list(itertools.product(*(range(side) for side in sides.tolist())))
    middles = low + (np.array(corners).reshape(-1, 3) + 0.5) * _CUBE
    inside = winding_numbers(np.asarray(mesh.triangles, dtype=np.float64), middles) > 0.5
    found = tuple((x, y, z) for (x, y, z), is_in in zip(corners, inside, strict=True) if is_in)
    volume = len(found) * _CUBE**3
    is_drawn_in = (np.abs(item.extents - sides * _CUBE) < 2 * _INSET * _CUBE).all()
    if not found or not is_drawn_in or not 1 - 6 * _INSET < item.volume / volume <= 1:
        raise ArgumentError(
            f"values of columns need polycubes whose cubes are a grid step wide, which shape "
            f"{item.shape.id!r} is not: choose another agent"
        )
    return found


def _turned(shape: Cubes, rotation: int) -> Cubes:
    turned = np.array(shape) @ rotations.MATRICES[rotation].T
    return tuple(sorted((x, y, z) for x, y, z in (turned - turned.min(axis=0)).tolist()))


def _row(shape: Cubes, rotation: int) -> list[int]:
    columns = defaultdict(list)
    for x, y, z in shape:
        columns[x, y].append(z)
    extents = (np.max(shape, axis=0) + 1).tolist()
    row = [rotation, *extents, len(columns)]
    for (x, y), filled in columns.items():
        row += [x, y, min(filled), max(filled) + 1]
    return row
