"""The cells and fine cells of a box that are occupied by its items."""

from __future__ import annotations

import math
from typing import Any, Generic

import numpy as np
import numpy.typing as npt

from packit_sim.engine.occupancy_kernels import NO_PAGE, fill, unfill
from packit_sim.geometry.bits import Words
from packit_sim.geometry.items import ItemT, PlacedItem, triangles
from packit_sim.geometry.lattice import Triple, grid_nodes
from packit_sim.geometry.voxels import Voxels

_INDICES = np.empty(0, dtype=np.int32)

_FIRST_PAGES = 8192
"""Pages for which a box has space at first, enough for most tasks; memory is taken by use."""


class Stack:
    """An array of rows that can grow.

    Parameters
    ----------
    like : ndarray
        An array with the shape and the type of the rows.
    rows : int
        Number of rows for which there is space at first.

    Attributes
    ----------
    array : ndarray
        The rows; the first `count` are in use.
    count : int
        Number of rows in use.
    """

    def __init__(self, like: npt.NDArray[Any], rows: int) -> None:
        self.array = np.empty((rows, *like.shape[1:]), dtype=like.dtype)
        self.count = 0

    def reserve(self, rows: int) -> None:
        """Grow the array so that it has space for more rows."""
        count = self.count + rows
        if count > len(self.array):
            grown = np.empty((2 * count, *self.array.shape[1:]), dtype=self.array.dtype)
            grown[: self.count] = self.array[: self.count]
            self.array = grown

    def push(self, rows: npt.NDArray[Any]) -> None:
        end = self.count + len(rows)
        if end > len(self.array):
            self.reserve(len(rows))
        self.array[self.count : end] = rows
        self.count = end


class Occupancy(Generic[ItemT]):
    """The occupied cells of a box: a cache that can be rebuilt from `placed` at any time.

    An item on the grid occupies its own voxels. An item off the grid is voxelized in the box's
    lattice; the part of it that is outside the box occupies nothing.

    Parameters
    ----------
    cells : Triple
        The cells of the box along x, y and z.

    Attributes
    ----------
    bricks : Words
        (n, 2) uint64, each brick's outer and inner cells, the union over the placed items.
    page : ndarray
        (n,) int32, the index in `fine` of a brick's fine cells, -1 for none.
    fine : Words
        (pages, 64, 2) uint64, the outer and the inner fine cells of a brick's cells. Only the rows
        of cells that are outer and not inner are defined.

    Notes
    -----
    Bricks (see `voxels`) are in the order of bottom-left-back fill, so that a scan in that order
    reads neighbours: the brick at node (i, j, k) has the number `(k * nx + i) * ny + j`.
    """

    def __init__(self, cells: Triple) -> None:
        self.cells = cells
        count = math.prod(grid_nodes(cells))
        self.bricks: Words = np.zeros((count, 2), dtype=np.uint64)
        self.page = np.full(count, NO_PAGE, dtype=np.int32)
        self._pages = Stack(np.empty((0, 64, 2), dtype=np.uint64), _FIRST_PAGES)
        self._placed: list[ItemT] = []
        self._voxels: list[tuple[Triple, Voxels]] = []
        self._spans = Stack(np.empty((0, 6), dtype=np.int64), 64)
        self._starts = Stack(np.empty((0, 3), dtype=np.int64), 64)
        words: Words = np.empty(0, dtype=np.uint64)
        self._voxel_stacks = tuple(
            Stack(like, rows * _FIRST_PAGES)
            for like, rows in (
                (_INDICES, 2),
                (words, 2),
                (words, 2),
                (_INDICES, 2),
                (words.reshape(0, 2), 16),
            )
        )
        self._before: list[tuple[int, Words, Words]] = []
        self._arrays: tuple[Any, ...] = ()

    @property
    def placed(self) -> tuple[ItemT, ...]:
        return tuple(self._placed)

    @property
    def fine(self) -> Words:
        return self._pages.array

    @property
    def spans(self) -> npt.NDArray[np.int64]:
        """First and last brick of each placed item along x, y and z: (n, 6)."""
        return self._spans.array[: self._spans.count]

    @property
    def starts(self) -> npt.NDArray[np.int64]:
        """Where each placed item begins in the `PlacedArrays`: (n, 3)."""
        return self._starts.array[: self._starts.count]

    @property
    def arrays(self) -> tuple[Any, ...]:
        """The fields of the box's `BoxArrays`."""
        if not self._arrays or self._arrays[2] is not self.fine:
            nx, ny, _ = grid_nodes(self.cells)
            self._arrays = self.bricks, self.page, self.fine, nx, ny
        return self._arrays

    @property
    def placed_arrays(self) -> tuple[Any, ...]:
        """The fields of the box's `PlacedArrays`."""
        return (self.spans, self.starts, *(stack.array for stack in self._voxel_stacks))

    @property
    def outer_words(self) -> Words:
        """Outer cells of the box's bricks: words [x, y, z]."""
        x, y, z = grid_nodes(self.cells)
        return self.bricks[:, 0].reshape(z, x, y).transpose(1, 2, 0)

    def add(self, placed: ItemT) -> None:
        """Add the cells of an item, whether or not it is feasible there.

        Parameters
        ----------
        placed : ItemInBox
            The item, on the grid or off it.

        Raises
        ------
        ArgumentError
            If an item off the grid is too large (see `voxelization.fine_cells`).
        """
        location, voxels = _voxels(placed, self.cells)
        self._pages.reserve(len(voxels.bricks))
        start = self._brick_number(location)
        pages, words, shared = fill(self.arrays, self._pages.count, voxels.arrays, start)
        self._before.append((self._pages.count, words, shared))
        self._pages.count = pages
        number, outer, _, _, fine = self._voxel_stacks
        self._starts.push(np.array([(number.count, outer.count, fine.count)]))
        extent = np.array(voxels.number.shape) - 1
        self._spans.push(np.array([(*location, *(location + extent))]))
        own: tuple[npt.NDArray[Any], ...] = (
            voxels.number.ravel(),
            voxels.outer,
            voxels.inner,
            voxels.first[:-1],
            voxels.fine,
        )
        for stack, rows in zip(self._voxel_stacks, own, strict=True):
            stack.push(rows)
        self._placed.append(placed)
        self._voxels.append((location, voxels))

    def truncate(self, count: int) -> None:
        """Remove all but the first `count` items."""
        if count < len(self._placed):
            number, bricks, fine = self._starts.array[count].tolist()
            for stack, kept in zip(
                (self._spans, self._starts, *self._voxel_stacks),
                (count, count, number, bricks, bricks, bricks, fine),
                strict=True,
            ):
                stack.count = kept
        if count == 0:
            self.bricks.fill(0)
            self.page.fill(NO_PAGE)
            self._pages.count = 0
            self._placed.clear()
            self._voxels.clear()
            self._before.clear()
        while len(self._placed) > count:
            self._placed.pop()
            self._pages.count, words, shared = self._before.pop()
            location, voxels = self._voxels.pop()
            start = self._brick_number(location)
            unfill(self.arrays, self._pages.count, voxels.bricks, start, words, shared)

    def _brick_number(self, location: Triple) -> int:
        nx, ny, _ = grid_nodes(self.cells)
        i, j, k = location
        return (k * nx + i) * ny + j


def _voxels(placed: Any, cells: Triple) -> tuple[Triple, Voxels]:
    """Look up or compute the voxels of an item in a box, and the grid node where they begin."""
    if isinstance(placed, PlacedItem):
        return placed.location, placed.item.voxels
    return Voxels.in_box(triangles(placed), cells)
