"""The cells and fine cells of a box that are occupied by its items."""

from __future__ import annotations

import math
from typing import Any, Generic

import numpy as np
import numpy.typing as npt

from packit_sim.core.debugging import is_checking
from packit_sim.engine.occupancy_kernels import NO_PAGE, PlacedArrays, append, fill, unfill
from packit_sim.geometry.bits import Words
from packit_sim.geometry.items import ItemT, PlacedItem, triangles
from packit_sim.geometry.lattice import Triple, grid_nodes
from packit_sim.geometry.voxels import Voxels

_FIRST_PAGES = 8192
"""Pages for which a box has space at first, enough for most tasks; memory is taken by use."""


def _with_space(array: npt.NDArray[Any], used: int, rows: int) -> npt.NDArray[Any]:
    """Return an array, or a copy of its used rows with more rows if it has too few."""
    if rows <= len(array):
        return array
    grown = np.empty((2 * rows, *array.shape[1:]), dtype=array.dtype)
    grown[:used] = array[:used]
    return grown


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
        (2, n) uint64, the outer and the inner cells of each brick, the union over the placed items.
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
        self.bricks: Words = np.zeros((2, count), dtype=np.uint64)
        self.page = np.full(count, NO_PAGE, dtype=np.int32)
        self._pages = 0
        self.fine: Words = np.empty((_FIRST_PAGES, 64, 2), dtype=np.uint64)
        self._placed: list[ItemT] = []
        self._voxels: list[tuple[Triple, Voxels]] = []
        bricks = 2 * _FIRST_PAGES
        self._joined = PlacedArrays(
            spans=np.empty((64, 6), dtype=np.int64),
            starts=np.zeros((64, 3), dtype=np.int64),
            number=np.empty(bricks, dtype=np.int32),
            outer=np.empty(bricks, dtype=np.uint64),
            inner=np.empty(bricks, dtype=np.uint64),
            first=np.empty(bricks, dtype=np.int32),
            fine=np.empty((8 * bricks, 2), dtype=np.uint64),
        )
        self._before: list[tuple[int, Words, Words]] = []
        self._arrays: tuple[Any, ...] = ()

    @property
    def placed(self) -> tuple[ItemT, ...]:
        return tuple(self._placed)

    @property
    def spans(self) -> npt.NDArray[np.int64]:
        """First and last brick of each placed item along x, y and z: (n, 6)."""
        return self._joined.spans[: len(self._placed)]

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
        return self.spans, *self._joined[1:]

    @property
    def outer_words(self) -> Words:
        """Outer cells of the box's bricks: words [x, y, z]."""
        x, y, z = grid_nodes(self.cells)
        return self.bricks[0].reshape(z, x, y).transpose(1, 2, 0)

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
        self._make_space(voxels)
        start = self._brick_number(location)
        pages, words, shared = fill(self.arrays, self._pages, voxels.arrays, start)
        self._before.append((self._pages, words, shared))
        self._pages = pages
        append(tuple(self._joined), len(self._placed), voxels.fixed_arrays, location)
        self._placed.append(placed)
        self._voxels.append((location, voxels))
        if is_checking():
            self._assert_same_as_rebuilt()

    def truncate(self, count: int) -> None:
        """Remove all but the first `count` items."""
        if count == 0:
            self.bricks.fill(0)
            self.page.fill(NO_PAGE)
            self._pages = 0
            self._placed.clear()
            self._voxels.clear()
            self._before.clear()
        while len(self._placed) > count:
            self._placed.pop()
            self._pages, words, shared = self._before.pop()
            location, voxels = self._voxels.pop()
            start = self._brick_number(location)
            unfill(self.arrays, self._pages, voxels.bricks, start, words, shared)
        if is_checking():
            self._assert_same_as_rebuilt()

    def _make_space(self, voxels: Voxels) -> None:
        """Grow the arrays so that there is space for the voxels of one more item."""
        placed, bricks = len(self._placed), len(voxels.bricks)
        self.fine = _with_space(self.fine, self._pages, self._pages + bricks)
        numbers, first, cells = self._joined.starts[placed].tolist()
        arrays: tuple[npt.NDArray[Any], ...] = self._joined
        used = placed, placed + 1, numbers, first, first, first, cells
        more = 1, 1, voxels.number.size, bricks, bricks, bricks, len(voxels.fine)
        self._joined = PlacedArrays(
            *(
                _with_space(array, count, count + rows)
                for array, count, rows in zip(arrays, used, more, strict=True)
            )
        )

    def _assert_same_as_rebuilt(self) -> None:
        """Compare all arrays with those that the voxels of the items result in, without kernels."""
        count = len(self._placed)
        assert len(self._voxels) == len(self._before) == count
        used = np.sort(self.page[self.page != NO_PAGE])
        assert np.array_equal(used, np.arange(self._pages)), "each page belongs to one brick"
        bricks, fine = np.zeros_like(self.bricks), np.zeros((2, 64 * self._pages), np.uint64)
        pages = np.full_like(self.page, NO_PAGE)
        for location, voxels in self._voxels:
            x, y, z = voxels.bricks.T.astype(np.int64)
            at = self._brick_number(location) + self._brick_number((x, y, z))
            bricks[0, at] |= voxels.outer
            bricks[1, at] |= voxels.inner
            brick, bit = _bits(voxels.outer & ~voxels.inner)
            page = self.page[at]
            pages[at[np.diff(voxels.first) > 0]] = page[np.diff(voxels.first) > 0]
            cell = 64 * page[brick] + bit
            fine[0, cell] |= voxels.fine[:, 0]
            fine[1, cell] |= voxels.fine[:, 1]
        assert np.array_equal(self.page, pages), "bricks have pages where items have surfaces"
        assert np.array_equal(self.bricks, bricks), "the cells are the union of those of the items"
        brick, bit = _bits(bricks[0] & ~bricks[1])
        cell = 64 * self.page[brick] + bit
        for n in range(2):
            kept = self.fine[: self._pages, :, n].ravel()
            assert np.array_equal(kept[cell], fine[n, cell]), "so are the fine cells"
        self._assert_joined()

    def _assert_joined(self) -> None:
        """Compare the joined voxels with those of the items, one after the other."""
        spans, starts, *joined = self.placed_arrays
        ends = np.zeros(3, dtype=np.int64)
        for n, (location, voxels) in enumerate(self._voxels):
            words = voxels.outer, voxels.inner, voxels.first[:-1], voxels.fine
            own: list[npt.NDArray[Any]] = [voxels.number.ravel(), *words]
            begins = ends[[0, 1, 1, 1, 2]].tolist()
            for array, begin, expected in zip(joined, begins, own, strict=True):
                assert np.array_equal(array[begin : begin + len(expected)], expected)
            assert np.array_equal(starts[n], ends)
            ends += len(own[0]), len(own[1]), len(own[4])
            last = np.add(location, voxels.number.shape) - 1
            assert np.array_equal(spans[n], np.append(location, last))
        assert np.array_equal(starts[len(self._placed)], ends)

    def _brick_number(self, location: Any) -> Any:
        nx, ny, _ = grid_nodes(self.cells)
        i, j, k = location
        return (k * nx + i) * ny + j


def _voxels(placed: Any, cells: Triple) -> tuple[Triple, Voxels]:
    """Look up or compute the voxels of an item in a box, and the grid node where they begin."""
    if isinstance(placed, PlacedItem):
        return placed.location, placed.item.voxels
    return Voxels.in_box(triangles(placed), cells)


def _bits(words: Words) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """List the bits of words that are set, in order: the numbers of the words and of the bits."""
    number = np.flatnonzero(words)
    bits = np.unpackbits(words[number].view(np.uint8), bitorder="little").view(np.bool_)
    word, bit = np.divmod(np.flatnonzero(bits), 64)
    return number[word], bit
