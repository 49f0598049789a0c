"""Placed items, and the cells and fine cells of a box that they fill."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import cached_property
from packit_sim.engine.occupancy_kernels import NO_PAGE, fill, unfill
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import CELL, STEP, Triple, grid_nodes
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import Voxels

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
    """

    def __init__(self, cells: Triple) -> None:
        self.cells = cells
        count = math.prod(grid_nodes(cells))
        self.bricks: Words = np.zeros((count, 2), dtype=np.uint64)
        self.page = np.full(count, NO_PAGE, dtype=np.int32)
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
        """(n, 3): where each placed item begins in the `PlacedArrays`."""
        return self._starts.array[: self._starts.count]

    @property
    def arrays(self) -> tuple[Any, ...]:
        """The fields of the box's `BoxArrays`."""
        nx, ny, _ = grid_nodes(self.cells)
        return self.bricks, self.page, self.fine, nx, ny

    @property
    def placed_arrays(self) -> tuple[Any, ...]:
        """The fields of the box's `PlacedArrays`."""
        return (self.spans, self.starts, *(stack.array for stack in self._hosts))

    @property
    def outer_words(self) -> Words:
        """Words [x, y, z] over the box's bricks: their outer cells."""
        x, y, z = grid_nodes(self.cells)
        return self.bricks[:, 0].reshape(z, x, y).transpose(1, 2, 0)

    def add(self, placed: _Filling) -> None:
        """Fills the cells of an item. Whether it is feasible there was checked before."""
        voxels = placed.voxels
        self._pages.reserve(len(voxels.bricks))
        start = self._brick_number(placed.location)
        pages, words, shared = fill(self.arrays, self._pages.count, voxels.arrays, start)
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
            self.page.fill(NO_PAGE)
            self._pages.count = 0
            self._placed.clear()
            self._before.clear()
        while len(self._placed) > count:
            gone = self._placed.pop()
            self._pages.count, words, shared = self._before.pop()
            start = self._brick_number(gone.location)
            unfill(self.arrays, self._pages.count, gone.voxels.bricks, start, words, shared)

    def _brick_number(self, location: Triple) -> int:
        nx, ny, _ = grid_nodes(self.cells)
        i, j, k = location
        return (k * nx + i) * ny + j
