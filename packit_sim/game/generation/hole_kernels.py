"""Kernel that finds where a shape may fit into the holes of a box (see `holes`).

The shape is a set of points. A placement is excluded as soon as one point is in an inner fine cell
of the box (or, for a point deep inside the shape, in any outer one). That is a proof; placements
that remain are candidates, which the engine decides. So points are a filter alone, and their number
and order change the time, not which packs are valid. The method is our own.

`inner_rows` transposes the box's bits: for each of the 64 places in a brick a word along a row of
bricks, so that one shift compares one point at 32 locations. Words overlap by half, so that a
window of 32 bricks from any brick on is in one word. The box is never changed.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inner_kernel, kernel
from packit_sim.geometry.word_kernels import lowest_bit
from packit_sim.placement import BoxArrays

_1 = np.uint64(1)

_HALF = 32
"""Half of the bits of a word: as many locations are compared at once."""

_BLOCK = 256
"""Points that are located at a time."""


@kernel
def inner_rows(inner, ny):
    """Sort the inner cells of a box by their places in the bricks.

    Parameters
    ----------
    inner : Words
        (n,) uint64, the inner cells of the box's bricks.
    ny : int
        The number of bricks in a row along y.

    Returns
    -------
    Words
        (n / ny, words, 64) uint64, for each row and each place in a brick whether the cell there is
        inner: bit b of word w is about brick 32 w + b of the row, so that words overlap.
    """
    rows = np.zeros((len(inner) // ny, (ny + _HALF - 1) // _HALF, 64), np.uint64)
    for row in range(len(rows)):
        for j in range(ny):
            cells = inner[row * ny + j]
            if cells:
                word, bit = j // _HALF, j % _HALF
                _add_column(cells, rows[row, word], bit)
                if word:
                    _add_column(cells, rows[row, word - 1], bit + _HALF)
    return rows


@inner_kernel
def _add_column(cells, words, bit):
    """Set a bit of each word (64,) whose place is one of some cells."""
    for place in range(64):
        words[place] |= (cells >> np.uint64(place) & _1) << np.uint64(bit)


@kernel
def find_holes(box, rows, points, shallow, coarse, turns, limits, each, found):
    """Find placements at which no point of a shape is inside an item.

    Parameters
    ----------
    box : BoxArrays
        The bricks of the box.
    rows : Words
        Its inner cells (see `inner_rows`).
    points : ndarray
        (n, 3) float64, points of the shape relative to its centre, in fine cells.
    shallow : ndarray
        (n,) uint8. 0 for points so deep inside that no surface of another item may be in their fine
        cell; 1 for the others, which must not be in an inner fine cell.
    coarse : int
        The number of points to compare first.
    turns : ndarray
        (turns, 9) int64, for each turn of the shape: axes and signs (see `rotations`), and the
        cells along x, y and z.
    limits : ndarray
        (turns, 3) int64, the number of locations along x, y and z; 0 or less if it does not fit.
    each : int
        The number of placements to find for each turn.
    found : ndarray
        (most, 4) int64, filled with placements: the number of the turn, and the location.

    Returns
    -------
    int
        The number of placements written; the search ends when `found` is full.

    Notes
    -----
    The first points are compared with inner cells, at up to 32 locations of a row at once. Most
    points are never needed, so that they are located when they are.
    """
    box = BoxArrays(*box)
    at = np.empty(len(points), np.int64)
    cell = np.empty(len(points), np.uint64)
    fine = np.empty(len(points), np.uint64)
    steps = np.empty((coarse, 2), np.int64)
    count = 0
    for turn in range(len(turns)):
        if limits[turn].min() <= 0:
            continue
        known = _locate(points, turns[turn], box.nx, box.ny, 0, coarse, at, cell, fine)
        for n in range(coarse):
            steps[n, 0], steps[n, 1] = at[n] // box.ny, at[n] % box.ny
        last = taker = 0
        enough = min(count + each, len(found))
        for k in range(limits[turn, 2]):
            for i in range(limits[turn, 0]):
                for first in range(0, limits[turn, 1], _HALF):
                    if count == enough:
                        break
                    row, most = k * box.nx + i, min(_HALF, limits[turn, 1] - first)
                    # 32 locations at once by inner cells, then one by one by fine cells.
                    free, last = _free(rows, row, first, most, steps, cell, last)
                    while free and count < enough:
                        j = first + lowest_bit(free)
                        free &= free - _1
                        start = row * box.ny + j
                        # The point that excluded the last location often excludes the next one.
                        if _taken(box, start + at[taker], cell[taker], fine[taker], shallow[taker]):
                            continue
                        n, known = _find_taken(
                            box, start, points, shallow, coarse, turns[turn], known, at, cell, fine
                        )
                        if n >= 0:
                            taker = n
                            continue
                        found[count, 0] = turn
                        found[count, 1], found[count, 2], found[count, 3] = i, j, k
                        count += 1
        if count == len(found):
            break
    return count


@inner_kernel
def _free(rows, row, first, most, steps, cell, last):
    """Return at which locations of a row no point is in an inner cell: a word of up to 32 bits.

    Also returns the point after which none was left. `last` is the one of the row before, which is
    compared first.
    """
    # Bits beyond `most` are of locations outside; what the words hold there is masked.
    free = (_1 << np.uint64(most)) - _1
    free &= ~_inner(rows, row + steps[last, 0], first + steps[last, 1], cell[last])
    n = 0
    while free and n < len(steps):
        free &= ~_inner(rows, row + steps[n, 0], first + steps[n, 1], cell[n])
        last = n
        n += 1
    return free, last


@inner_kernel
def _inner(rows, row, j, place):
    """Return whether the cells at a place in 32 bricks of a row, from number j on, are inner."""
    return rows[row, j >> 5, place] >> np.uint64(j & 31)


@inner_kernel
def _find_taken(box, start, points, shallow, coarse, turn, known, at, cell, fine):
    """Return the first point that is inside an item, -1 if none is; and how many are located."""
    begin, stop = 0, coarse
    while True:
        n = _first_taken(box, start, at, cell, fine, shallow, begin, stop)
        if n >= 0 or stop == len(points):
            return n, known
        begin, stop = stop, min(stop + _BLOCK, len(points))
        if known < stop:
            known = _locate(points, turn, box.nx, box.ny, begin, stop, at, cell, fine)


@allocating_kernel
def _locate(points, turn, nx, ny, start, stop, at, cell, fine):
    """Compute the brick, the cell and the fine cell of turned points at the box's origin."""
    place = np.empty(3, np.int64)
    for n in range(start, stop):
        for d in range(3):
            cells = turn[6 + d]
            own = int(np.floor(points[n, turn[d]] * turn[3 + d] + 2 * cells))
            place[d] = min(max(own, 0), 4 * cells - 1)
        x, y, z = place
        at[n] = ((z >> 4) * nx + (x >> 4)) * ny + (y >> 4)
        cell[n] = np.uint64(16 * (x >> 2 & 3) + 4 * (y >> 2 & 3) + (z >> 2 & 3))
        fine[n] = np.uint64(16 * (x & 3) + 4 * (y & 3) + (z & 3))
    return stop


@inner_kernel
def _first_taken(box, start, at, cell, fine, shallow, first, stop):
    """Return the first of some points that is inside an item; -1 if there is none."""
    for n in range(first, stop):
        if _taken(box, start + at[n], cell[n], fine[n], shallow[n]):
            return n
    return -1


@inner_kernel
def _taken(box, brick, cell, fine, which):
    """Decide whether a point's fine cell is inner, or outer if `which` is 0."""
    if box.bricks[1, brick] >> cell & _1:
        return True
    if not box.bricks[0, brick] >> cell & _1:
        return False
    return (box.fine[box.page[brick], cell, which] >> fine & _1) != 0
