"""Columns of cells: how high a box is filled, and how much room there is below a shape.

Cells are outer cells throughout. A box's are given as words [x, y, z], one a brick (see `bits`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_agents.heuristics import heightmap_kernels
from packit_agents.heuristics.column_runs import stretches
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import STEP
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask

Heights = npt.NDArray[np.int64]
Clearances = npt.NDArray[np.uint16]
Costs = npt.NDArray[np.int64]


def heightmap(words: Words) -> Heights:
    """(x, y) over a box's cells: the top of the highest filled cell in each column; 0 for none."""
    return heightmap_kernels.column_heights(np.ascontiguousarray(words))


def growth(heights: Heights, item: Item, mask: Mask) -> Costs:
    """[x, y, z] over the nodes: by how much the sum of the heightmap grows; 0 off the mask.

    The item must be inside the box wherever the mask is True.
    """
    return heightmap_kernels.height_growth(heights, _columns(item), mask)


def room_below(words: Words) -> Clearances:
    """[x % 4, y % 4, z % 4, brick] over a box's cells: the empty cells straight below each.

    Bricks are in C order: what a column of a shape has below it at all nodes stands in a row.
    """
    return heightmap_kernels.space_below(np.ascontiguousarray(words))


def gaps(rooms: Clearances, item: Item, mask: Mask) -> Costs:
    """[x, y, z] over the nodes: the empty cells straight below the item; 0 off the mask.

    The item must be inside the box wherever the mask is True.
    """
    x, y, low, _ = _columns(item).T
    _, ny, nz = mask.shape
    brick = (x // STEP * ny + y // STEP) * nz + low // STEP
    columns = ((x % STEP * STEP + y % STEP) * STEP + low % STEP) * mask.size + brick
    empty = heightmap_kernels.gaps_below(
        rooms.ravel(), columns, mask.size, stretches(mask)
    ).reshape(mask.shape)
    return np.where(mask, empty, 0).astype(np.int64)


def _columns(item: Item) -> npt.NDArray[np.int64]:
    """(n, 4): x, y, bottom of the lowest cell, top of the highest, of each column that has any."""
    cells = item.outer
    x, y = np.nonzero(cells.any(axis=2))
    low = cells.argmax(axis=2)
    top = cells.shape[2] - cells[:, :, ::-1].argmax(axis=2)
    return np.column_stack((x, y, low[x, y], top[x, y]))
