"""What cells tell of a location before any mesh is asked: blocked, free, or open.

Blocked: a fine cell is inner for one item and outer for another. Free: no outer fine cell is
shared. Both are proofs (DESIGN: Feasible); what is open, the meshes decide.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.engine import screening_kernels
from packit_sim.engine.items import PlacedItem
from packit_sim.engine.occupancy import Occupancy
from packit_sim.geometry.lattice import STEP, Triple, grid_nodes
from packit_sim.geometry.shapes import Item

States = npt.NDArray[np.uint8]
Locations = npt.NDArray[np.int64]


def locations(cells: Triple, item: Item) -> Triple:
    """How many locations an axis the item has inside a box of so many cells; it must fit."""
    x, y, z = ((c - own) // STEP + 1 for c, own in zip(cells, item.cells, strict=True))
    nodes = grid_nodes(cells)
    return min(x, nodes[0]), min(y, nodes[1]), min(z, nodes[2])


def screen(occupancy: Occupancy[Any], item: Item) -> States:
    """The state of every location from (0, 0, 0) to the last at which the item is inside."""
    size = locations(occupancy.cells, item)
    return screening_kernels.screen(occupancy.arrays, item.voxels.arrays, occupancy.spans, size)


def screen_at(occupancy: Occupancy[Any], candidate: PlacedItem) -> int:
    """The state of one location, at which the item is inside the box."""
    own = candidate.item.voxels.arrays
    return int(screening_kernels.screen_at(occupancy.arrays, own, candidate.location))


def unblocked(
    occupancy: Occupancy[Any], item: Item, start: Triple
) -> Iterator[tuple[Triple, npt.NDArray[np.int64], int]]:
    """The locations that are not blocked, from `start` on, in the order of (z, x, y).

    Each with the numbers of the placed items that leave it open, none where it is free, and with
    how many locations were looked at so far.
    """
    voxels = item.voxels
    size = locations(occupancy.cells, item)
    found = np.empty(len(occupancy.placed), dtype=np.int64)
    query = (occupancy.arrays, voxels.arrays, occupancy.placed_arrays, voxels.number.shape, size)
    i, j, k = start
    number = (k * size[0] + i) * size[1] + j
    i, j, k, number, count = screening_kernels.next_unblocked(query, number, found)
    while count >= 0:
        yield (i, j, k), found[:count], number
        i, j, k, number, count = screening_kernels.next_unblocked(query, number, found)


def open_pairs(occupancy: Occupancy[Any], item: Item, at: Locations) -> npt.NDArray[np.int64]:
    """(pairs, 2): number of a location (n, 3), and of a placed item that leaves it open.

    By location, and then by placed item; for locations that no item blocks.
    """
    voxels = item.voxels
    placed = occupancy.placed_arrays
    return screening_kernels.open_pairs(voxels.arrays, placed, voxels.number.shape, at)


def screen_pair(placed: PlacedItem, item: Item, at: Locations) -> States:
    """What the cells of one placed item tell of another's locations: (n,) states for (n, 3)."""
    offsets = at - np.array(placed.location)
    fixed, own = placed.item.voxels.fixed_arrays, item.voxels.arrays
    return screening_kernels.screen_pair(fixed, own, offsets)


def screen_offsets(a: Item, b: Item) -> States:
    """The states of two items at all offsets at which their bricks meet.

    [x, y, z] for b at x - (bricks of b along x) + 1 and so on, in grid steps from a.
    """
    fixed, own = a.voxels.fixed_arrays, b.voxels.arrays
    return screening_kernels.screen_offsets(fixed, own, b.voxels.number.shape)
