"""Kernels that count contacts of cells in parallel (see `contacts`)."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel
from packit_sim.geometry.bits import FULL, HIGH, LOW
from packit_sim.geometry.word_kernels import count_bits

_X, _Y, _Z = np.uint64(16), np.uint64(4), np.uint64(1)
"""Distances in bits between neighbours along x, y and z in a word."""

_ACROSS_X, _ACROSS_Y, _ACROSS_Z = np.uint64(48), np.uint64(12), np.uint64(3)
"""Distances in bits between the first cell of a brick and the last of the brick before it."""


@kernel
def count_neighbours(words):
    """Compute `contacts.neighbours`: add six bits for each cell, in parallel."""
    nx, ny, nz = words.shape
    digits = np.empty((3, nx, ny, nz), np.uint64)
    none = np.uint64(0)
    for x, y, z in np.ndindex(words.shape):
        own = words[x, y, z]
        left = words[x - 1, y, z] if x > 0 else FULL
        right = words[x + 1, y, z] if x + 1 < nx else FULL
        back = words[x, y - 1, z] if y > 0 else FULL
        front = words[x, y + 1, z] if y + 1 < ny else FULL
        below = words[x, y, z - 1] if z > 0 else FULL
        above = words[x, y, z + 1] if z + 1 < nz else none
        a = own << _X | left >> _ACROSS_X
        b = own >> _X | (right & LOW[0]) << _ACROSS_X
        c = (own & ~HIGH[1]) << _Y | (back & HIGH[1]) >> _ACROSS_Y
        d = (own & ~LOW[1]) >> _Y | (front & LOW[1]) << _ACROSS_Y
        e = (own & ~HIGH[2]) << _Z | (below & HIGH[2]) >> _ACROSS_Z
        f = (own & ~LOW[2]) >> _Z | (above & LOW[2]) << _ACROSS_Z
        one, other = a ^ b ^ c, d ^ e ^ f
        two, two_more = a & b | c & (a ^ b), d & e | f & (d ^ e)
        carried = one & other
        digits[0, x, y, z] = one ^ other
        digits[1, x, y, z] = two ^ two_more ^ carried
        digits[2, x, y, z] = two & two_more | carried & (two ^ two_more)
    return digits


@kernel
def count_contacts(digits, bricks, outer, runs):
    """Compute `contacts.contacts` at the nodes of runs.

    Parameters
    ----------
    digits : Words
        Flat digits of `contacts.neighbours`, (3, bricks of the box).
    bricks : numpy.ndarray
        Int64 (n,), the offset of each of the item's bricks from its first one, in C order.
    outer : Words
        The outer cells of each of these bricks, (n,).
    runs : CellRuns
        Runs of nodes, see `column_runs`.

    Returns
    -------
    numpy.ndarray
        Int64 (nodes,) in C order, 0 outside the runs. The counts have no meaning where the item
        is not inside the box, because there it continues in the next row.
    """
    found = np.zeros(digits.shape[1], np.int64)
    for begin, end in runs:
        total = found[begin:end]
        for n in range(len(bricks)):
            own = outer[n]
            first, last = begin + bricks[n], end + bricks[n]
            one, two, four = digits[0, first:last], digits[1, first:last], digits[2, first:last]
            for m in range(len(total)):
                total[m] += (
                    count_bits(own & one[m])
                    + 2 * count_bits(own & two[m])
                    + 4 * count_bits(own & four[m])
                )
    return found
