"""Columns of cells: the filled height of a box, and the empty space below a shape.

Cells are outer cells throughout. Those of a box are words [x, y, z], one for each brick (see
`bits`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from packit_agents.heuristics import heightmap_kernels
from packit_agents.heuristics.column_runs import mask_runs
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import STEP, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask

Heights = npt.NDArray[np.int64]
Spaces = npt.NDArray[np.uint16]
Costs = npt.NDArray[np.int64]
"""[x, y, z] over the grid's nodes: less is better."""


def heightmap(words: Words) -> Heights:
    """Compute the top of the highest filled cell of each column (x, y) of cells; 0 if empty."""
    return heightmap_kernels.column_heights(np.ascontiguousarray(words))


def growth(heights: Heights, item: Item, mask: Mask) -> Costs:
    """Compute by how much the sum of the heightmap grows with an item, at each location.

    Parameters
    ----------
    heights : Heights
        The box's heightmap, int64 (x, y) over its cells.
    item : Item
        The item, in its rotation.
    mask : Mask
        Bool [x, y, z] over the nodes; the item must be inside the box wherever it is True.

    Returns
    -------
    Costs
        Int64 [x, y, z] over the nodes, in cells, 0 where the mask is False.
    """
    return heightmap_kernels.height_growth(heights, _columns(item), mask)


def space_below(words: Words) -> Spaces:
    """Count the empty cells straight below each cell of a box.

    Parameters
    ----------
    words : Words
        The box's outer cells, uint64 [x, y, z].

    Returns
    -------
    Spaces
        Uint16 [x % 4, y % 4, z % 4, brick] over the box's cells. Bricks are in C order, so that
        the counts below one column of a shape, at all nodes, are consecutive in memory.
    """
    return heightmap_kernels.space_below(np.ascontiguousarray(words))


def gaps(spaces: Spaces, item: Item, mask: Mask) -> Costs:
    """Count the empty cells straight below an item, at each location.

    Parameters
    ----------
    spaces : Spaces
        The counts of the box, from `space_below`.
    item : Item
        The item, in its rotation.
    mask : Mask
        Bool [x, y, z] over the nodes; the item must be inside the box wherever it is True.

    Returns
    -------
    Costs
        Int64 [x, y, z] over the nodes, 0 where the mask is False.
    """
    x, y, low, _ = _columns(item).T
    _, ny, nz = mask.shape
    brick = (x // STEP * ny + y // STEP) * nz + low // STEP
    columns = ((x % STEP * STEP + y % STEP) * STEP + low % STEP) * mask.size + brick
    empty = heightmap_kernels.gaps_below(
        spaces.ravel(), columns, mask.size, mask_runs(mask)
    ).reshape(mask.shape)
    return np.where(mask, empty, 0).astype(np.int64)


def by_cost(costs: Costs, mask: Mask) -> Iterator[tuple[int, Triple]]:
    """Sort the locations of a mask by their costs.

    Parameters
    ----------
    costs : Costs
        Int64 [x, y, z] over the nodes.
    mask : Mask
        Bool [x, y, z] over the nodes.

    Yields
    ------
    cost : int
        The cost.
    location : Triple
        The location. The least costs come first, ties in the order of (z, x, y).
    """
    left = mask.copy()
    while (location := heightmap_kernels.first_least(costs, left))[0] >= 0:
        yield int(costs[location]), location
        left[location] = False


def _columns(item: Item) -> npt.NDArray[np.int64]:
    """List x, y, bottom of the lowest and top of the highest cell of each column, (n, 4)."""
    cells = item.outer
    x, y = np.nonzero(cells.any(axis=2))
    low = cells.argmax(axis=2)
    top = cells.shape[2] - cells[:, :, ::-1].argmax(axis=2)
    return np.column_stack((x, y, low[x, y], top[x, y]))
