"""PackNN's voxel features: mean occupancies of small cubes (paper, section 4.2).

They are counted from words of cells; for a box only from the words that changed.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache
from packit_sim.game.envs.feature_kernels import add_cells, update_counts
from packit_sim.geometry.arrays import Ints
from packit_sim.geometry.bits import LOW, STRIDES, Words
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item

Means = npt.NDArray[np.float32]

ITEMS_BUDGET = 64 * 2**20
"""Bytes of kept means of items: at 2 kB each, enough for all tasks of a training."""


class CubeMeans:
    """Divides a grid of cells into cubes of almost equal size.

    Parameters
    ----------
    cells : Triple
        Cells of the grid along each axis.
    cubes : int
        Cubes along each axis.
    """

    def __init__(self, cells: Triple, cubes: int) -> None:
        edges = [np.arange(cubes + 1) * count // cubes for count in cells]
        self.grid = cells, cubes
        self._bins = np.zeros((3, max(cells)), dtype=np.int64)
        for axis, (ends, count) in enumerate(zip(edges, cells, strict=True)):
            self._bins[axis, :count] = np.searchsorted(ends, np.arange(count), side="right") - 1
        x, y, z = (np.diff(ends) for ends in edges)
        self._runs = _runs(self._bins)
        self._sizes = (x[:, None, None] * y[:, None] * z).astype(np.float32)

    def of_item(self, item: Item) -> Means:
        """Compute the share of outer cells in each cube, for an item in the middle of the grid.

        Parameters
        ----------
        item : Item
            The item, in its rotation.

        Returns
        -------
        Means
            Float32 (cubes, cubes, cubes). Read-only, because it is kept for later episodes.
        """
        return _of_item(self, item)

    def of_item_uncached(self, item: Item) -> Means:
        """Compute the same as `of_item`, without the cache."""
        voxels = item.voxels
        counts = np.zeros(self._sizes.shape, dtype=np.int32)
        corner = (np.array(self.grid[0]) - voxels.cells) // 2
        add_cells(voxels.outer, voxels.bricks, corner, self._bins, counts)
        means = counts.astype(np.float32) / self._sizes
        means.setflags(write=False)
        return means

    def of_box(
        self,
        words: Words,
        before: Words,
        counts: npt.NDArray[np.int32],
        changed: tuple[Ints, Ints],
    ) -> Means:
        """Compute the share of outer cells in each cube of a box.

        Parameters
        ----------
        words : Words
            The outer cells of the box, as words [x, y, z].
        before : Words
            The words of the last call, at first 0. They are updated.
        counts : ndarray of int32, shape (cubes, cubes, cubes)
            The filled cells at the last call, at first 0. They are updated.
        changed : tuple of ndarray of int64, shape (3,)
            The first and the last brick along x, y and z that may have changed.

        Returns
        -------
        Means
            Float32 (cubes, cubes, cubes).
        """
        update_counts(words, before, *changed, self._runs, counts)
        return counts.astype(np.float32) / self._sizes


def _runs(bins: Ints) -> Words:
    """Find the places of each brick that are in the same cube, along each axis.

    Parameters
    ----------
    bins : ndarray of int64, shape (3, cells)
        The cube of each cell along x, y and z, never decreasing.

    Returns
    -------
    Words
        (3, bricks, 4, 2) runs of places: the number of a cube, and the bits of a word that are in
        it; 0 bits after the last run.
    """
    bricks = bins.shape[1] // 4
    runs = np.zeros((3, bricks, 4, 2), dtype=np.uint64)
    for axis, brick in np.ndindex(3, bricks):
        cubes = bins[axis, 4 * brick : 4 * brick + 4]
        for n, cube in enumerate(np.unique(cubes)):
            bits = [
                LOW[axis] << np.uint64(p * STRIDES[axis]) for p in np.flatnonzero(cubes == cube)
            ]
            runs[axis, brick, n] = cube, np.bitwise_or.reduce(bits)
    return runs


@bounded_cache(
    "item features",
    ITEMS_BUDGET,
    "bytes",
    size=lambda means: means.nbytes,
    key=lambda means, item: (means.grid, item.key),
)
def _of_item(means: CubeMeans, item: Item) -> Means:
    return means.of_item_uncached(item)
