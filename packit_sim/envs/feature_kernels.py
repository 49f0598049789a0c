"""Kernels that count the filled cells of cubes (see `features.CubeMeans`)."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel
from packit_sim.geometry.word_kernels import lowest_bit

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
def update_counts(words, before, bins, counts):
    """Update the counts of cubes by the cells that changed since `before`, and then `before`."""
    nx, ny, nz = words.shape
    for z in range(nz):  # the order in which a box keeps its words
        for x in range(nx):
            for y in range(ny):
                changed = words[x, y, z] ^ before[x, y, z]
                if not changed:
                    continue
                while changed:
                    bit = lowest_bit(changed)
                    changed &= changed - _1
                    change = 1 if words[x, y, z] >> np.uint64(bit) & _1 else -1
                    counts[
                        bins[0, 4 * x + (bit >> 4)],
                        bins[1, 4 * y + (bit >> 2 & 3)],
                        bins[2, 4 * z + (bit & 3)],
                    ] += change
                before[x, y, z] = words[x, y, z]
