"""Kernels that count how much of an item's base rests on what is below it (see `support`).

A word of 16 bits has the fine cells of one grid step of a column, the lowest first. A place of the
base at bit n of its step is supported if one of the 16 fine cells below it is filled, or its own:
in the word below the bits from n on, in its own word the bits up to n.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.geometry.lattice import FINE_PER_CELL, STEP

_FINE_PER_STEP = STEP * FINE_PER_CELL

_COLUMN = np.uint64(15)
"""The bits of a word's first column (see `bits`)."""


@kernel
def add_columns(filled, words, x, y, k):
    """Add the outer fine cells of an item at a grid node to the columns of a box.

    Parameters
    ----------
    filled : ndarray
        uint16 (steps + 1, x, y), over the fine cells of the box's floor; the first step is that
        below the floor.
    words : ndarray
        uint64 [x, y, z], the item's outer fine cells.
    x, y, k : int
        The fine cells and the step where the item begins.
    """
    for a, b, c in np.ndindex(words.shape):
        word = words[a, b, c]
        if not word:
            continue
        step = filled[1 + k + c // STEP]
        shift = FINE_PER_CELL * (c % STEP)
        for column in range(16):
            bits = word >> np.uint64(4 * column) & _COLUMN
            if bits:
                at = x + 4 * a + column // 4, y + 4 * b + column % 4
                step[at] |= np.uint16(bits << np.uint64(shift))


@inner_kernel
def supported(filled, base, i, j, k, least, most_missing):
    """Count supported places of a base, until `least` are or more than `most_missing` are not."""
    count = missing = 0
    below, own = filled[k], filled[k + 1]
    for n in range(len(base)):
        x, y = base[n, 0] + i * _FINE_PER_STEP, base[n, 1] + j * _FINE_PER_STEP
        at = base[n, 2]
        under = np.int64(below[x, y]) >> at
        if under or np.int64(own[x, y]) & ((2 << at) - 1):
            count += 1
            if count >= least:
                break
        else:
            missing += 1
            if missing > most_missing:
                break
    return count


@kernel
def count_supported(filled, base, i, j, k):
    """Count the supported places of a base (n, 3), x, y and bit, of an item at a grid node."""
    return supported(filled, base, i, j, k, len(base) + 1, len(base))


@kernel
def remove_unsupported(mask, filled, base, least):
    """Set a mask to False where fewer than `least` places of a base are supported."""
    missing = len(base) - least
    for i, j, k in np.ndindex(mask.shape):
        if k and mask[i, j, k]:
            mask[i, j, k] = supported(filled, base, i, j, k, least, missing) >= least
