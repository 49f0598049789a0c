"""The lattice that items and boxes share: cells, fine cells, grid nodes, and the tolerances.

A box unit holds 100 cells an axis, a cell 4 x 4 x 4 fine cells (64: one machine word), and the
grid has a node every 4 cells. Because an item's cell box is centred on it and stands on a node,
the cells and the fine cells of any two items in a box always line up.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

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

BOX_CELLS = (100, 100, 100)
"""Cells an axis of the benchmark's box, the unit cube."""

MAX_CELLS = 512
"""The most cells an axis that a box, or an item that is voxelised, may have."""

CONTACT_TOLERANCE = 1e-4
"""How far two accepted items may interpenetrate, in box units: surfaces that touch are no conflict,
and parts that lie on a grid touch all the time. Collision meshes are drawn in by half of it on each
side, and cells are grown by half of it when they are tested against a surface."""

CELL_ROUNDING = 1e-6
"""How far, in cells, an extent may exceed a whole number of cells and still be rounded down to it:
what floating point makes of an extent that is meant to be whole."""

Triple = tuple[int, int, int]


def cell_box(extents: npt.ArrayLike) -> Triple:
    """Cells an axis of the cell box around extents (3,) in box units; at least one an axis."""
    cells = np.ceil(np.asarray(extents, dtype=float) * CELLS_PER_UNIT - CELL_ROUNDING)
    x, y, z = np.maximum(cells, 1).astype(int).tolist()
    return x, y, z


def box_cells(cells: Sequence[int]) -> Triple:
    """The cells of a box as a checked triple.

    Raises ValueError where they are not three whole numbers of grid steps up to `MAX_CELLS`.
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
    """Grid nodes an axis of a box of this many cells: the shape of its masks."""
    return cells[0] // STEP, cells[1] // STEP, cells[2] // STEP
