"""Contacts: how many pairs of neighbouring cells an item and a filled box have.

Cells are outer cells throughout, as words, one a brick (see `bits`), so that sixty-four are looked
at together. Neighbours share a face.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_agents.heuristics.column_runs import stretches
from packit_agents.heuristics.contact_kernels import count_contacts, count_neighbours
from packit_sim.geometry.bits import Words
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask


def neighbours(words: Words) -> Words:
    """[digit, x, y, z] of a box's words [x, y, z]: how many neighbours of each cell are filled.

    A binary number for each cell, its three digits from low to high in three words. The walls and
    the floor count as filled, what is above the box does not.
    """
    return count_neighbours(np.ascontiguousarray(words))


def contacts(digits: Words, item: Item, mask: Mask) -> npt.NDArray[np.int64]:
    """[x, y, z] over the nodes: pairs of the item's cells and filled neighbours; 0 off the mask.

    digits: what `neighbours` says of the box. The item must be inside it wherever the mask is True.
    """
    x, y, z = item.voxels.bricks.T.astype(np.int64)
    _, ny, nz = mask.shape
    bricks = (x * ny + y) * nz + z
    flat = digits.reshape(3, -1)
    found = count_contacts(flat, bricks, item.voxels.outer, stretches(mask)).reshape(mask.shape)
    return np.where(mask, found, 0)
