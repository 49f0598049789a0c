"""The lattice that items and boxes share: cells, fine cells, grid nodes, and the tolerances.

A box unit has 100 cells along each axis, a cell has 4 x 4 x 4 fine cells (64: one machine word),
and the grid has a node every 4 cells. An item's cell box is centred on it and placed at a node, so
the cells and the fine cells of any two items in a box always line up.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Sequence

from packit_sim.core.errors import ArgumentError

CELLS_PER_UNIT = 100
"""Cells along a box unit."""

CELL = 1.0 / CELLS_PER_UNIT
"""Side of a cell, in box units."""

FINE_PER_CELL = 4
"""Fine cells along a cell's side."""

FINE = CELL / FINE_PER_CELL
"""Side of a fine cell, in box units."""

STEP = 4
"""Cells between neighbouring grid nodes."""

MOVES = 3
"""Maximum number of straight moves in a route: two along the axes, and one up."""

BOX_CELLS = (100, 100, 100)
"""Cells along each axis of the benchmark's box, the unit cube."""

MAX_CELLS = 512
"""Largest number of cells along an axis of a box, or of an item that is voxelized."""

ORIGIN: Triple = (0, 0, 0)
"""The first location in the order of bottom-left-back fill."""

CONTACT_TOLERANCE = 1e-4
"""Depth to which two accepted items may interpenetrate, in box units: surfaces may touch, and on a
grid they often do. Collision meshes are shrunk by half of it on each side, and
cells are grown by half of it when they are tested against a surface."""

CELL_ROUNDING = 1e-6
"""Excess, in cells, over a whole number of cells at which an extent is still rounded down: the
rounding error of an extent that is meant to be whole."""

_CELLS_LIMIT = 2**31
"""Cells along an axis of an item that is larger than any box; more might overflow."""

Triple = tuple[int, int, int]


def cell_box(extents: Iterable[float]) -> Triple:
    """Compute the cell box of extents.

    Parameters
    ----------
    extents : iterable of float
        (3,) in box units.

    Returns
    -------
    Triple
        Cells along each axis, from 1 to 2**31.
    """
    cells = (extent * CELLS_PER_UNIT - CELL_ROUNDING for extent in extents)
    x, y, z = (math.ceil(min(max(float(each), 1.0), _CELLS_LIMIT)) for each in cells)
    return x, y, z


def box_cells(cells: Sequence[int]) -> Triple:
    """Check the cells of a box.

    Parameters
    ----------
    cells : Sequence[int]
        Cells along each axis.

    Returns
    -------
    Triple
        The same, as a tuple.

    Raises
    ------
    ArgumentError
        If they are not three whole numbers of grid steps up to `MAX_CELLS`.
    """
    try:
        x, y, z = (operator.index(c) for c in cells)
    except (TypeError, ValueError):
        raise ArgumentError(f"a box needs three whole numbers of cells, not {cells!r}") from None
    if not all(0 < c <= MAX_CELLS and c % STEP == 0 for c in (x, y, z)):
        raise ArgumentError(
            f"a box of {x} x {y} x {z} cells is not possible: "
            f"each must be a multiple of {STEP} from {STEP} to {MAX_CELLS}"
        )
    return x, y, z


def grid_nodes(cells: Triple) -> Triple:
    """Return the grid nodes along each axis of a box with these cells: the shape of its masks."""
    return cells[0] // STEP, cells[1] // STEP, cells[2] // STEP
