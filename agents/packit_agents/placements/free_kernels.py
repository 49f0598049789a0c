"""Kernels that keep track of where the rotations of an item still fit (see `free_space`).

Locations that cells do not block are bits: a word along y for each rotation, z and x. While items
are added a location that is blocked stays blocked, so an update only looks at set bits near the new
items, and only clears bits. A row of locations is tested at once against one brick (`conflicts`),
with the brick that blocked a neighbour first; what remains goes through the filled bricks that the
item would meet, found by an AND of words. The method is our own.

Exactness: a cleared bit is a proof (`BLOCKED`), a set bit is none: surfaces may still conflict.
Only `remove_blocked` writes rows, only clearing bits; boxes and items are never changed. A row has
64 bits, so that boxes have at most `free_space.MAX_NODES` nodes along y.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from packit_sim.core.compilation import allocating_kernel, inner_kernel, kernel
from packit_sim.geometry.bits import HIGH, LOW, Words
from packit_sim.geometry.voxel_kernels import ItemArrays, turn_bricks
from packit_sim.geometry.word_kernels import count_bits, lowest_bit
from packit_sim.placement import (
    BLOCKED,
    BoxArrays,
    brick_conflicts,
    brick_offsets,
    brick_state,
    state_at,
)

_1 = np.uint64(1)

_UPPER = HIGH[2] | HIGH[2] >> _1
"""The bits at places 2 and 3 along z."""


class TurnedArrays(NamedTuple):
    """The voxels of an item in several rotations, concatenated.

    Attributes
    ----------
    sizes : int64 (rotations, 3)
        Locations along x, y and z at which the item is inside the box, in each rotation.
    extents : int64 (rotations, 3)
        Its bricks along x, y and z.
    cells : int64 (rotations, 3)
        Its cells along x, y and z.
    starts : int64 (rotations + 1,)
        Index of each rotation's first brick.
    bricks, outer, inner, first, fine
        See `voxels.Voxels`; `first` counts from the beginning of all fine cells.
    """

    sizes: npt.NDArray[np.int64]
    extents: npt.NDArray[np.int64]
    cells: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int64]
    bricks: npt.NDArray[np.int16]
    outer: Words
    inner: Words
    first: npt.NDArray[np.int32]
    fine: Words


@kernel
def turn_item(item, cells, axes, signs, swaps):
    """Rotate an item, and keep those of its rotations in which its cells differ.

    Parameters
    ----------
    item : ItemArrays
        The bricks of the item before.
    cells : ndarray
        (n, 3) int64, cells along each axis of the rotated cell boxes.
    axes, signs : ndarray
        (n, 3) int64, see `rotations.AXES` and `rotations.SIGNS`.
    swaps : Words
        (n, m, 2) uint64, see `bits.turning_swaps`. Rows of zeros have no effect.

    Returns
    -------
    kept : ndarray
        (k,) int64, the rotations with other cells than those before them, as indices.
    starts, bricks, outer, inner, first, fine : ndarray
        The item in these rotations, see `TurnedArrays`.
    """
    item = ItemArrays(*item)
    space = 0
    for r in range(len(cells)):
        space += ((cells[r, 0] + 3) // 4) * ((cells[r, 1] + 3) // 4) * ((cells[r, 2] + 3) // 4)
    bricks = np.empty((space, 3), np.int16)
    outer, inner = np.empty(space, np.uint64), np.empty(space, np.uint64)
    first = np.empty(space, np.int32)
    fine = np.empty((len(cells) * len(item.fine), 2), np.uint64)
    kept, starts = np.empty(len(cells), np.int64), np.zeros(len(cells) + 1, np.int64)
    number = 0
    # Rotations that do not change the cells of a symmetric item add no placement.
    for r in range(len(cells)):
        own = turn_bricks(item, cells[r], axes[r], signs[r], swaps[r])
        known = False
        for n in range(number):
            begin, end = starts[n], starts[n + 1]
            known = known or (
                (cells[kept[n]] == cells[r]).all()
                and _are_equal(outer[begin:end], own[1])
                and _are_equal(inner[begin:end], own[2])
                and _are_equal(bricks[begin:end].ravel(), own[0].ravel())
            )
        if known:
            continue
        begin, end = starts[number], starts[number] + len(own[1])
        bricks[begin:end] = own[0]
        outer[begin:end] = own[1]
        inner[begin:end] = own[2]
        first[begin:end] = own[3][:-1] + number * len(item.fine)
        fine[number * len(item.fine) : (number + 1) * len(item.fine)] = own[4]
        kept[number] = r
        starts[number + 1] = end
        number += 1
    end = starts[number]
    return (
        kept[:number],
        starts[: number + 1].copy(),
        bricks[:end].copy(),
        outer[:end].copy(),
        inner[:end].copy(),
        first[:end].copy(),
        fine[: number * len(item.fine)].copy(),
    )


@allocating_kernel
def _are_equal(one, other):
    """Return whether two arrays (n,) are equal."""
    return len(one) == len(other) and (one == other).all()


@kernel
def remove_blocked(box, turned, rows, spans):
    """Remove the locations that are blocked.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.
    turned : TurnedArrays
        The item.
    rows : Words
        uint64 [rotation, z, x], changed in place: bit y is a location that is not blocked.
    spans : ndarray
        (n, 6) int64, first and last brick along x, y and z of each item that was added to the box.
        Bricks outside of all spans were known before, and are not looked at again.
    """
    box, turned = BoxArrays(*box), TurnedArrays(*turned)
    bricks, page, box_fine = box.bricks, box.page, box.fine
    near = np.empty(rows.shape[1:], np.uint64)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for d in range(3):
        low[d], high[d] = spans[:, d].min(), spans[:, d + 3].max() + 1
    filled = _filled_bricks(box, low, high)
    for r in range(len(turned.sizes)):
        sizes, extents = turned.sizes[r], turned.extents[r]
        _find_near(turned, r, spans, near)
        item = _in_rotation(turned, r)
        outer, inner, first, fine = item.outer, item.inner, item.first, item.fine
        offsets = brick_offsets(item.bricks, box.nx, box.ny)
        own, number = _own_bricks(item.bricks, extents)
        # A brick that blocks a location often blocks its neighbours along all three axes.
        last, lasts = 0, np.zeros(sizes[1], np.int64)
        for k in range(sizes[2]):
            z0, z1 = max(low[2] - k, 0), min(high[2] - k, extents[2])
            for i in range(sizes[0]):
                left = rows[r, k, i] & near[k, i]
                if not left:
                    continue
                x0, x1 = max(low[0] - i, 0), min(high[0] - i, extents[0])
                row = (k * box.nx + i) * box.ny
                at = row + offsets[last]
                blocked = left & brick_conflicts(bricks, at, sizes[1], outer[last], inner[last])
                left &= ~blocked
                while left:
                    j = lowest_bit(left)
                    left &= left - _1
                    n = lasts[j]
                    at = row + j + offsets[n]
                    state = brick_state(
                        bricks, page, box_fine, at, outer[n], inner[n], first[n], fine
                    )
                    is_blocked = state == BLOCKED
                    # Layers from that of the last blocker on, cyclically: the next one is near it.
                    z = min(max(item.bricks[last, 2], z0), z1 - 1)
                    left_layers = 0 if is_blocked else z1 - z0
                    while left_layers:
                        for x in range(x0, x1):
                            both = filled[k + z, i + x] >> np.uint64(j) & own[z, x]
                            while both and not is_blocked:
                                n = number[z, x, lowest_bit(both)]
                                both &= both - _1
                                at = row + j + offsets[n]
                                state = brick_state(
                                    bricks, page, box_fine, at, outer[n], inner[n], first[n], fine
                                )
                                is_blocked = state == BLOCKED
                            if is_blocked:
                                break
                        z = z + 1 if z + 1 < z1 else z0
                        left_layers = 0 if is_blocked else left_layers - 1
                    if is_blocked:
                        last = lasts[j] = n
                        at = row + offsets[n]
                        more = left & brick_conflicts(bricks, at, sizes[1], outer[n], inner[n])
                        blocked |= more | _1 << np.uint64(j)
                        left &= ~more
                rows[r, k, i] &= ~blocked


@kernel
def shadow(box):
    """Fill the cells below the outer cells of a box, and those below its inner cells.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.

    Returns
    -------
    Words
        uint64 (2, n): the outer cells and those below them, the inner cells and those below them.
    """
    box = BoxArrays(*box)
    layer = box.nx * box.ny
    found = np.empty_like(box.bricks)
    for n in range(2):
        for at in range(box.bricks.shape[1] - 1, -1, -1):
            word = box.bricks[n, at]
            if at + layer < box.bricks.shape[1]:
                word |= (found[n, at + layer] & LOW[2]) << np.uint64(3)
            word |= (word & ~LOW[2]) >> _1
            found[n, at] = word | (word & _UPPER) >> np.uint64(2)
    return found


@allocating_kernel
def _filled_bricks(box, low, high):
    """Find the filled bricks from low to high, which is excluded: words [z, x] with bits y."""
    filled = np.zeros((len(box.page) // (box.nx * box.ny), box.nx), np.uint64)
    for k in range(low[2], high[2]):
        for i in range(low[0], high[0]):
            for j in range(low[1], high[1]):
                if box.bricks[0, (k * box.nx + i) * box.ny + j]:
                    filled[k, i] |= _1 << np.uint64(j)
    return filled


@allocating_kernel
def _own_bricks(bricks, extents):
    """Find an item's bricks: words [z, x] with bits y, and their numbers [z, x, y]."""
    own = np.zeros((extents[2], extents[0]), np.uint64)
    number = np.empty((extents[2], extents[0], extents[1]), np.int32)
    for n in range(len(bricks)):
        x, y, z = bricks[n, 0], bricks[n, 1], bricks[n, 2]
        own[z, x] |= _1 << np.uint64(y)
        number[z, x, y] = n
    return own, number


@kernel
def fits_far(turned, rows, span):
    """Return whether an item fits at a location at which it can't meet another.

    Parameters
    ----------
    turned : TurnedArrays
        The item.
    rows : Words
        uint64 [rotation, z, x]: bit y is a location at which the item fits.
    span : ndarray
        (6,) int64, first and last brick along x, y and z of the other item.
    """
    turned = TurnedArrays(*turned)
    near = np.empty(rows.shape[1:], np.uint64)
    for r in range(len(turned.sizes)):
        _find_near(turned, r, span.reshape(1, 6), near)
        for k in range(turned.sizes[r, 2]):
            for i in range(turned.sizes[r, 0]):
                if rows[r, k, i] & ~near[k, i]:
                    return True
    return False


@kernel
def fits_near(box, turned, rows):
    """Return whether an item fits at a location that the items in a box don't block.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.
    turned, rows
        As in `fits_far`.
    """
    box, turned = BoxArrays(*box), TurnedArrays(*turned)
    bricks, page, box_fine = box.bricks, box.page, box.fine
    for r in range(len(turned.sizes)):
        item = _in_rotation(turned, r)
        outer, inner, first, fine = item.outer, item.inner, item.first, item.fine
        offsets = brick_offsets(item.bricks, box.nx, box.ny)
        blocker = 0
        for k in range(turned.sizes[r, 2]):
            for i in range(turned.sizes[r, 0]):
                left = rows[r, k, i]
                row = (k * box.nx + i) * box.ny
                while left:
                    at = row + offsets[blocker]
                    left &= ~brick_conflicts(
                        bricks, at, turned.sizes[r, 1], outer[blocker], inner[blocker]
                    )
                    if left:
                        j = lowest_bit(left)
                        left &= left - _1
                        state, blocker = state_at(
                            bricks, page, box_fine, outer, inner, first, fine, offsets, row + j
                        )
                        if state != BLOCKED:
                            return True
    return False


@inner_kernel
def _find_near(turned, r, spans, near):
    """Find the locations [z, x], bits y, of an item in rotation r at which it can meet others."""
    sizes, extents = turned.sizes[r], turned.extents[r]
    near[:] = 0
    for n in range(len(spans)):
        low, high = max(spans[n, 1] - extents[1] + 1, 0), min(spans[n, 4] + 1, sizes[1])
        if high <= low:
            continue
        bits = ((_1 << np.uint64(high - low)) - _1) << np.uint64(low)
        for k in range(max(spans[n, 2] - extents[2] + 1, 0), min(spans[n, 5] + 1, sizes[2])):
            for i in range(max(spans[n, 0] - extents[0] + 1, 0), min(spans[n, 3] + 1, sizes[0])):
                near[k, i] |= bits


@allocating_kernel
def _in_rotation(turned, r):
    """Return the bricks of an item in rotation r."""
    begin, end = turned.starts[r], turned.starts[r + 1]
    return ItemArrays(
        turned.bricks[begin:end],
        turned.outer[begin:end],
        turned.inner[begin:end],
        turned.first[begin:end],
        turned.fine,
    )


@kernel
def count_free(rows):
    """Count the locations of each rotation: int64 (rotations,)."""
    counts = np.zeros(len(rows), np.int64)
    for r in range(len(rows)):
        total = 0
        for row in rows[r].flat:
            total += count_bits(row)
        counts[r] = total
    return counts


@kernel
def corners(rows, sizes):
    """List the locations from which the item can't move down, nor along x, nor along y.

    Along x and y each, one of the two ways must be closed: by a wall, or by a location that is not
    in the rows.

    Parameters
    ----------
    rows : Words
        uint64 [rotation, z, x], bit y is a location.
    sizes : ndarray
        (rotations, 3) int64, see `TurnedArrays`.

    Returns
    -------
    ndarray
        int32 (n, 4): rotation, x, y, z, in the order of (rotation, z, x, y).
    """
    found = np.empty((64, 4), np.int32)
    count = 0
    for r in range(len(rows)):
        for k in range(sizes[r, 2]):
            for i in range(sizes[r, 0]):
                row = rows[r, k, i]
                # Bits shifted in from beyond both ends are 0: walls.
                left = row & (~(row << _1) | ~(row >> _1))
                if k > 0:
                    left &= ~rows[r, k - 1, i]
                if 0 < i < sizes[r, 0] - 1:
                    left &= ~(rows[r, k, i - 1] & rows[r, k, i + 1])
                while left:
                    j = lowest_bit(left)
                    left &= left - _1
                    if count == len(found):
                        grown = np.empty((2 * count, 4), np.int32)
                        grown[:count] = found
                        found = grown
                    found[count, 0], found[count, 1] = r, i
                    found[count, 2], found[count, 3] = j, k
                    count += 1
    return found[:count]
