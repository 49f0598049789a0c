"""Screening: the state of a location by its cells, which is blocked, free or open.

Blocked: a fine cell is inner for one item and outer for another. Free: no outer fine cell is
shared. Both are proofs (docs/concepts/exactness.md); at open locations the meshes decide.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.engine import screening_kernels
from packit_sim.engine.occupancy import Occupancy
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import STEP, Triple, grid_nodes
from packit_sim.geometry.shapes import Item

States = npt.NDArray[np.uint8]
Locations = npt.NDArray[np.int64]


def location_counts(cells: Triple, item: Item) -> Triple:
    """Count the locations along each axis at which an item that fits is inside the box."""
    x, y, z = cells
    a, b, c = item.cells
    return (
        min((x - a) // STEP + 1, x // STEP),
        min((y - b) // STEP + 1, y // STEP),
        min((z - c) // STEP + 1, z // STEP),
    )


def screen(
    occupancy: Occupancy[Any], item: Item, known: npt.NDArray[np.bool_] | None = None
) -> States:
    """Compute the states of all locations at which the item is inside the box.

    Parameters
    ----------
    occupancy : Occupancy
        The items already in the box.
    item : Item
        The item to place, in its rotation.
    known : ndarray, optional
        Bool (nx, ny, nz) over the grid nodes: locations that need no answer, and get `FREE`.

    Returns
    -------
    States
        uint8 [x, y, z].
    """
    if known is None:
        known = np.zeros(grid_nodes(occupancy.cells), dtype=bool)
    size = location_counts(occupancy.cells, item)
    own = item.voxels.arrays
    return screening_kernels.screen(occupancy.arrays, own, occupancy.spans, size, known)


def screen_at(occupancy: Occupancy[Any], candidate: PlacedItem) -> int:
    """Compute the state of one location, at which the item is inside the box."""
    own = candidate.item.voxels.arrays
    return int(screening_kernels.screen_at(occupancy.arrays, own, candidate.location))


def open_pairs(occupancy: Occupancy[Any], item: Item, at: Locations) -> npt.NDArray[np.int64]:
    """Find the placed items that leave locations open.

    Parameters
    ----------
    occupancy : Occupancy
        The items already in the box.
    item : Item
        The item to place, in its rotation.
    at : Locations
        (n, 3) int64, locations that no item blocks.

    Returns
    -------
    ndarray
        (pairs, 2) int64, the number of a location and that of a placed item, in this order.
    """
    voxels = item.voxels
    placed = occupancy.placed_arrays
    return screening_kernels.open_pairs(voxels.arrays, placed, voxels.number.shape, at)


def screen_pair(placed: PlacedItem, item: Item, at: Locations) -> States:
    """Compute the states (n,) of an item's locations (n, 3) by the cells of one placed item."""
    offsets = at - np.array(placed.location)
    fixed, own = placed.item.voxels.fixed_arrays, item.voxels.arrays
    return screening_kernels.screen_pair(fixed, own, offsets)


def screen_offsets(a: Item, b: Item) -> States:
    """Compute the states of two items at all offsets at which their bricks can meet.

    Parameters
    ----------
    a : Item
        The first item, in its rotation.
    b : Item
        The second item, in its rotation.

    Returns
    -------
    States
        uint8 [x, y, z] for b at x - (bricks of b along x) + 1 grid steps from a along x, and so on.
    """
    fixed, own = a.voxels.fixed_arrays, b.voxels.arrays
    return screening_kernels.screen_offsets(fixed, own, b.voxels.number.shape)
