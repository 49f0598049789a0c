"""Placed items, and the cells and fine cells of a box that they fill."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.bits import Words, lowest_bit
from packit_sim.caches import cached_property
from packit_sim.compiled import kernel
from packit_sim.lattice import CELL, STEP, Triple, grid_nodes
from packit_sim.shapes import Item

_1 = np.uint64(1)
_NO_PAGE = -1


@dataclass(frozen=True)
class Placed:
    """An item at a location: the min corner of its cell box stands at grid node (i, j, k)."""

    item: Item
    location: Triple

    @property
    def start(self) -> Triple:
        """The min corner of the cell box, in cells."""
        i, j, k = self.location
        return i * STEP, j * STEP, k * STEP

    @property
    def stop(self) -> Triple:
        """The max corner of the cell box, in cells."""
        (x, y, z), (a, b, c) = self.start, self.item.cells
        return x + a, y + b, z + c

    @cached_property
    def center(self) -> npt.NDArray[np.float64]:
        """(3,) where the centre of the item's bounding box stands, in box units."""
        return (np.array(self.start) + np.array(self.stop)) / 2 * CELL

    @cached_property
    def pose(self) -> npt.NDArray[np.float64]:
        """(4, 4) shape-to-box matrix: puts the canonical mesh, `item.shape.mesh`, in its place."""
        pose = np.eye(4)
        pose[:3, :3] = self.item.linear
        pose[:3, 3] = self.center
        return pose


class Occupancy:
    """The cells of a box that placed items fill: a cache, rebuilt from `placed` at any time.

    Bricks (see `voxels`) are in the order of bottom-left-back fill, so that a scan in that order
    reads neighbours: number `(k * nx + i) * ny + j` for the brick at node (i, j, k).
    bricks: (n, 2) words, each brick's outer and inner cells, the union over the placed items.
    page: (n,) int32, where `fine` has a brick's fine cells, -1 for none.
    fine: (pages, 64, 2) words, the outer and the inner fine cells of a brick's cells; only those
    of cells that are outer and not inner are kept, what is in the others means nothing.
    """

    def __init__(self, cells: Triple) -> None:
        self.cells = cells
        count = math.prod(grid_nodes(cells))
        self.bricks: Words = np.zeros((count, 2), dtype=np.uint64)
        self.page = np.full(count, _NO_PAGE, dtype=np.int32)
        self.fine: Words = np.empty((0, 64, 2), dtype=np.uint64)
        self._pages = 0
        self._placed: list[Placed] = []
        self._spans = np.zeros((16, 6), dtype=np.int64)
        self._before: list[tuple[int, Words, Words]] = []

    @property
    def placed(self) -> tuple[Placed, ...]:
        return tuple(self._placed)

    @property
    def spans(self) -> npt.NDArray[np.int64]:
        """(n, 6): the first and the last brick, along x, y and z, of each placed item."""
        return self._spans[: len(self._placed)]

    @property
    def outer_words(self) -> Words:
        """Words [x, y, z] over the box's bricks: their outer cells."""
        x, y, z = grid_nodes(self.cells)
        return self.bricks[:, 0].reshape(z, x, y).transpose(1, 2, 0)

    def near(self, item: Item, locations: npt.NDArray[np.int64]) -> list[Placed]:
        """The placed items that an item can meet at one of some locations (n, 3)."""
        first, last = locations.min(axis=0), locations.max(axis=0) + item.voxels.number.shape
        meets = (self.spans[:, :3] < last) & (self.spans[:, 3:] >= first)
        return [self._placed[n] for n in np.flatnonzero(meets.all(axis=1)).tolist()]

    def add(self, placed: Placed) -> None:
        """Fills the cells of an item. Whether it is feasible there was checked before."""
        voxels = placed.item.voxels
        if self._pages + len(voxels.bricks) > len(self.fine):
            room = max(2 * len(self.fine), self._pages + len(voxels.bricks))
            grown = np.empty((room, 64, 2), dtype=np.uint64)
            grown[: self._pages] = self.fine[: self._pages]
            self.fine = grown
        pages, words, shared = _fill(
            self.bricks,
            self.page,
            self.fine,
            self._pages,
            *self._brick_numbers(placed),
            voxels.outer,
            voxels.inner,
            voxels.first,
            voxels.fine,
        )
        self._before.append((self._pages, words, shared))
        self._pages = pages
        count = len(self._placed)
        if count == len(self._spans):
            self._spans = np.concatenate([self._spans, np.zeros_like(self._spans)])
        extent = np.array(voxels.number.shape) - 1
        self._spans[count] = (*placed.location, *(placed.location + extent))
        self._placed.append(placed)

    def truncate(self, count: int) -> None:
        """Takes out all but the first `count` items."""
        if count == 0:
            self.bricks.fill(0)
            self.page.fill(_NO_PAGE)
            self._pages = 0
            self._placed.clear()
            self._before.clear()
        while len(self._placed) > count:
            gone = self._placed.pop()
            self._pages, words, shared = self._before.pop()
            _unfill(
                self.bricks,
                self.page,
                self.fine,
                self._pages,
                *self._brick_numbers(gone),
                words,
                shared,
            )

    def _brick_numbers(self, placed: Placed) -> tuple[npt.NDArray[np.int16], int, int, int]:
        """What tells the kernels where in the box an item's bricks are."""
        nx, ny, _ = grid_nodes(self.cells)
        i, j, k = placed.location
        return placed.item.voxels.bricks, (k * nx + i) * ny + j, nx, ny


@kernel
def _fill(box, page, box_fine, pages, bricks, start, nx, ny, outer, inner, first, fine):
    """Adds an item; returns the pages in use, and what it takes to go back.

    That is the words of the bricks before, and the fine cells that were another item's too: page
    times 64 plus bit, and its two words.
    """
    before = np.empty((len(bricks), 2), np.uint64)
    shared = np.empty((len(fine), 3), np.uint64)
    count = 0
    for n in range(len(bricks)):
        at = start + (bricks[n, 2] * nx + bricks[n, 0]) * ny + bricks[n, 1]
        taken = box[at, 0]
        before[n, 0], before[n, 1] = taken, box[at, 1]
        box[at, 0] |= outer[n]
        box[at, 1] |= inner[n]
        surface = outer[n] & ~inner[n]
        if not surface:
            continue
        if page[at] == _NO_PAGE:
            page[at] = pages
            pages += 1
        to = box_fine[page[at]]
        cell = first[n]
        while surface:
            bit = lowest_bit(surface)
            surface &= surface - _1
            if taken >> np.uint64(bit) & _1:
                shared[count, 0] = page[at] * 64 + bit
                shared[count, 1], shared[count, 2] = to[bit, 0], to[bit, 1]
                count += 1
                to[bit, 0] |= fine[cell, 0]
                to[bit, 1] |= fine[cell, 1]
            else:
                to[bit, 0], to[bit, 1] = fine[cell, 0], fine[cell, 1]
            cell += 1
    return pages, before, shared[:count].copy()


@kernel
def _unfill(box, page, box_fine, pages, bricks, start, nx, ny, before, shared):
    """Takes out the item added last; pages: that were in use before."""
    for n in range(len(shared)):
        at = np.int64(shared[n, 0])
        box_fine[at >> 6, at & 63, 0], box_fine[at >> 6, at & 63, 1] = shared[n, 1], shared[n, 2]
    for n in range(len(bricks)):
        at = start + (bricks[n, 2] * nx + bricks[n, 0]) * ny + bricks[n, 1]
        box[at, 0], box[at, 1] = before[n, 0], before[n, 1]
        if page[at] >= pages:
            page[at] = _NO_PAGE
