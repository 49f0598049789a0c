"""Placed items, and the cells and fine cells of a box that they fill."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import cached_property
from packit_sim.core.compilation import kernel
from packit_sim.geometry.bits import Words, lowest_bit
from packit_sim.geometry.lattice import CELL, STEP, Triple, grid_nodes
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import Voxels

_1 = np.uint64(1)
_NO_PAGE = -1
_INDICES = np.empty(0, dtype=np.int32)


class ItemInBox(Protocol):
    """An item somewhere in a box, on the grid or off it.

    center: (3,) of its bounding box before it was turned off the grid, and vertices: (n, 3) of its
    mesh, in box units. pose: (4, 4) shape-to-box matrix.
    """

    @property
    def item(self) -> Item: ...
    @property
    def center(self) -> npt.NDArray[np.float64]: ...
    @property
    def pose(self) -> npt.NDArray[np.float64]: ...
    @property
    def vertices(self) -> npt.NDArray[np.float64]: ...


class Load(Protocol):
    """A box by what is in it, on the grid or off it, and its cells an axis."""

    @property
    def cells(self) -> Triple: ...
    @property
    def placed(self) -> Sequence[ItemInBox]: ...


class Filling(Protocol):
    """What fills cells of a box: bricks, from a grid node on."""

    @property
    def location(self) -> Triple: ...
    @property
    def voxels(self) -> Voxels: ...


_Filling = TypeVar("_Filling", bound=Filling)


@dataclass(frozen=True)
class PlacedItem:
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

    @property
    def vertices(self) -> npt.NDArray[np.float64]:
        """(n, 3) of its mesh, in box units."""
        return np.asarray(self.item.mesh.vertices + self.center)

    @property
    def voxels(self) -> Voxels:
        """Of the item."""
        return self.item.voxels


class Stack:
    """Rows one after the other, with room for more. array: its first `count` rows are in use."""

    def __init__(self, like: npt.NDArray[Any]) -> None:
        self.array = np.empty((64, *like.shape[1:]), dtype=like.dtype)
        self.count = 0

    def reserve(self, rows: int) -> None:
        """Makes room for so many more."""
        count = self.count + rows
        if count > len(self.array):
            grown = np.empty((2 * count, *self.array.shape[1:]), dtype=self.array.dtype)
            grown[: self.count] = self.array[: self.count]
            self.array = grown

    def push(self, rows: npt.NDArray[Any]) -> None:
        self.reserve(len(rows))
        self.array[self.count : self.count + len(rows)] = rows
        self.count += len(rows)


class Occupancy(Generic[_Filling]):
    """The cells of a box that placed items fill: a cache, rebuilt from `placed` at any time.

    Placed are items on the grid (`PlacedItem`), or what stands for bodies off it (`bodies.Filled`).

    Bricks (see `voxels`) are in the order of bottom-left-back fill, so that a scan in that order
    reads neighbours: number `(k * nx + i) * ny + j` for the brick at node (i, j, k).
    bricks: (n, 2) words, each brick's outer and inner cells, the union over the placed items.
    page: (n,) int32, where `fine` has a brick's fine cells, -1 for none.
    fine: (pages, 64, 2) words, the outer and the inner fine cells of a brick's cells; only those
    of cells that are outer and not inner are kept, what is in the others means nothing.
    hosts: the placed items' own voxels (see `Voxels`), one after the other: number (flat), outer,
    inner, first and fine. starts: (n, 3), where an item's begin in number, in outer and in fine.
    """

    def __init__(self, cells: Triple) -> None:
        self.cells = cells
        count = math.prod(grid_nodes(cells))
        self.bricks: Words = np.zeros((count, 2), dtype=np.uint64)
        self.page = np.full(count, _NO_PAGE, dtype=np.int32)
        self._pages = Stack(np.empty((0, 64, 2), dtype=np.uint64))
        self._placed: list[_Filling] = []
        self._spans = Stack(np.empty((0, 6), dtype=np.int64))
        self._starts = Stack(np.empty((0, 3), dtype=np.int64))
        words: Words = np.empty(0, dtype=np.uint64)
        self._hosts = tuple(
            Stack(like) for like in (_INDICES, words, words, _INDICES, words.reshape(0, 2))
        )
        self._before: list[tuple[int, Words, Words]] = []

    @property
    def placed(self) -> tuple[_Filling, ...]:
        return tuple(self._placed)

    @property
    def fine(self) -> Words:
        return self._pages.array

    @property
    def spans(self) -> npt.NDArray[np.int64]:
        """(n, 6): the first and the last brick, along x, y and z, of each placed item."""
        return self._spans.array[: self._spans.count]

    @property
    def starts(self) -> npt.NDArray[np.int64]:
        return self._starts.array[: self._starts.count]

    @property
    def hosts(self) -> tuple[npt.NDArray[Any], ...]:
        return tuple(stack.array for stack in self._hosts)

    @property
    def outer_words(self) -> Words:
        """Words [x, y, z] over the box's bricks: their outer cells."""
        x, y, z = grid_nodes(self.cells)
        return self.bricks[:, 0].reshape(z, x, y).transpose(1, 2, 0)

    def add(self, placed: _Filling) -> None:
        """Fills the cells of an item. Whether it is feasible there was checked before."""
        voxels = placed.voxels
        self._pages.reserve(len(voxels.bricks))
        pages, words, shared = _fill(
            self.bricks,
            self.page,
            self.fine,
            self._pages.count,
            *self._brick_numbers(placed),
            voxels.outer,
            voxels.inner,
            voxels.first,
            voxels.fine,
        )
        self._before.append((self._pages.count, words, shared))
        self._pages.count = pages
        number, outer, _, _, fine = self._hosts
        self._starts.push(np.array([(number.count, outer.count, fine.count)]))
        extent = np.array(voxels.number.shape) - 1
        self._spans.push(np.array([(*placed.location, *(placed.location + extent))]))
        own: tuple[npt.NDArray[Any], ...] = (
            voxels.number.ravel(),
            voxels.outer,
            voxels.inner,
            voxels.first[:-1],
            voxels.fine,
        )
        for stack, rows in zip(self._hosts, own, strict=True):
            stack.push(rows)
        self._placed.append(placed)

    def truncate(self, count: int) -> None:
        """Takes out all but the first `count` items."""
        if count < len(self._placed):
            number, bricks, fine = self._starts.array[count].tolist()
            for stack, kept in zip(
                (self._spans, self._starts, *self._hosts),
                (count, count, number, bricks, bricks, bricks, fine),
                strict=True,
            ):
                stack.count = kept
        if count == 0:
            self.bricks.fill(0)
            self.page.fill(_NO_PAGE)
            self._pages.count = 0
            self._placed.clear()
            self._before.clear()
        while len(self._placed) > count:
            gone = self._placed.pop()
            self._pages.count, words, shared = self._before.pop()
            _unfill(
                self.bricks,
                self.page,
                self.fine,
                self._pages.count,
                *self._brick_numbers(gone),
                words,
                shared,
            )

    def _brick_numbers(self, placed: _Filling) -> tuple[npt.NDArray[np.int16], int, int, int]:
        """What tells the kernels where in the box an item's bricks are."""
        nx, ny, _ = grid_nodes(self.cells)
        i, j, k = placed.location
        return placed.voxels.bricks, (k * nx + i) * ny + j, nx, ny


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
