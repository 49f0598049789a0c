"""Columns of cells: how high a box is filled, and how much room there is below a shape.

Cells are outer cells throughout. A box's are given as words [x, y, z], one a brick (see `bits`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_agents.heuristics.column_runs import stretches
from packit_sim.core.compilation import kernel
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import STEP
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask

Heights = npt.NDArray[np.int64]
Clearances = npt.NDArray[np.uint16]
Costs = npt.NDArray[np.int64]


def heightmap(words: Words) -> Heights:
    """(x, y) over a box's cells: the top of the highest filled cell in each column; 0 for none."""
    return _heightmap(np.ascontiguousarray(words))


def growth(heights: Heights, item: Item, mask: Mask) -> Costs:
    """[x, y, z] over the nodes: by how much the sum of the heightmap grows; 0 off the mask.

    The item must be inside the box wherever the mask is True.
    """
    return _growth(heights, _columns(item), mask)


def room_below(words: Words) -> Clearances:
    """[x % 4, y % 4, z % 4, brick] over a box's cells: the empty cells straight below each.

    Bricks are in C order: what a column of a shape has below it at all nodes stands in a row.
    """
    return _room_below(np.ascontiguousarray(words))


def gaps(rooms: Clearances, item: Item, mask: Mask) -> Costs:
    """[x, y, z] over the nodes: the empty cells straight below the item; 0 off the mask.

    The item must be inside the box wherever the mask is True.
    """
    x, y, low, _ = _columns(item).T
    _, ny, nz = mask.shape
    brick = (x // STEP * ny + y // STEP) * nz + low // STEP
    columns = ((x % STEP * STEP + y % STEP) * STEP + low % STEP) * mask.size + brick
    empty = _gaps(rooms.ravel(), columns, mask.size, stretches(mask)).reshape(mask.shape)
    return np.where(mask, empty, 0).astype(np.int64)


def _columns(item: Item) -> npt.NDArray[np.int64]:
    """(n, 4): x, y, bottom of the lowest cell, top of the highest, of each column that has any."""
    cells = item.outer
    x, y = np.nonzero(cells.any(axis=2))
    low = cells.argmax(axis=2)
    top = cells.shape[2] - cells[:, :, ::-1].argmax(axis=2)
    return np.column_stack((x, y, low[x, y], top[x, y]))


@kernel
def _heightmap(words):
    """`heightmap` of words."""
    nx, ny, _ = words.shape
    heights = np.zeros((STEP * nx, STEP * ny), np.int64)
    for x, y, z in np.ndindex(words.shape):
        for column in range(16):
            bits = words[x, y, z] >> np.uint64(STEP * column) & np.uint64(15)
            if bits:
                top = 1 + (bits > 1) + (bits > 3) + (bits > 7)
                heights[STEP * x + column // 4, STEP * y + column % 4] = STEP * z + top
    return heights


@kernel
def _growth(heights, columns, mask):
    """`growth` of columns: from some node on a column sticks out, and the map grows by how much."""
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
def _room_below(words):
    """`room_below` of words."""
    nx, ny, nz = words.shape
    rooms = np.empty((STEP, STEP, STEP, nx * ny * nz), np.uint16)
    for x, y in np.ndindex((STEP * nx, STEP * ny)):
        column = np.uint64(16 * (x % STEP) + STEP * (y % STEP))
        brick = (x // STEP * ny + y // STEP) * nz
        room = 0
        for z in range(nz):
            bits = words[x // STEP, y // STEP, z] >> column
            for rest in range(STEP):
                rooms[x % STEP, y % STEP, rest, brick + z] = room
                room = 0 if bits >> np.uint64(rest) & np.uint64(1) else room + 1
    return rooms


@kernel
def _gaps(rooms, columns, nodes, stretches):
    """(nodes,) `gaps` of columns, in C order, at the nodes of stretches; 0 elsewhere.

    rooms: flat. columns: where in it each has the room below it at the first node. The numbers mean
    nothing where the item is not inside the box: there it sticks out to the next row.
    """
    empty = np.zeros(nodes, np.int32)
    for begin, end in stretches:
        total = empty[begin:end]
        for column in columns:
            below = rooms[column + begin : column + end]
            for m in range(len(total)):
                total[m] += below[m]
    return empty
