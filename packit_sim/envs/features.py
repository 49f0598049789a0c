"""PackNN's voxel features: mean occupancies of small cubes (paper, section 4.2).

Counted from words of cells, and for a box from the words that changed: not from all its cells.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache
from packit_sim.envs.feature_kernels import add_cells, update_counts
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item

Means = npt.NDArray[np.float32]

ITEMS_BUDGET = 64 * 2**20
"""Bytes of kept means of items: at 2 kB each those of all the tasks of a training."""


class CubeMeans:
    """Divides a grid of so many cells an axis into cubes, as nearly alike as can be."""

    def __init__(self, cells: Triple, cubes: int) -> None:
        edges = [np.arange(cubes + 1) * count // cubes for count in cells]
        self.grid = cells, cubes
        self._bins = np.zeros((3, max(cells)), dtype=np.int64)
        for axis, (ends, count) in enumerate(zip(edges, cells, strict=True)):
            self._bins[axis, :count] = np.searchsorted(ends, np.arange(count), side="right") - 1
        x, y, z = (np.diff(ends) for ends in edges)
        self._sizes = (x[:, None, None] * y[:, None] * z).astype(np.float32)

    def of_item(self, item: Item) -> Means:
        """(cubes, cubes, cubes) share of outer cells, of an item in the middle of the grid.

        Read-only: kept, so that an item's voxels are not made anew for each episode.
        """
        return _of_item(self, item)

    def count(self, item: Item) -> Means:
        """What `of_item` keeps."""
        voxels = item.voxels
        counts = np.zeros(self._sizes.shape, dtype=np.int32)
        corner = (np.array(self.grid[0]) - voxels.cells) // 2
        add_cells(voxels.outer, voxels.bricks, corner, self._bins, counts)
        means = counts.astype(np.float32) / self._sizes
        means.setflags(write=False)
        return means

    def of_box(self, words: Words, before: Words, counts: npt.NDArray[np.int32]) -> Means:
        """(cubes, cubes, cubes) share of outer cells, of a box with these words [x, y, z].

        before, counts: of the last time; they are brought up to date. Both are 0 at first.
        """
        update_counts(words, before, self._bins, counts)
        return counts.astype(np.float32) / self._sizes


@bounded_cache(
    "item features",
    ITEMS_BUDGET,
    "bytes",
    size=lambda means: means.nbytes,
    key=lambda means, item: (means.grid, item.key),
)
def _of_item(means: CubeMeans, item: Item) -> Means:
    return means.count(item)
