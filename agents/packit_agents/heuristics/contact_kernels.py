"""Kernels that count contacts of cells in parallel (see `contacts`).

The number of filled neighbours of 64 cells is computed at once: six words shifted by one cell, one
for each direction, are added bit by bit with full adders (carry-save addition, Warren, "Hacker's
Delight", counting bits), so that three words hold the binary digits of 64 numbers. The contacts of
an item are then counts of bits.

The best location is found by branch and bound, which is exact: a brick has at most as many contacts
as its filled neighbours in all (`sum_neighbours`), and as six a cell. Locations are counted in full
only while their bound exceeds the most so far. Arrays of the box and the item are never changed;
`bounds` and `counted` are the caller's memory of what is known.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.geometry.bits import FULL, HIGH, LOW
from packit_sim.geometry.word_kernels import count_bits

_X, _Y, _Z = np.uint64(16), np.uint64(4), np.uint64(1)
"""Distances in bits between neighbours along x, y and z in a word."""

_MAX_NEIGHBOURS = 6

_FACE = np.int16(16)
"""Cells in a face of a brick."""

_AT_ONCE = 80
"""Bricks whose numbers of neighbours, at most 384 each, add up in 16 bits."""

_ACROSS_X, _ACROSS_Y, _ACROSS_Z = np.uint64(48), np.uint64(12), np.uint64(3)
"""Distances in bits between the first cell of a brick and the last of the brick before it."""


@kernel
def sum_neighbours(words):
    """Compute `contacts.Neighbours.sums`: each filled cell adds one to each of its neighbours."""
    nz, nx, ny = words.shape
    sums = np.zeros((nx, ny, nz), np.int16)
    sums[0] += _FACE
    sums[nx - 1] += _FACE
    sums[:, 0] += _FACE
    sums[:, ny - 1] += _FACE
    sums[:, :, 0] += _FACE
    for z in range(nz):
        for x in range(nx):
            for y in range(ny):
                own = words[z, x, y]
                if not own:
                    continue
                left, right = count_bits(own & LOW[0]), count_bits(own & HIGH[0])
                back, front = count_bits(own & LOW[1]), count_bits(own & HIGH[1])
                below, above = count_bits(own & LOW[2]), count_bits(own & HIGH[2])
                if x > 0:
                    sums[x - 1, y, z] += left
                if x + 1 < nx:
                    sums[x + 1, y, z] += right
                if y > 0:
                    sums[x, y - 1, z] += back
                if y + 1 < ny:
                    sums[x, y + 1, z] += front
                if z > 0:
                    sums[x, y, z - 1] += below
                if z + 1 < nz:
                    sums[x, y, z + 1] += above
                across = left + right + back + front + below + above
                sums[x, y, z] += _MAX_NEIGHBOURS * count_bits(own) - across
    return sums


@inner_kernel
def _digits(words, x, y, z):
    """Count the filled neighbours of each cell of a brick.

    Returns
    -------
    low, middle, high : uint64
        The binary digits of the number of each cell: six bits are added in parallel.
    """
    nz, nx, ny = words.shape
    own = words[z, x, y]
    left = words[z, x - 1, y] if x > 0 else FULL
    right = words[z, x + 1, y] if x + 1 < nx else FULL
    back = words[z, x, y - 1] if y > 0 else FULL
    front = words[z, x, y + 1] if y + 1 < ny else FULL
    below = words[z - 1, x, y] if z > 0 else FULL
    above = words[z + 1, x, y] if z + 1 < nz else np.uint64(0)
    if not own | left | right | back | front | below | above:
        return np.uint64(0), np.uint64(0), np.uint64(0)
    # Along x neighbours leave the word by themselves; along y and z masks keep rows apart.
    a = own << _X | left >> _ACROSS_X
    b = own >> _X | (right & LOW[0]) << _ACROSS_X
    c = (own & ~HIGH[1]) << _Y | (back & HIGH[1]) >> _ACROSS_Y
    d = (own & ~LOW[1]) >> _Y | (front & LOW[1]) << _ACROSS_Y
    e = (own & ~HIGH[2]) << _Z | (below & HIGH[2]) >> _ACROSS_Z
    f = (own & ~LOW[2]) >> _Z | (above & LOW[2]) << _ACROSS_Z
    # Two full adders, and the sum of their results: at most 6, so three digits.
    one, other = a ^ b ^ c, d ^ e ^ f
    two, two_more = a & b | c & (a ^ b), d & e | f & (d ^ e)
    carried = one & other
    return one ^ other, two ^ two_more ^ carried, two & two_more | carried & (two ^ two_more)


@kernel
def offsets_in(bricks, shape):
    """Return by how much the number of each brick exceeds that of its location.

    Parameters
    ----------
    bricks : numpy.ndarray
        Int16 (n, 3), see `voxels.Voxels`.
    shape : tuple of int
        Bricks of the box along x, y and z, which are numbered in C order.

    Returns
    -------
    numpy.ndarray
        Int32 (n,).
    """
    offsets = np.empty(len(bricks), np.int32)
    for n in range(len(bricks)):
        offsets[n] = (bricks[n, 0] * shape[1] + bricks[n, 1]) * shape[2] + bricks[n, 2]
    return offsets


@kernel
def bound_contacts(sums, outer, offsets, runs, mask):
    """Compute upper bounds of the contacts at the locations of a mask.

    Parameters
    ----------
    sums : numpy.ndarray
        Int16 [x, y, z], see `contacts.Neighbours`.
    outer : Words
        The outer cells of each of the item's bricks, (n,).
    offsets : numpy.ndarray
        Int32 (n,), see `offsets_in`.
    runs : CellRuns
        Runs of nodes, see `column_runs`.

    mask : Mask
        Bool [x, y, z], the locations to bound; the runs cover them.

    Returns
    -------
    locations : numpy.ndarray
        Int64 (n, 3), the True locations of the mask in the order of (z, x, y).
    bounds : numpy.ndarray
        Int32 (n,), no less than the contacts there.
    """
    nx, ny, nz = mask.shape
    dense = np.zeros(mask.size, np.int32)
    part = np.empty(mask.size, np.int16)
    there = sums.ravel()
    # Brick by brick over long runs of nodes. Sums of 80 bricks fit in 16 bits, of which a vector
    # instruction adds twice as many as of 32.
    for begin, end in runs:
        total, some = dense[begin:end], part[begin:end]
        for first in range(0, len(offsets), _AT_ONCE):
            some[:] = 0
            for n in range(first, min(first + _AT_ONCE, len(offsets))):
                limit = np.int16(_MAX_NEIGHBOURS * count_bits(outer[n]))
                counts = there[begin + offsets[n] : end + offsets[n]]
                for m in range(len(some)):
                    some[m] += min(counts[m], limit)
            for m in range(len(total)):
                total[m] += some[m]
    count = mask.sum()
    locations = np.empty((count, 3), np.int64)
    bounds = np.empty(count, np.int32)
    n = 0
    for k in range(nz):
        for i in range(nx):
            for j in range(ny):
                if mask[i, j, k]:
                    locations[n, 0], locations[n, 1], locations[n, 2] = i, j, k
                    bounds[n] = dense[(i * ny + j) * nz + k]
                    n += 1
    return locations, bounds


@kernel
def most_contacts(filled, item, locations, first_bounds, bounds, counted):
    """Find the first of the locations with the most contacts.

    Parameters
    ----------
    filled : tuple
        The fields of `contacts.Neighbours`.
    item : tuple
        The item's bricks and their outer cells (see `voxels.Voxels`), and their offsets.
    locations : numpy.ndarray
        Int64 (n, 3), the locations.
    first_bounds : numpy.ndarray
        Int32 (n,), as returned by `bound_contacts`.
    bounds : numpy.ndarray
        Int32 (n,), at first the same. Tighter bounds replace them, in the end the contacts
        themselves; -1 for a location that is not to be found.
    counted : numpy.ndarray
        Bool (n,), where the contacts are known; updated.

    Returns
    -------
    int
        The number of the location, whose bound is then its contacts; -1 if there is none.
    """
    # The location of the highest bound first: its contacts exclude most others.
    found = -1
    for n in range(len(bounds)):
        if bounds[n] > (bounds[found] if found >= 0 else -1):
            found = n
    if found < 0:
        return -1
    known = (first_bounds, bounds, counted)
    most = _contacts(filled, item, locations, known, found, 0) - 1
    for n in range(len(bounds)):
        if bounds[n] > most:
            count = _contacts(filled, item, locations, known, n, most + 1)
            if count > most:
                most, found = count, n
    return found


@inner_kernel
def _contacts(filled, item, locations, known, number, least):
    """Return the contacts at a location, or a bound of them that is less than `least`.

    The contacts of one brick after the other replace its bound in the sum.
    """
    first_bounds, bounds, counted = known
    if counted[number]:
        return np.int64(bounds[number])
    words, sums = filled
    bricks, outer, offsets = item
    i, j, k = locations[number]
    _, ny, nz = sums.shape
    start, there = (i * ny + j) * nz + k, sums.reshape(-1)
    total = np.int64(first_bounds[number])
    for n in range(len(offsets)):
        neighbours = np.int64(there[start + offsets[n]])
        if neighbours:
            low, middle, high = _digits(words, i + bricks[n, 0], j + bricks[n, 1], k + bricks[n, 2])
            own = outer[n]
            total -= min(neighbours, _MAX_NEIGHBOURS * count_bits(own))
            total += count_bits(own & low)
            total += 2 * count_bits(own & middle) + 4 * count_bits(own & high)
            if total < least:
                bounds[number] = total
                return total
    bounds[number] = total
    counted[number] = True
    return total
