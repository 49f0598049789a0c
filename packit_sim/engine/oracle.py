"""The oracle: the definition of a feasible location as a plain loop."""

from __future__ import annotations

import operator
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache
from packit_sim.engine.collision import collides, contains
from packit_sim.engine.feasibility import Mask, is_inside
from packit_sim.geometry.items import Contents, ItemInBox, PlacedItem, triangles
from packit_sim.geometry.lattice import (
    CELL,
    CONTACT_TOLERANCE,
    FINE,
    FINE_PER_CELL,
    STEP,
    Triple,
    grid_nodes,
)
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxelization import lattice_cells
from packit_sim.geometry.voxels import unpack

FINE_CELLS_BUDGET = 2**30
"""Bytes in the process's cache of whole fine arrays, which only the oracle uses."""

_FINE_PER_STEP = STEP * FINE_PER_CELL

_WORDS_PER_STEP = (_FINE_PER_STEP, _FINE_PER_STEP, 1)
"""Words between two grid nodes along x, y and z."""

Words = npt.NDArray[np.uint16]
"""Fine cells [x, y, z]: a bit each, the 16 of a grid step along z in a word."""

_Fine = tuple[npt.NDArray[np.int64], Words, Words]
"""The first word (3,), and the words of the outer and of the inner fine cells."""


def oracle(box: Contents[ItemInBox], item: Item) -> Mask:
    """Compute the mask of feasible locations by a loop over all locations and all items.

    Slow, obvious, and always right: `feasibility.feasible` always equals it.

    Parameters
    ----------
    box : Contents
        The box and the items in it.
    item : Item
        The item to place, in its rotation.

    Returns
    -------
    Mask
        Bool over the grid nodes, indexed [x, y, z].
    """
    nodes = grid_nodes(box.cells)
    mask = np.zeros(nodes, dtype=bool)
    for location in np.ndindex(nodes):
        mask[location] = is_inside(box.cells, PlacedItem(item, location))
    for other in box.placed:
        for i, j, k in np.argwhere(mask & _near(item, other, nodes)).tolist():
            mask[i, j, k] = not conflicts(PlacedItem(item, (i, j, k)), other)
    return mask


def is_valid(cells: Triple, placed: Iterable[ItemInBox], candidate: ItemInBox) -> bool:
    """Decide whether an item is feasible where it is; on the grid, the oracle's mask there.

    Parameters
    ----------
    cells : Triple
        The cells of the box along x, y and z.
    candidate : ItemInBox
        The item to place, on the grid or off it. Off the grid it is inside the box if all of its
        vertices are, within half of the contact tolerance.

    Returns
    -------
    bool
        Whether the item is inside the box and in conflict with no item there.
    """
    if isinstance(candidate, PlacedItem):
        inside = is_inside(cells, candidate)
    else:
        vertices, slack = candidate.vertices, CONTACT_TOLERANCE / 2
        size = np.array(cells) * CELL
        inside = bool((vertices >= -slack).all() and (vertices <= size + slack).all())
    return inside and not any(conflicts(candidate, other) for other in placed)


def conflicts(candidate: ItemInBox, other: ItemInBox) -> bool:
    """Decide whether two items exclude each other where they are.

    They do if a fine cell is inner for one item and outer for the other, if their collision meshes
    cross, or if a connected part of one mesh is inside a closed part of the other.

    Parameters
    ----------
    candidate : ItemInBox
        An item on the grid or off it.
    other : ItemInBox
        Another one.

    Returns
    -------
    bool
        Whether they do.

    Notes
    -----
    A closed part of a mesh is watertight with consistent winding. What is in its cavities is inside
    it, as by cells. An open part encloses only the fine cells that nothing reaches.
    """
    if isinstance(candidate, PlacedItem):
        if isinstance(other, PlacedItem) and not _boxes_overlap(candidate, other):
            return False
    elif _are_apart(candidate, other):
        return False
    elif collides(candidate, other):  # cheaper than the voxels of an item off the grid
        return True
    (own_start, outer, inner), (start, their_outer, their_inner) = map(_fine, (candidate, other))
    low = np.maximum(own_start, start)
    high = np.minimum(own_start + outer.shape, start + their_outer.shape)
    if (low >= high).any():
        return False
    own, their = (tuple(map(slice, low - at, high - at)) for at in (own_start, start))
    return bool(
        (inner[own] & their_outer[their]).any()
        or (outer[own] & their_inner[their]).any()
        or collides(candidate, other)
        or contains(candidate, other)
    )


def _near(item: Item, other: ItemInBox, nodes: Triple) -> Mask:
    """Find the locations at which an item's cell box overlaps that of another; all if off it."""
    if not isinstance(other, PlacedItem):
        return np.ones(nodes, dtype=bool)
    x, y, z = (
        (STEP * np.arange(n) < stop) & (STEP * np.arange(n) + cells > start)
        for n, cells, start, stop in zip(nodes, item.cells, other.start, other.stop, strict=True)
    )
    return np.asarray(x[:, None, None] & y[:, None] & z)


def _boxes_overlap(a: PlacedItem, b: PlacedItem) -> bool:
    return all(
        a_start < b_stop and b_start < a_stop
        for a_start, a_stop, b_start, b_stop in zip(a.start, a.stop, b.start, b.stop, strict=True)
    )


def _are_apart(a: ItemInBox, b: ItemInBox) -> bool:
    """Return whether no fine cell can belong to both items: their bounding boxes are far apart."""
    first, second = a.vertices, b.vertices
    gap = np.maximum(first.min(axis=0) - second.max(axis=0), second.min(axis=0) - first.max(axis=0))
    return bool((gap > 2 * FINE).any())


def _fine(placed: ItemInBox) -> _Fine:
    """Voxelize an item: where its words begin in the box, and the words from there on."""
    if isinstance(placed, PlacedItem):
        return np.multiply(placed.location, _WORDS_PER_STEP), *_of_item(placed.item)
    return _off_grid(placed)


def _words(cells: Mask) -> Words:
    """Pack fine cells from a grid node on: those of each grid step along z into an integer."""
    missing = -cells.shape[2] % _FINE_PER_STEP
    return np.packbits(np.pad(cells, ((0, 0), (0, 0), (0, missing))), axis=2).view(np.uint16)


@bounded_cache(
    "whole fine arrays",
    FINE_CELLS_BUDGET,
    "bytes",
    size=lambda fine: fine[0].nbytes + fine[1].nbytes,
    key=operator.attrgetter("key"),
)
def _of_item(item: Item) -> tuple[Words, Words]:
    return _words(item.voxels.outer_fine), _words(item.voxels.inner_fine)


@bounded_cache(
    "whole fine arrays off the grid",
    FINE_CELLS_BUDGET,
    "bytes",
    size=lambda fine: fine[1].nbytes + fine[2].nbytes,
    key=lambda placed: (placed.item.key, placed.matrix.tobytes()),
)
def _off_grid(placed: ItemInBox) -> _Fine:
    start, touched, reached = lattice_cells(triangles(placed))  # it is a grid node
    outer, inner = unpack(~reached), unpack(~(touched | reached))
    return np.multiply(start // STEP, _WORDS_PER_STEP), _words(outer), _words(inner)
