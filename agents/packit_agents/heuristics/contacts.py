"""Contacts: how many pairs of neighbouring cells an item and a filled box have.

Cells are outer cells throughout, as words, one a brick (see `bits`), so that sixty-four are looked
at together. Neighbours share a face.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_agents.heuristics.column_runs import stretches
from packit_sim.core.compilation import kernel
from packit_sim.geometry.bits import FULL, HIGH, LOW, Words
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.word_kernels import count_bits
from packit_sim.placement import Mask

_X, _Y, _Z = np.uint64(16), np.uint64(4), np.uint64(1)
"""By how many bits neighbours along x, y and z are apart in a word."""

_ACROSS_X, _ACROSS_Y, _ACROSS_Z = np.uint64(48), np.uint64(12), np.uint64(3)
"""By how many the first place of one brick and the last of the one before it are."""


def neighbours(words: Words) -> Words:
    """[digit, x, y, z] of a box's words [x, y, z]: how many neighbours of each cell are filled.

    A binary number for each cell, its three digits from low to high in three words. The walls and
    the floor count as filled, what is above the box does not.
    """
    return _neighbours(np.ascontiguousarray(words))


def contacts(digits: Words, item: Item, mask: Mask) -> npt.NDArray[np.int64]:
    """[x, y, z] over the nodes: pairs of the item's cells and filled neighbours; 0 off the mask.

    digits: what `neighbours` says of the box. The item must be inside it wherever the mask is True.
    """
    x, y, z = item.voxels.bricks.T.astype(np.int64)
    _, ny, nz = mask.shape
    bricks = (x * ny + y) * nz + z
    flat = digits.reshape(3, -1)
    found = _contacts(flat, bricks, item.voxels.outer, stretches(mask)).reshape(mask.shape)
    return np.where(mask, found, 0)


@kernel
def _neighbours(words):
    """`neighbours` of words: six bits a cell, added up in parallel."""
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
def _contacts(digits, bricks, outer, stretches):
    """(nodes,) `contacts` of an item's words, in C order, at the nodes of stretches; 0 elsewhere.

    bricks: how far each is from the item's first place, in C order. The numbers mean nothing where
    the item is not inside the box: there it sticks out to the next row.
    """
    found = np.zeros(digits.shape[1], np.int64)
    for begin, end in stretches:
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
