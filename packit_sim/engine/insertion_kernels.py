"""Kernels that compare the columns of fine cells of an item with those of a box.

For an item that moves straight down, a column of fine cells matters only by its ends: the bottom of
the item's lowest fine cell and the top of the highest one in the box. Differences of these bound
the item's height from both sides (the kinematic rule, see `insertion`): below the lower bound cells
prove that something is above the item, from the upper bound on that nothing is. Meshes decide
between them. All of it is integer arithmetic, and exact.

Columns without fine cells have the ends `NONE` and -`NONE`, so that they never are the maximum.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel
from packit_sim.geometry.lattice import FINE_PER_CELL, STEP
from packit_sim.geometry.word_kernels import lowest_bit

NONE = np.int32(2**20)
"""Higher than any fine cell: the value of an empty column; sums of two fit in 32 bits."""

_FINE_PER_STEP = STEP * FINE_PER_CELL

_COLUMN = np.uint64(15)
"""The bits of a word's first column (see `bits`)."""

_TOP_OF_BITS = np.array([int(bits).bit_length() for bits in range(16)])


@kernel
def column_ends(words):
    """Return the bottom of the lowest bit and the top of the highest in columns of words."""
    low = np.full((4 * words.shape[0], 4 * words.shape[1]), NONE, np.int32)
    high = np.full(low.shape, -NONE, np.int32)
    for x, y, z in np.ndindex(words.shape):
        word = words[x, y, z]
        if not word:
            continue
        for column in range(16):
            bits = word >> np.uint64(4 * column) & _COLUMN
            if bits:
                at = 4 * x + column // 4, 4 * y + column % 4
                low[at] = min(low[at], 4 * z + lowest_bit(bits))
                # Words come in the order of z: the last one that has bits is the highest.
                high[at] = 4 * z + _TOP_OF_BITS[bits]
    return low, high


@kernel
def required_heights(low, inner_low, tops, inner_tops, wanted):
    """Return the heights at which fine cells decide whether an item is clear.

    Parameters
    ----------
    low : ndarray
        int32 (x, y), see `insertion.Columns`.
    inner_low : ndarray
        int32 (x, y), see `insertion.Columns`.
    tops : ndarray
        int32 (x, y), tops of the highest outer fine cells in the box's columns.
    inner_tops : ndarray
        The same for inner fine cells.
    wanted : ndarray
        Bool (i, j), the nodes to compute.

    Returns
    -------
    no, yes : ndarray
        int64 (i, j), in fine cells: below `no` the item is not clear, from `yes` on it is; between
        them it is open.
    """
    step = _FINE_PER_STEP
    no = np.full(wanted.shape, -NONE, np.int64)
    yes = np.full(wanted.shape, -NONE, np.int64)
    for i, j in np.ndindex(wanted.shape):
        if not wanted[i, j]:
            continue
        width = min(low.shape[0], tops.shape[0] - i * step)
        depth = min(low.shape[1], tops.shape[1] - j * step)
        refused = granted = -NONE
        for x in range(width):
            for y in range(depth):
                top, inner_top = (
                    tops[i * step + x, j * step + y],
                    inner_tops[i * step + x, j * step + y],
                )
                granted = max(granted, top - low[x, y])
                # Inner above outer, or outer above inner, is a proof; outer above outer is none.
                refused = max(refused, top - inner_low[x, y], inner_top - low[x, y])
        no[i, j], yes[i, j] = refused, granted
    return no, yes
