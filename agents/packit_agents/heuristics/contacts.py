"""Contacts: the number of pairs of neighbouring cells of an item and a filled box.

Cells are outer cells throughout, as words, one for each brick (see `bits`), so that 64 of them are
processed together. Neighbours share a face.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_agents.heuristics.column_runs import mask_runs
from packit_agents.heuristics.contact_kernels import count_contacts, count_neighbours
from packit_sim.geometry.bits import Words
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask


def neighbours(words: Words) -> Words:
    """Count the filled neighbours of each cell of a box.

    Parameters
    ----------
    words : Words
        The box's outer cells, uint64 [x, y, z].

    Returns
    -------
    Words
        Uint64 [digit, x, y, z]: the count of each cell as a binary number whose three digits, from
        low to high, are in three words. The walls and the floor count as filled, the space above
        the box does not.
    """
    return count_neighbours(np.ascontiguousarray(words))


def contacts(digits: Words, item: Item, mask: Mask) -> npt.NDArray[np.int64]:
    """Count the pairs of an item's cells and filled neighbours, at each location.

    Parameters
    ----------
    digits : Words
        The counts of the box, from `neighbours`.
    item : Item
        The item, in its rotation.
    mask : Mask
        Bool [x, y, z] over the nodes; the item must be inside the box wherever it is True.

    Returns
    -------
    numpy.ndarray
        Int64 [x, y, z] over the nodes, 0 where the mask is False.
    """
    x, y, z = item.voxels.bricks.T.astype(np.int64)
    _, ny, nz = mask.shape
    bricks = (x * ny + y) * nz + z
    flat = digits.reshape(3, -1)
    found = count_contacts(flat, bricks, item.voxels.outer, mask_runs(mask)).reshape(mask.shape)
    return np.where(mask, found, 0)
