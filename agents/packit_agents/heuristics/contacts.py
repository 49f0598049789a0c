"""Contacts: the number of pairs of neighbouring cells of an item and a filled box.

Cells are outer cells throughout, as words, one for each brick (see `bits`), so that 64 of them are
processed together. Neighbours share a face.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from packit_agents.heuristics.column_runs import mask_runs
from packit_agents.heuristics.contact_kernels import (
    bound_contacts,
    most_contacts,
    offsets_in,
    sum_neighbours,
)
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask


class Neighbours(NamedTuple):
    """The filled neighbours of the cells of a box.

    Walls and the floor count as filled, the space above the box does not.

    Attributes
    ----------
    words : Words
        The box's outer cells, uint64 [z, x, y], the order in which a box keeps them.
    sums : numpy.ndarray
        Int16 [x, y, z], the numbers of filled neighbours, summed over the cells of each brick.
    """

    words: Words
    sums: npt.NDArray[np.int16]

    @classmethod
    def of(cls, words: Words) -> Neighbours:
        """Count the neighbours in a box with these outer cells, words [x, y, z]."""
        in_order = words.transpose(2, 0, 1)
        return cls(in_order, sum_neighbours(in_order))


def by_contacts(filled: Neighbours, item: Item, mask: Mask) -> Iterator[tuple[int, Triple]]:
    """Find the locations with the most pairs of an item's cells and filled neighbours.

    Parameters
    ----------
    filled : Neighbours
        The neighbours of the box's cells.
    item : Item
        The item, in its rotation.
    mask : Mask
        Bool [x, y, z] over the nodes; the item must be inside the box wherever it is True.

    Yields
    ------
    contacts : int
        The number of pairs.
    location : Triple
        The location. The most pairs come first, ties in the order of (z, x, y).

    Notes
    -----
    A brick of the item has no more contacts than the cells of the box's brick have neighbours, and
    no more than six for each of its own cells. Counting stops where the sum of what is counted and
    of the other bounds is too small.
    """
    voxels = item.voxels
    offsets = offsets_in(voxels.bricks, mask.shape)
    own = voxels.bricks, voxels.outer, offsets
    runs = mask_runs(mask)
    locations, first_bounds = bound_contacts(filled.sums, voxels.outer, offsets, runs, mask)
    bounds, counted = first_bounds.copy(), np.zeros(len(locations), dtype=bool)
    known = locations, first_bounds, bounds, counted
    while (n := most_contacts(tuple(filled), own, *known)) >= 0:
        i, j, k = locations[n].tolist()
        yield int(bounds[n]), (i, j, k)
        bounds[n] = -1
