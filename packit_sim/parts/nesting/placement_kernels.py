"""Kernels that find the lowest place of an item in a grid of cells, among all its positions.

The grid holds *windows*: for sides s of `SIDES`, at each cell, whether any of the s^3 cells from it
on is taken. A cube of s^3 cells of an item is free at a position exactly if its window there is, so
that an item of thousands of cells is tested by a few hundred cubes, the largest first. Inner cubes
prune: if a cube of side m is shrunk by b - 1 and still touches something at a block of b^3
positions, then all these are blocked. Blocks of 4, 2 and 1 positions are tested one after the
other: this is a branch and bound whose bounds are exact.

Bits are ordered so that a word holds every fourth cell along z: cell z is bit z // 4 of the words
of *phase* z % 4. So a word is a column of blocks at first, and of positions at last, and 64 of them
are tested at once. A cube that blocked is moved to the front, since it blocks nearby columns too.
The layout and the pruning are our own; voxel words for packing go back to Baumann et al. (2012).

Invariants: windows fit the cells after each `update_windows`; all positions that are returned are
free in every cell. Positions are those of an item's lowest cells.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inlined, inner_kernel, kernel
from packit_sim.geometry.word_kernels import lowest_bit

SIDES = 1, 2, 3, 4, 6, 8, 12, 16
"""The sides of windows."""

LONGEST = 16
"""The longest of them."""

_SIDES = np.array(SIDES)

_WIDEST = np.array([0, 0, 1, 2, 3, 3, 4, 4, 5, 5, 5, 5, 6, 6, 6, 6, 7])
"""The number of the largest window that is not longer than a length (0 to `LONGEST`)."""

_LESS = np.array([3, 1])
"""Cells by which a cube shrinks that blocks all positions of a block of 4, and of 2."""


@kernel
def mark(windows, bits, form, x, y, z):
    """Take the cells of an item.

    Parameters
    ----------
    windows : ndarray
        (8, 4, k, X, Y) uint64: windows by side, phase and word; changed at side 1.
    bits : ndarray
        uint64, words of items.
    form : ndarray
        (7,) int64, of the item (see `Cells`).
    x, y, z : int
        Its position.
    """
    cells = windows[0]
    for k in range(form[3]):
        for a in range(form[4]):
            at = form[0] + k * form[2] + a * form[1]
            for b in range(form[5]):
                word = bits[at + b]
                c = z + 64 * k
                while word:
                    lowest = lowest_bit(word)
                    word &= word - np.uint64(1)
                    own = c + lowest
                    bit = np.uint64(1) << np.uint64((own >> 2) & 63)
                    cells[own & 3, own >> 8, x + a, y + b] |= bit


@kernel
def update_windows(windows, low_x, low_y, high_x, high_y):
    """Compute windows again where cells of columns from `low` to before `high` have changed.

    Parameters
    ----------
    windows : ndarray
        (8, 4, k, X, Y) uint64; changed at all sides but 1.
    low_x, low_y, high_x, high_y : int
        The columns.
    """
    x, y = max(0, low_x - LONGEST + 1), max(0, low_y - LONGEST + 1)
    # A window of 2 s is two of s, s apart; one of 3 s / 2 is two of s, half of s apart.
    _widen(windows[0], windows[1], 1, x, y, high_x, high_y)
    _widen(windows[1], windows[2], 1, x, y, high_x, high_y)
    _widen(windows[1], windows[3], 2, x, y, high_x, high_y)
    _widen(windows[3], windows[4], 2, x, y, high_x, high_y)
    _widen(windows[3], windows[5], 4, x, y, high_x, high_y)
    _widen(windows[5], windows[6], 4, x, y, high_x, high_y)
    _widen(windows[5], windows[7], 8, x, y, high_x, high_y)


@allocating_kernel
def _widen(narrow, wide, step, low_x, low_y, high_x, high_y):
    """Let each wide window be all eight narrow ones that are a step apart along each axis."""
    _, words, count_x, count_y = narrow.shape
    end_x, end_y = min(high_x + step, count_x), min(high_y + step, count_y)
    rows = np.empty((end_x - low_x, end_y - low_y), np.uint64)
    for f in range(4):
        g = (f + step) & 3
        carry = np.uint64((f + step) >> 2)
        rest = np.uint64(64) - carry
        for k in range(words):
            has_above = k + 1 < words and carry > 0
            for x in range(low_x, end_x):
                for y in range(low_y, end_y):
                    word = narrow[g, k, x, y] >> carry
                    if has_above:
                        word |= narrow[g, k + 1, x, y] << rest
                    rows[x - low_x, y - low_y] = narrow[f, k, x, y] | word
            for a in range(high_x - low_x):
                if a + step < len(rows):
                    for b in range(rows.shape[1]):
                        rows[a, b] |= rows[a + step, b]
                for b in range(high_y - low_y):
                    word = rows[a, b]
                    if b + step < rows.shape[1]:
                        word |= rows[a, b + step]
                    wide[f, k, low_x + a, low_y + b] = word


@kernel
def lowest_place(windows, size_x, size_y, cells, t, turns, limit, best):
    """Find the free position of an item with the lowest top, in any of some rotations.

    Parameters
    ----------
    windows : ndarray
        (8, 4, k, X, Y) uint64, which reach up to the limit.
    size_x, size_y : int
        The cells of the box along x and y.
    cells : Cells
        The items.
    t : int
        The type.
    turns : ndarray
        (r,) int64, the numbers of its rotations.
    limit : int
        The highest top.
    best : ndarray
        (4,) int64, gets the number of the rotation and the position.

    Returns
    -------
    int
        The top; more than the limit if there is no free position.
    """
    count_x, count_y = windows.shape[3], windows.shape[4]
    layer = count_x * count_y
    side = 4 * windows.shape[2] * layer
    words = windows.shape[2]
    flat = windows.reshape(-1)
    most_cubes = most_first = 0
    for r in range(len(turns)):
        base = cells.bases[t, turns[r]]
        most_cubes = max(most_cubes, cells.starts[base + 1] - cells.starts[base])
        most_first = max(most_first, cells.first_starts[base + 1] - cells.first_starts[base])
    cubes = np.empty((most_cubes, 2), np.int64)  # where a cube's window is, and its z
    blocks = np.empty((2, most_first, 2), np.int64)  # the same for blocks of 4 and of 2
    counts = np.zeros(2, np.int64)
    limit += 1
    # Twice through all rotations: at first one position of each block, for a low limit early.
    for n in range(2 * len(turns)):
        is_first = n < len(turns)
        o = turns[n % len(turns)]
        form = cells.forms[t, o]
        most_x, most_y = size_x - form[4], size_y - form[5]
        most_z = limit - 1 - form[6]
        if most_x < 0 or most_y < 0 or most_z < 0:
            continue
        base = cells.bases[t, o]
        shape = form[4:]
        axes, signs = cells.axes[t, o], cells.signs[t, o]
        few = cells.first[cells.first_starts[base] : cells.first_starts[base + 1]]
        for level in range(2):
            counts[level] = _turned(
                few, shape, axes, signs, _LESS[level], side, count_y, blocks[level]
            )
        own = cells.cubes[cells.starts[base] : cells.starts[base + 1]]
        count = _turned(own, shape, axes, signs, 0, side, count_y, cubes)
        for bx in range(0, most_x + 1, 4):
            for by in range(0, most_y + 1, 4):
                at = bx * count_y + by
                for k in range(most_z // 256 + 1):
                    open4 = _below(most_z // 4 + 1 - 64 * k)
                    open4 = _left(flat, at, blocks[0], counts[0], 0, layer, words, k, open4)
                    if not open4:
                        continue
                    for h in range(1 if is_first else 8):
                        x2, y2, z2 = bx + 2 * (h & 1), by + (h & 2), (h & 4) >> 1
                        if x2 > most_x or y2 > most_y:
                            continue
                        at2 = x2 * count_y + y2
                        open2 = _left(flat, at2, blocks[1], counts[1], z2, layer, words, k, open4)
                        if not open2:
                            continue
                        for e in range(1 if is_first else 8):
                            x, y, f = x2 + (e & 1), y2 + ((e & 2) >> 1), z2 + ((e & 4) >> 2)
                            if x > most_x or y > most_y or f > most_z:
                                continue
                            free = open2 & _below((most_z - f) // 4 + 1 - 64 * k)
                            at1 = x * count_y + y
                            free = _left(flat, at1, cubes, count, f, layer, words, k, free)
                            if free:
                                z = 4 * (lowest_bit(free) + 64 * k) + f
                                limit = z + form[6]
                                most_z = limit - 1 - form[6]
                                best[0], best[1], best[2], best[3] = o, x, y, z
    return limit


@inner_kernel
def _turned(cubes, shape, axes, signs, less, side, count_y, out):
    """Write where the windows of turned cubes are, shrunk by some cells, and the z of these.

    Returns
    -------
    int
        Their number: cubes that are too small are left out.
    """
    count = 0
    for n in range(len(cubes)):
        length = cubes[n, 3] - less
        if length < 1:
            continue
        window = _WIDEST[min(length, LONGEST)]
        inset = less + (length - _SIDES[window]) // 2
        at = 0
        z = 0
        for d in range(3):
            low = cubes[n, axes[d]]
            if signs[d] < 0:
                low = shape[d] - low - cubes[n, 3]
            low += inset
            if d == 2:
                z = low
            else:
                at = at * count_y + low
        out[count, 0] = window * side + at
        out[count, 1] = z
        count += 1
    return count


@inner_kernel
def _left(flat, at, cubes, count, phase, layer, words, k, free):
    """Return the bits of a word of positions at which no cube's window is taken."""
    for n in range(count):
        z = cubes[n, 1] + phase
        shift = z >> 2
        word = k + (shift >> 6)
        if word >= words:
            continue
        few = np.uint64(shift & 63)
        index = at + cubes[n, 0] + ((z & 3) * words + word) * layer
        taken = flat[index] >> few
        if few and word + 1 < words:
            taken |= flat[index + layer] << (np.uint64(64) - few)
        free &= ~taken
        if not free:
            if n > 0:
                m = n >> 1
                for d in range(2):
                    cubes[n, d], cubes[m, d] = cubes[m, d], cubes[n, d]
            return free
    return free


@inlined
def _below(count):
    """Return a word whose lowest bits are set, as many as the count."""
    if count <= 0:
        return np.uint64(0)
    if count >= 64:
        return ~np.uint64(0)
    return (np.uint64(1) << np.uint64(count)) - np.uint64(1)


@allocating_kernel
def _largest_cubes(solid):
    """Return the side of the largest cube of cells from each cell on, (x, y, z) int32."""
    x, y, z = solid.shape
    sides = np.zeros((x + 1, y + 1, z + 1), np.int32)
    for i in range(x - 1, -1, -1):
        for j in range(y - 1, -1, -1):
            for k in range(z - 1, -1, -1):
                if solid[i, j, k]:
                    least = min(sides[i + 1, j, k], sides[i, j + 1, k], sides[i, j, k + 1])
                    least = min(least, sides[i + 1, j + 1, k], sides[i + 1, j, k + 1])
                    least = min(least, sides[i, j + 1, k + 1], sides[i + 1, j + 1, k + 1])
                    sides[i, j, k] = 1 + least
    return sides[:x, :y, :z]


@kernel
def inner_cubes(solid, most):
    """Choose cubes inside a solid, each the largest whose centre is not near one before.

    Parameters
    ----------
    solid : ndarray
        (x, y, z) uint8, its cells.
    most : int
        The most cubes.

    Returns
    -------
    ndarray
        (n, 4) int32, their lowest cells and sides, of at least 2.
    """
    sides = _largest_cubes(solid).copy()
    x, y, z = sides.shape
    found = np.empty((most, 4), np.int32)
    for n in range(most):
        at = np.argmax(sides)
        i, j, k = at // (y * z), at // z % y, at % z
        m = sides[i, j, k]
        if m < 2:
            return found[:n]
        found[n, 0], found[n, 1], found[n, 2], found[n, 3] = i, j, k, m
        for a in range(max(0, i - m), min(x, i + m + 1)):
            for b in range(max(0, j - m), min(y, j + m + 1)):
                for c in range(max(0, k - m), min(z, k + m + 1)):
                    less = m - sides[a, b, c]  # twice the distance of two centres is compared
                    away = max(abs(2 * (i - a) + less), abs(2 * (j - b) + less))
                    if max(away, abs(2 * (k - c) + less)) < m:
                        sides[a, b, c] = 0
    return found


@kernel
def cover(solid):
    """Divide a solid into cubes of sides 16, 8, 4, 2 and 1, as an octree does.

    Parameters
    ----------
    solid : ndarray
        (x, y, z) uint8, its cells.

    Returns
    -------
    ndarray
        (n, 4) int32, their lowest cells and sides.
    """
    x, y, z = solid.shape
    left = solid.copy()
    sides = _largest_cubes(solid)
    found = np.empty((solid.size, 4), np.int32)
    n = 0
    side = LONGEST
    while side >= 1:
        for i in range(0, x, side):
            for j in range(0, y, side):
                for k in range(0, z, side):
                    if sides[i, j, k] >= side and left[i, j, k]:
                        found[n, 0], found[n, 1], found[n, 2], found[n, 3] = i, j, k, side
                        n += 1
                        left[i : i + side, j : j + side, k : k + side] = 0
        side >>= 1
    return found[:n].copy()
