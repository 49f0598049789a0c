"""Kernels over columns of cells (see `heightmaps`).

Heightmap heuristics for packing on a grid (as Heightmap Minimization, Wang and Hauser, 2019): the
top of each column of cells, by how much an item would raise their sum, and how much empty space it
would leave below. All numbers are integers and exact for the cells; inputs are never changed.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel
from packit_sim.geometry.lattice import STEP


@kernel
def column_heights(words):
    """Compute `heightmaps.heightmap`."""
    nx, ny, _ = words.shape
    heights = np.zeros((STEP * nx, STEP * ny), np.int64)
    for x, y, z in np.ndindex(words.shape):
        for column in range(16):
            bits = words[x, y, z] >> np.uint64(STEP * column) & np.uint64(15)
            if bits:
                # z is the last index: the last brick of a column that has bits is the highest.
                top = 1 + (bits > 1) + (bits > 3) + (bits > 7)
                heights[STEP * x + column // 4, STEP * y + column % 4] = STEP * z + top
    return heights


@kernel
def height_growth(heights, columns, mask):
    """Compute `heightmaps.growth`: above some node, each column raises the map by its excess."""
    grown = np.zeros(mask.shape, np.int64)
    nz = mask.shape[2]
    count = np.empty(nz, np.int64)
    height = np.empty(nz, np.int64)
    for i, j in np.ndindex(mask.shape[:2]):
        if not mask[i, j].any():
            continue
        count[:] = 0
        height[:] = 0
        for n in range(len(columns)):
            x, y, _, top = columns[n]
            # From the first node on at which a column's top is above the map, its growth is linear
            # in k: so count columns and sum their heights there, and take running sums over k.
            under = heights[STEP * i + x, STEP * j + y] - top
            first = max(under // STEP + 1, 0)
            if first < nz:
                count[first] += 1
                height[first] += under
        columns_out = heights_under = 0
        for k in range(nz):
            columns_out += count[k]
            heights_under += height[k]
            if mask[i, j, k]:
                grown[i, j, k] = STEP * k * columns_out - heights_under
    return grown


@kernel
def space_below(words):
    """Compute `heightmaps.space_below`."""
    nx, ny, nz = words.shape
    spaces = np.empty((STEP, STEP, STEP, nx * ny * nz), np.uint16)
    for x, y in np.ndindex((STEP * nx, STEP * ny)):
        column = np.uint64(16 * (x % STEP) + STEP * (y % STEP))
        brick = (x // STEP * ny + y // STEP) * nz
        space = 0
        for z in range(nz):
            bits = words[x // STEP, y // STEP, z] >> column
            for rest in range(STEP):
                spaces[x % STEP, y % STEP, rest, brick + z] = space
                space = 0 if bits >> np.uint64(rest) & np.uint64(1) else space + 1
    return spaces


@kernel
def gaps_below(spaces, columns, nodes, runs):
    """Compute `heightmaps.gaps` at the nodes of runs.

    Parameters
    ----------
    spaces : Spaces
        The result of `space_below`, flat.
    columns : numpy.ndarray
        Int64 (n,), for each column of the item the index in `spaces` at the first node.
    nodes : int
        Number of the grid's nodes.
    runs : CellRuns
        Runs of nodes, see `column_runs`.

    Returns
    -------
    numpy.ndarray
        Int32 (nodes,) in C order, 0 outside the runs. The numbers have no meaning where the item
        is not inside the box, because there it continues in the next row.
    """
    # Nodes of a run follow each other in `spaces` for every column, so the inner loop is a sum of
    # slices: that is why spaces are sorted by the place in a brick.
    empty = np.zeros(nodes, np.int32)
    for begin, end in runs:
        total = empty[begin:end]
        for column in columns:
            below = spaces[column + begin : column + end]
            for m in range(len(total)):
                total[m] += below[m]
    return empty


@kernel
def first_least(costs, mask):
    """Return the location (i, j, k) of the least cost in a mask, the first in (z, x, y)."""
    nx, ny, nz = mask.shape
    least, location = np.int64(0), (-1, -1, -1)
    for k in range(nz):
        for i in range(nx):
            for j in range(ny):
                if mask[i, j, k] and (location[0] < 0 or costs[i, j, k] < least):
                    least, location = costs[i, j, k], (i, j, k)
    return location
