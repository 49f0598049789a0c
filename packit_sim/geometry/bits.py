"""Words of 4 x 4 x 4 bits: bit `16 * x + 4 * y + z` is the place (x, y, z).

A cell's 64 fine cells are one such word, and so are the 64 cells of a brick.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from packit_sim.geometry import rotations

Words = npt.NDArray[np.uint64]

FULL = np.uint64(0xFFFF_FFFF_FFFF_FFFF)

STRIDES: npt.NDArray[np.int64] = np.array((16, 4, 1))
"""Distance in bits of neighbours along x, y and z."""

LOW: Words = np.array(
    (0x0000_0000_0000_FFFF, 0x000F_000F_000F_000F, 0x1111_1111_1111_1111), dtype=np.uint64
)
"""The bits at place 0 along x, y and z."""

HIGH: Words = LOW << (3 * STRIDES).astype(np.uint64)
"""The bits at place 3 along x, y and z."""

for _table in (STRIDES, LOW, HIGH):
    _table.setflags(write=False)


@cache
def turning_swaps(rotation: int) -> Words:
    """Compute how the bits of a word move under one of the 24 rotations.

    Parameters
    ----------
    rotation : int
        Index of the rotation, 0 to 23.

    Returns
    -------
    Words
        (n, 2) uint64, read-only. Each row is a shift and a mask: the bits in the mask are exchanged
        with those that are `shift` places higher.

    Notes
    -----
    A rotation exchanges and complements some of the six bits of a place's number. Each of these
    steps exchanges bits of the word that are a fixed distance apart.
    """
    axes, signs = rotations.AXES[rotation].tolist(), rotations.SIGNS[rotation].tolist()
    number = np.arange(64)
    swaps: list[tuple[int, npt.NDArray[np.bool_]]] = []
    now = [0, 1, 2]
    for d in range(3):
        other = now.index(axes[d])
        if other != d:
            for half in (1, 2):
                high, low = int(STRIDES[d]) * half, int(STRIDES[other]) * half
                swaps.append((high - low, (number & high == 0) & (number & low != 0)))
            now[d], now[other] = now[other], now[d]
    for d in range(3):
        if signs[d] < 0:
            for half in (1, 2):
                distance = int(STRIDES[d]) * half
                swaps.append((distance, number & distance == 0))
    table = np.zeros((len(swaps), 2), dtype=np.uint64)
    for n, (shift, places) in enumerate(swaps):
        table[n] = shift, np.bitwise_or.reduce(np.uint64(1) << number[places].astype(np.uint64))
    table.setflags(write=False)
    return table
