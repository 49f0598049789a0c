"""Kernels that count the filled cells of cubes (see `features.CubeMeans`).

The cubes of PackNN's features (Goyal and Deng, 2020) do not line up with bricks of 4 cells, so a
brick touches up to 4 cubes along an axis. For an item each filled cell is added to its cube. For a
box only words that changed since the last count are looked at, and their bits are counted by masks:
the intersection of a run of cells along x, y and z, each a word (`features._runs`). Counts are
integers, so that adding and removing items leaves exactly what a new count would give.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.geometry.word_kernels import count_bits, lowest_bit

_1 = np.uint64(1)


@kernel
def add_cells(words, bricks, corner, bins, counts):
    """Add the cells of bricks to the counts of the cubes that they are in."""
    for n in range(len(words)):
        x = corner[0] + 4 * bricks[n, 0]
        y = corner[1] + 4 * bricks[n, 1]
        z = corner[2] + 4 * bricks[n, 2]
        word = words[n]
        while word:
            bit = lowest_bit(word)
            word &= word - _1
            counts[
                bins[0, x + (bit >> 4)], bins[1, y + (bit >> 2 & 3)], bins[2, z + (bit & 3)]
            ] += 1


@kernel
def update_counts(words, before, first, last, runs, counts):
    """Update the counts of cubes by the cells that changed since `before`, and then `before`.

    Parameters
    ----------
    words, before, counts : ndarray
        See `features.CubeMeans.of_box`.
    first, last : ndarray
        (3,) int64, the first and the last brick along x, y and z to compare.
    runs : Words
        See `features._runs`.
    """
    for z in range(first[2], last[2] + 1):  # the order in which a box keeps its words
        for x in range(first[0], last[0] + 1):
            for y in range(first[1], last[1] + 1):
                now, old = words[x, y, z], before[x, y, z]
                if now != old:
                    before[x, y, z] = now
                    _add_change(now & ~old, old & ~now, runs[0, x], runs[1, y], runs[2, z], counts)


@inner_kernel
def _add_change(added, removed, along_x, along_y, along_z, counts):
    """Update the counts by the cells of a brick that were added and removed (see `_runs`)."""
    for i in range(4):
        if not along_x[i, 1]:
            break
        for j in range(4):
            bits = along_x[i, 1] & along_y[j, 1]
            if not bits:  # runs are listed from the first on: no more along y
                break
            for k in range(4):
                inside = bits & along_z[k, 1]
                if not inside:
                    break
                counts[along_x[i, 0], along_y[j, 0], along_z[k, 0]] += count_bits(
                    added & inside
                ) - count_bits(removed & inside)
