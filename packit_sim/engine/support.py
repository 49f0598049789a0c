"""The rule of support: locations at which an item rests on something.

Locations are a grid step apart, so that items seldom touch what they stand on. A place of the
item's base is therefore *supported* if there is something less than a grid step below it: one step
lower, the item would meet it there. Fine cells (docs/concepts/grid.md) define what that means:

- The *base* of an item are the columns of fine cells in which its lowest outer fine cell is less
  than a cell higher than the lowest of the whole item. So a table's base is the soles of its legs,
  a ball's the spot on which it rolls.
- Such a column is supported if the floor or an outer fine cell of a placed item is less than a grid
  step below that lowest fine cell of the column, or in the same fine cell.

The *support* of an item at a location is the share of its base that is supported, from 0 to 1. On
the floor it is 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache
from packit_sim.core.debugging import is_checking
from packit_sim.engine.feasibility import Mask
from packit_sim.engine.insertion import columns
from packit_sim.engine.support_kernels import add_columns, count_supported, remove_unsupported
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import FINE_PER_CELL, STEP, Triple, grid_nodes
from packit_sim.geometry.shapes import Item

COLUMNS_BUDGET = 32 * 2**20
"""Bytes in the process's cache of the columns of boxes; 8 MB for a box of 100 cells."""

_FINE_PER_STEP = STEP * FINE_PER_CELL


def supported_mask(
    cells: Triple, placed: Sequence[PlacedItem], item: Item, mask: Mask, share: float
) -> Mask:
    """Restrict a mask of feasible locations to those with enough support.

    Parameters
    ----------
    cells : tuple of int
        Cells of the box along x, y and z.
    placed : sequence of PlacedItem
        The items already in the box.
    item : Item
        The item to place, in its rotation.
    mask : Mask
        Bool (nx, ny, nz) over the grid nodes, see `feasibility.feasible`.
    share : float
        The least support, from 0 to 1.

    Returns
    -------
    Mask
        A new mask of the same shape.
    """
    found = mask.copy()
    if mask[:, :, 1:].any():
        base = _base(item)
        about = int(share * len(base))  # rounded: the quotient that `support` returns decides
        least = next(n for n in range(max(about - 1, 0), about + 2) if n / len(base) >= share)
        remove_unsupported(found, _filled(cells, tuple(placed)), base, least)
    return found


def support(cells: Triple, placed: Sequence[PlacedItem], candidate: PlacedItem) -> float:
    """Compute the support of an item at a feasible location.

    Parameters
    ----------
    cells : tuple of int
        Cells of the box along x, y and z.
    placed : sequence of PlacedItem
        The items already in the box.
    candidate : PlacedItem
        The item to place, at its location.

    Returns
    -------
    float
        The share of its base that is supported, from 0 to 1.
    """
    if candidate.location[2] == 0:
        return 1.0
    base = _base(candidate.item)
    count = count_supported(_filled(cells, tuple(placed)), base, *candidate.location)
    found = int(count) / len(base)
    assert not is_checking() or found == support_oracle(placed, candidate)
    return found


def support_oracle(placed: Iterable[PlacedItem], candidate: PlacedItem) -> float:
    """Compute the support of an item by its definition, fine cell by fine cell, without kernels."""
    start = np.multiply(candidate.start, FINE_PER_CELL)
    outer = candidate.item.voxels.outer_fine
    low = np.where(outer.any(axis=2), outer.argmax(axis=2), outer.shape[2])
    base = np.argwhere(low < low.min() + FINE_PER_CELL)
    heights = low[tuple(base.T)] + start[2]
    supported = heights < _FINE_PER_STEP  # the floor is less than a step below
    for other in placed:
        theirs = other.item.voxels.outer_fine
        offset = start - np.multiply(other.start, FINE_PER_CELL)
        at = base + offset[:2]
        inside = ((at >= 0) & (at < theirs.shape[:2])).all(axis=1)
        for n in np.flatnonzero(inside & ~supported).tolist():
            top = heights[n] - start[2] + offset[2] + 1
            below = theirs[at[n, 0], at[n, 1], max(top - 1 - _FINE_PER_STEP, 0) : max(top, 0)]
            supported[n] = below.any()
    return int(np.count_nonzero(supported)) / len(base)


@bounded_cache(
    "bases", 16 * 2**20, "bytes", size=lambda base: base.nbytes, key=lambda item: item.key
)
def _base(item: Item) -> npt.NDArray[np.int64]:
    """List the columns of an item's base: x, y and the lowest fine cell of each, (n, 3) int64."""
    low = columns(item).low
    x, y = np.nonzero(low < low.min() + FINE_PER_CELL)
    base = np.column_stack([x, y, low[x, y]]).astype(np.int64)
    assert base[:, 2].max() < _FINE_PER_STEP, "the cell box is less than a cell larger"
    return base


@bounded_cache(
    "columns of boxes",
    COLUMNS_BUDGET,
    "bytes",
    size=lambda filled: filled.nbytes,
    key=lambda cells, placed: (cells, placed),
)
def _filled(cells: Triple, placed: tuple[PlacedItem, ...]) -> npt.NDArray[np.uint16]:
    """Compute the columns of a box's outer fine cells (see `support_kernels.add_columns`)."""
    nx, ny, nz = grid_nodes(cells)
    filled = np.zeros((nz + 1, nx * _FINE_PER_STEP, ny * _FINE_PER_STEP), dtype=np.uint16)
    filled[0] = 2**_FINE_PER_STEP - 1
    for one in placed:
        i, j, k = one.location
        words = one.item.voxels.outer_words
        add_columns(filled, words, i * _FINE_PER_STEP, j * _FINE_PER_STEP, k)
    return filled
