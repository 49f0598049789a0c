"""Kernels that turn words of fine cells into the bricks of an item, and rotate the bricks.

Only bricks with an outer cell are kept, and fine cells only of cells that are outer and not inner:
the rest is known to be all 0 or all 1. A cell's row in `fine` is the brick's first row plus the
rank of its bit among the brick's surface cells, a count of bits. Bricks are shuffled: neighbouring
bricks are alike, so that a scan that may stop early finds a blocking one sooner.

A rotation moves words (permuting the bits within each, see `bits.turning_swaps`) instead of
voxelizing again. It is exact, since cell boxes are centred: the result is that of a turned mesh.
All kernels return new arrays; `Voxels` are never changed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from packit_sim.core.compilation import allocating_kernel, inner_kernel, kernel
from packit_sim.geometry.bits import FULL, LOW, STRIDES, Words
from packit_sim.geometry.word_kernels import count_bits, lowest_bit, turn_words

_1 = np.uint64(1)


class ItemArrays(NamedTuple):
    """The bricks of an item, indexed by number.

    Attributes
    ----------
    bricks, outer, inner, first, fine
        See `voxels.Voxels`.
    """

    bricks: npt.NDArray[np.int16]
    outer: Words
    inner: Words
    first: npt.NDArray[np.int32]
    fine: Words


class FixedArrays(NamedTuple):
    """The bricks of an item that another is compared with, indexed by place.

    Attributes
    ----------
    number, outer, inner, first, fine
        See `voxels.Voxels`.
    """

    number: npt.NDArray[np.int32]
    outer: Words
    inner: Words
    first: npt.NDArray[np.int32]
    fine: Words


@allocating_kernel
def _brick_words(touched, reached):
    """Return the outer and the inner cells as words over the bricks [x, y, z]."""
    nx, ny, nz = touched.shape
    bricks = ((nx + 3) // 4, (ny + 3) // 4, (nz + 3) // 4)
    outer_cells = np.zeros(bricks, np.uint64)
    inner_cells = np.zeros(bricks, np.uint64)
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                if reached[x, y, z] != FULL:
                    bit = _1 << np.uint64(16 * (x & 3) + 4 * (y & 3) + (z & 3))
                    outer_cells[x >> 2, y >> 2, z >> 2] |= bit
                    if not touched[x, y, z] | reached[x, y, z]:
                        inner_cells[x >> 2, y >> 2, z >> 2] |= bit
    return outer_cells, inner_cells


@allocating_kernel
def _shuffled(outer_cells, inner_cells):
    """Return the bricks that contain a cell, shuffled: all arrays of `Voxels` but `fine`."""
    nx, ny, nz = outer_cells.shape
    count = 0
    for word in outer_cells.flat:
        count += word != 0
    bricks = np.empty((count, 3), np.int16)
    n = 0
    random = np.uint64(0x9E37_79B9_7F4A_7C15)
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                if outer_cells[x, y, z]:
                    # Marsaglia's xorshift64 (2003) with a fixed seed: the same order every time.
                    random ^= random << np.uint64(13)
                    random ^= random >> np.uint64(7)
                    random ^= random << np.uint64(17)
                    at = np.int64(random % np.uint64(n + 1))  # the inside-out Fisher-Yates shuffle
                    for d in range(3):
                        bricks[n, d] = bricks[at, d]
                    bricks[at, 0], bricks[at, 1], bricks[at, 2] = x, y, z
                    n += 1
    outer = np.empty(count, np.uint64)
    inner = np.empty(count, np.uint64)
    first = np.zeros(count + 1, np.int32)
    number = np.full((nx, ny, nz), np.int32(-1))
    for n in range(count):
        x, y, z = bricks[n]
        number[x, y, z] = n
        outer[n], inner[n] = outer_cells[x, y, z], inner_cells[x, y, z]
        first[n + 1] = first[n] + count_bits(outer[n] & ~inner[n])
    return bricks, outer, inner, first, number


@inner_kernel
def _place(brick, bit):
    """Return the cell of a bit in a brick, (x, y, z) in the cell box."""
    return 4 * brick[0] + (bit >> 4), 4 * brick[1] + (bit >> 2 & 3), 4 * brick[2] + (bit & 3)


@kernel
def brick_arrays(touched, reached):
    """Return the arrays of `Voxels` from words [x, y, z] of touched and reached fine cells."""
    outer_cells, inner_cells = _brick_words(touched, reached)
    bricks, outer, inner, first, number = _shuffled(outer_cells, inner_cells)
    fine = np.empty((first[-1], 2), np.uint64)
    at = 0
    for n in range(len(bricks)):
        left = outer[n] & ~inner[n]
        while left:
            x, y, z = _place(bricks[n], lowest_bit(left))
            left &= left - _1
            fine[at, 0] = ~reached[x, y, z]
            fine[at, 1] = ~(reached[x, y, z] | touched[x, y, z])
            at += 1
    return bricks, outer, inner, first, fine, number


@kernel
def turn_bricks(old, cells, axes, signs, swaps):
    """Return the arrays of `Voxels` of a rotated item.

    Parameters
    ----------
    old : ItemArrays
        The bricks of the item before.
    cells : ndarray
        (3,) int64, cells along each axis of the rotated cell box.
    axes : ndarray
        (3,) int64, see `rotations.AXES`.
    signs : ndarray
        (3,) int64, see `rotations.SIGNS`.
    swaps : Words
        (n, 2) uint64, see `bits.turning_swaps`.

    Returns
    -------
    bricks, outer, inner, first, fine, number : ndarray
        See `voxels.Voxels`.
    """
    old_bricks, old_outer, old_inner, _, old_fine = old
    nx, ny, nz = (cells[0] + 3) // 4, (cells[1] + 3) // 4, (cells[2] + 3) // 4
    outer_cells = np.zeros((nx, ny, nz), np.uint64)
    inner_cells = np.zeros((nx, ny, nz), np.uint64)
    words = old_outer.copy()
    turn_words(words, swaps)
    _put(outer_cells, words, old_bricks, axes, signs)
    words = old_inner.copy()
    turn_words(words, swaps)
    _put(inner_cells, words, old_bricks, axes, signs)
    for d in range(3):
        # A reversed axis leaves its unused cells of the last brick at 0: move all down by them.
        spare = -cells[d] & 3
        if signs[d] < 0 and spare:
            _shift(outer_cells, d, spare)
            _shift(inner_cells, d, spare)
    bricks, outer, inner, first, number = _shuffled(outer_cells, inner_cells)
    flat = old_fine.ravel().copy()
    turn_words(flat, swaps)
    fine = np.empty_like(old_fine)
    at = 0
    ax, ay, az = axes[0], axes[1], axes[2]
    sx, sy, sz = signs[0], signs[1], signs[2]
    for m in range(len(old_bricks)):
        left = old_outer[m] & ~old_inner[m]
        # Where the brick's cell (0, 0, 0) goes; bit 16 x + 4 y + z is cell (x, y, z) of a brick.
        cx = 4 * old_bricks[m, ax] if sx > 0 else cells[0] - 1 - 4 * old_bricks[m, ax]
        cy = 4 * old_bricks[m, ay] if sy > 0 else cells[1] - 1 - 4 * old_bricks[m, ay]
        cz = 4 * old_bricks[m, az] if sz > 0 else cells[2] - 1 - 4 * old_bricks[m, az]
        while left:
            old_bit = lowest_bit(left)
            left &= left - _1
            x = cx + sx * (old_bit >> 4 - 2 * ax & 3)
            y = cy + sy * (old_bit >> 4 - 2 * ay & 3)
            z = cz + sz * (old_bit >> 4 - 2 * az & 3)
            n = number[x >> 2, y >> 2, z >> 2]
            below = (_1 << np.uint64(16 * (x & 3) + 4 * (y & 3) + (z & 3))) - _1
            to = first[n] + count_bits(outer[n] & ~inner[n] & below)
            fine[to, 0], fine[to, 1] = flat[2 * at], flat[2 * at + 1]
            at += 1
    return bricks, outer, inner, first, fine, number


@allocating_kernel
def _put(dense, words, bricks, axes, signs):
    """Write words to the places of their bricks after a turn of a cell box of whole bricks."""
    place = np.empty(3, np.int64)
    for n in range(len(bricks)):
        for d in range(3):
            at = bricks[n, axes[d]]
            place[d] = at if signs[d] > 0 else dense.shape[d] - 1 - at
        dense[place[0], place[1], place[2]] = words[n]


@inner_kernel
def _shift(dense, d, count):
    """Move the cells in bricks [x, y, z] by 1 to 3 places towards 0 along axis d."""
    stride = STRIDES[d]
    low = np.uint64(0)
    for place in range(count):
        low |= LOW[d] << np.uint64(place * stride)
    down, up = np.uint64(count * stride), np.uint64((4 - count) * stride)
    nx, ny, nz = dense.shape
    dx, dy, dz = d == 0, d == 1, d == 2
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                word = (dense[x, y, z] & ~low) >> down
                if x + dx < nx and y + dy < ny and z + dz < nz:
                    word |= (dense[x + dx, y + dy, z + dz] & low) << up
                dense[x, y, z] = word


@kernel
def spread_words(dense, item, which):
    """Write an item's outer (0) or inner (1) fine cells into words [x, y, z] over its cell box."""
    bricks, outer, inner, _, fine = item
    at = 0
    for n in range(len(bricks)):
        left = outer[n]
        while left:
            bit = lowest_bit(left)
            left &= left - _1
            x, y, z = _place(bricks[n], bit)
            if inner[n] >> np.uint64(bit) & _1:
                dense[x, y, z] = FULL
            else:
                dense[x, y, z] = fine[at, which]
                at += 1
