"""Kernels that add an item's cells to a box and remove the last ones again.

A box keeps the union of its items on two levels: bricks of 64 cells as words, and for bricks with
surface cells a *page* of 64 x 2 words of fine cells. Adding is an OR of words. What it overwrote is
returned, so that removing the last item restores the box exactly and cheaply: a stack (our own).

Invariants: only `fill` and `unfill` write a box. In a page, only rows of cells that are outer and
not inner for the union were written at some time; the others are undefined and must not be read.
Pages are taken in order, so that those of the last item are the highest.

Python passes arrays in plain tuples, and kernels convert them to named ones: a named tuple as an
argument would cost 2 microseconds a call.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from packit_sim.core.compilation import kernel
from packit_sim.geometry.bits import Words
from packit_sim.geometry.voxel_kernels import FixedArrays, ItemArrays
from packit_sim.geometry.word_kernels import lowest_bit

NO_PAGE = -1
"""The page of a brick that has no fine cells."""

_1 = np.uint64(1)


class BoxArrays(NamedTuple):
    """The bricks of a box.

    Attributes
    ----------
    bricks, page, fine
        See `occupancy.Occupancy`.
    nx, ny : int
        Bricks along x and y.
    """

    bricks: Words
    page: npt.NDArray[np.int32]
    fine: Words
    nx: int
    ny: int


class PlacedArrays(NamedTuple):
    """The voxels of all items in a box, concatenated.

    Attributes
    ----------
    spans : int64 (n, 6)
        First brick along x, y and z of each item, and last.
    starts : int64 (n + 1, 3)
        Index of each item's first element in `number`, in `outer` and in `fine`, and the end.
    number, outer, inner, first, fine
        See `voxels.Voxels`; `number` is flat. Only the rows of the items are in use.
    """

    spans: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int64]
    number: npt.NDArray[np.int32]
    outer: Words
    inner: Words
    first: npt.NDArray[np.int32]
    fine: Words


@kernel
def fill(box, pages, item, start):
    """Add an item to a box.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box, changed in place.
    pages : int
        Number of pages in use.
    item : ItemArrays
        The bricks of the item.
    start : int
        Number of the brick at the item's location.

    Returns
    -------
    pages : int
        Number of pages in use afterwards.
    before : Words
        (n, 2) uint64, the words of the item's bricks in the box before, for `unfill`.
    shared : Words
        (m, 3) uint64, the fine cells shared with other items, for `unfill`: page times 64 plus bit,
        and the two words before.
    """
    box, item = BoxArrays(*box), ItemArrays(*item)
    before = np.empty((len(item.bricks), 2), np.uint64)
    shared = np.empty((len(item.fine), 3), np.uint64)
    count = 0
    for n in range(len(item.bricks)):
        at = start + (item.bricks[n, 2] * box.nx + item.bricks[n, 0]) * box.ny + item.bricks[n, 1]
        taken = box.bricks[0, at]
        before[n, 0], before[n, 1] = taken, box.bricks[1, at]
        box.bricks[0, at] |= item.outer[n]
        box.bricks[1, at] |= item.inner[n]
        # Fine cells of cells that are inner are all inner: they need no page.
        surface = item.outer[n] & ~item.inner[n]
        if not surface:
            continue
        if box.page[at] == NO_PAGE:
            box.page[at] = pages
            pages += 1
        to = box.fine[box.page[at]]
        cell = item.first[n]
        while surface:
            bit = lowest_bit(surface)
            surface &= surface - _1
            # A cell that is taken has fine cells, which `unfill` needs; else the row is undefined,
            # and is overwritten instead of merged.
            if taken >> np.uint64(bit) & _1:
                shared[count, 0] = box.page[at] * 64 + bit
                shared[count, 1], shared[count, 2] = to[bit, 0], to[bit, 1]
                count += 1
                to[bit, 0] |= item.fine[cell, 0]
                to[bit, 1] |= item.fine[cell, 1]
            else:
                to[bit, 0], to[bit, 1] = item.fine[cell, 0], item.fine[cell, 1]
            cell += 1
    return pages, before, shared[:count].copy()


@kernel
def append(placed, count, fixed, location):
    """Add an item's voxels to those of `count` items before it; there is space for them.

    Parameters
    ----------
    placed : PlacedArrays
        The voxels of the items in the box, changed in place.
    count : int
        Number of the items before.
    fixed : FixedArrays
        The voxels of the item.
    location : Triple
        The item's first brick along x, y and z.
    """
    placed, fixed = PlacedArrays(*placed), FixedArrays(*fixed)
    number, bricks, cells = placed.starts[count]
    for d in range(3):
        placed.spans[count, d] = location[d]
        placed.spans[count, 3 + d] = location[d] + fixed.number.shape[d] - 1
    for m in fixed.number.flat:
        placed.number[number] = m
        number += 1
    for n in range(len(fixed.outer)):
        placed.outer[bricks] = fixed.outer[n]
        placed.inner[bricks] = fixed.inner[n]
        placed.first[bricks] = fixed.first[n]
        bricks += 1
    for n in range(len(fixed.fine)):
        placed.fine[cells, 0], placed.fine[cells, 1] = fixed.fine[n, 0], fixed.fine[n, 1]
        cells += 1
    starts = placed.starts[count + 1]
    starts[0], starts[1], starts[2] = number, bricks, cells


@kernel
def unfill(box, pages, bricks, start, before, shared):
    """Remove the item that was added last.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box, changed in place.
    pages : int
        Number of pages in use before the item was added.
    bricks : ndarray
        (n, 3) int16, see `voxels.Voxels`.
    start : int
        Number of the brick at the item's location.
    before : Words
        As returned by `fill`.
    shared : Words
        As returned by `fill`.
    """
    box = BoxArrays(*box)
    for n in range(len(shared)):
        at = np.int64(shared[n, 0])
        box.fine[at >> 6, at & 63, 0], box.fine[at >> 6, at & 63, 1] = shared[n, 1], shared[n, 2]
    for n in range(len(bricks)):
        at = start + (bricks[n, 2] * box.nx + bricks[n, 0]) * box.ny + bricks[n, 1]
        box.bricks[0, at], box.bricks[1, at] = before[n, 0], before[n, 1]
        if box.page[at] >= pages:  # taken by this item
            box.page[at] = NO_PAGE
