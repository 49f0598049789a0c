"""The kernel that measures how an item meets the items of a box where voxels decide nothing.

Cells and fine cells are both in words of 4 x 4 x 4 bits: the same counts describe both levels.
Neighbours are taken within a word: those across its border are not seen.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.geometry.voxel_kernels import ItemArrays
from packit_sim.geometry.word_kernels import count_bits, lowest_bit
from packit_sim.placement import BoxArrays

COUNTS = 16
"""Numbers for each level."""

_1 = np.uint64(1)
_X, _Y, _Z = np.uint64(16), np.uint64(4), np.uint64(1)
_BELOW_X = np.uint64(0x0000_FFFF_FFFF_FFFF)
_BELOW_Y = np.uint64(0x0FFF_0FFF_0FFF_0FFF)
_BELOW_Z = np.uint64(0x7777_7777_7777_7777)
"""Bits that have a neighbour in the word at the higher end of an axis."""


@inner_kernel
def _raised(word, shift, below):
    return (word & below) << shift


@inner_kernel
def _lowered(word, shift, below):
    return word >> shift & below


@inner_kernel
def _around(word):
    """Return the cells next to those of a word."""
    x = _raised(word, _X, _BELOW_X) | _lowered(word, _X, _BELOW_X)
    y = _raised(word, _Y, _BELOW_Y) | _lowered(word, _Y, _BELOW_Y)
    return x | y | _raised(word, _Z, _BELOW_Z) | _lowered(word, _Z, _BELOW_Z)


@inner_kernel
def _between(one, other, shift, below):
    """Return the cells between a cell of one word and one of the other, along an axis."""
    return (_raised(one, shift, below) & _lowered(other, shift, below)) | (
        _lowered(one, shift, below) & _raised(other, shift, below)
    )


@inner_kernel
def _add(counts, outer, inner, own_outer, own_inner):
    """Add what the words of a box and of an item have in common to the counts of a level."""
    shared = outer & own_outer
    number = count_bits(shared)
    pairs_x = shared & _lowered(shared, _X, _BELOW_X)
    pairs_y = shared & _lowered(shared, _Y, _BELOW_Y)
    squares = pairs_x & _lowered(pairs_x, _Y, _BELOW_Y)
    near, own_near = shared & _around(inner), shared & _around(own_inner)
    bare, own_bare = shared & _around(~outer), shared & _around(~own_outer)
    counts[0] += number
    counts[1] += 1
    counts[2] = max(counts[2], number)
    counts[3] += count_bits(pairs_x)
    counts[4] += count_bits(pairs_y)
    counts[5] += count_bits(shared & _lowered(shared, _Z, _BELOW_Z))
    counts[6] += count_bits(squares & _lowered(squares, _Z, _BELOW_Z))
    counts[7] += count_bits(near)
    counts[8] += count_bits(own_near)
    counts[9] += count_bits(near & own_near)
    counts[10] += count_bits(bare)
    counts[11] += count_bits(own_bare)
    counts[12] += count_bits(bare & own_bare)
    counts[13] += count_bits(shared & _between(inner, own_inner, _X, _BELOW_X))
    counts[14] += count_bits(shared & _between(inner, own_inner, _Y, _BELOW_Y))
    counts[15] += count_bits(shared & _between(inner, own_inner, _Z, _BELOW_Z))


@kernel
def contact_features(box, item, locations):
    """Measure the contact of an item at locations that its cells leave open.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.
    item : ItemArrays
        The bricks of the item.
    locations : ndarray
        (n, 3) int64, open locations (see `screening`).

    Returns
    -------
    ndarray
        float32 (n, 2 * COUNTS), the logarithms of 1 + the counts of `_add`: over the bricks that
        share cells, and over the cells that share fine cells.
    """
    box, item = BoxArrays(*box), ItemArrays(*item)
    found = np.zeros((len(locations), 2 * COUNTS), np.float32)
    for n in range(len(locations)):
        start = (locations[n, 2] * box.nx + locations[n, 0]) * box.ny + locations[n, 1]
        for m in range(len(item.bricks)):
            at = start + (item.bricks[m, 2] * box.nx + item.bricks[m, 0]) * box.ny
            at += item.bricks[m, 1]
            outer, own = box.bricks[0, at], item.outer[m]
            shared = outer & own
            if not shared:
                continue
            _add(found[n, :COUNTS], outer, box.bricks[1, at], own, item.inner[m])
            surface = own & ~item.inner[m]
            page = box.page[at]
            while shared:
                bit = lowest_bit(shared)
                shared &= shared - _1
                # Rows of fine cells exist for surface cells only, in the order of their bits.
                row = item.first[m] + count_bits(surface & (_1 << np.uint64(bit)) - _1)
                fine, own_fine = box.fine[page, bit], item.fine[row]
                if fine[0] & own_fine[0]:
                    _add(found[n, COUNTS:], fine[0], fine[1], own_fine[0], own_fine[1])
    return np.log1p(found)
