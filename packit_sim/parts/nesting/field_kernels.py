"""Kernels for penetration fields: how deep two items overlap, for every offset between them.

Two items with a relative rotation overlap at a set of offsets: the interior of their no-fit
polyhedron, the Minkowski sum of one and the reflected other. A *field* approximates it by voxels: a
lattice of offsets, each with its distance to the boundary of the set, negative inside. The set is
computed by shifting the first item's voxels by those of the second, a run of voxels and 64 offsets
at a time; distances by the separable Euclidean distance transform, one axis after the other
(Saito and Toriwaki, 1994). Runs and words are our own.

A node holds a distance less the clearance, in steps of 1 / `SCALE` voxel, times two; the lowest bit
is 1 if the value is final (see `encoded`). Where it is 0, the surfaces may replace it, once. All
values are estimates: voxels count whole if touched, which `BIAS` compensates on average only.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inlined, inner_kernel

SCALE = 128.0
"""Steps of the stored distances per voxel."""

BIAS = 0.9
"""Voxels by which two sets of voxels are on average closer to each other than their items."""

REACH = 3
"""Voxels beyond the clearance up to which a field holds distances."""

_BAND = -4.0, 2.0
"""Distances in voxels between which nodes may be computed by the surfaces."""


@inner_kernel
def padding(clearance):
    """Return the nodes of a field around the offsets at which voxels overlap."""
    return int(np.ceil(clearance)) + REACH


@allocating_kernel
def fill_field(one, other, clearance, out):
    """Compute the signed distance to the offsets at which two sets of voxels overlap.

    Parameters
    ----------
    one, other : ndarray
        (x, y, z) uint8, 1 for the voxels of two items.
    clearance : float
        The distance to keep, in voxels.
    out : ndarray
        (u, v, w) int16, filled with the signed distances of the offsets, less the clearance (see
        `encoded`). Node m is the offset (m - (u - 1) / 2) voxels from the centre of the first to
        that of the second.
    """
    around = padding(clearance)
    overlap = _overlaps(one, other, around, out.shape)
    u, v, w = overlap.shape
    # Depths are needed in full, for a descent from deep inside; distances only up to the padding.
    rim = around - 1  # beyond it, no node overlaps
    inner = overlap[rim : u - rim, rim : v - rim, rim : w - rim].copy()
    deepest = min(inner.shape) // 2
    inside = _squared_distances(inner, np.uint8(0), deepest)
    outside = _squared_distances(overlap, np.uint8(1), around + 1)
    depths = _encoded_roots(deepest, -1.0, clearance)
    distances = _encoded_roots(around + 1, 1.0, clearance)
    for x in range(u):
        for y in range(v):
            for z in range(w):
                out[x, y, z] = distances[outside[x, y, z]]
    for x in range(inner.shape[0]):
        for y in range(inner.shape[1]):
            for z in range(inner.shape[2]):
                if inner[x, y, z]:
                    out[x + rim, y + rim, z + rim] = depths[inside[x, y, z]]


@allocating_kernel
def _encoded_roots(limit, sign, clearance):
    """Return the values of nodes by their squared distance, up to that of a limit in voxels."""
    found = np.empty(limit * limit + 1, np.int16)
    for n in range(len(found)):
        # Half a step: the boundary is between a node inside and the next one outside.
        distance = sign * (np.sqrt(np.float32(n)) - 0.5) + (BIAS - clearance)
        found[n] = encoded(distance, not _BAND[0] < distance < _BAND[1])
    return found


@allocating_kernel
def _overlaps(one, other, around, shape):
    """Return the offsets (u, v, w) uint8 at which two sets of voxels overlap.

    Runs of the second item along z are handled by length: the first item's rows, dilated by the
    length, stand for all voxels of such a run at once.
    """
    ax, ay, az = one.shape
    bx, by, bz = other.shape
    words = (shape[2] + 63) // 64
    out = np.zeros((shape[0], shape[1], words), np.uint64)
    longest = 0
    runs = np.empty((bx * by * (bz // 2 + 1), 4), np.int64)
    count = 0
    for x in range(bx):
        for y in range(by):
            z = 0
            while z < bz:
                if other[x, y, z]:
                    start = z
                    while z < bz and other[x, y, z]:
                        z += 1
                    runs[count] = (x, y, z - 1, z - start)
                    longest = max(longest, z - start)
                    count += 1
                else:
                    z += 1
    rows = np.zeros((ax, ay, words), np.uint64)
    used = np.zeros((ax, ay), np.uint8)
    for x in range(ax):
        for y in range(ay):
            for z in range(az):
                if one[x, y, z]:
                    rows[x, y, z >> 6] |= np.uint64(1) << np.uint64(z & 63)
                    used[x, y] = 1
    # By length, so that one more dilation of the same rows serves the next length.
    for length in range(1, longest + 1):
        if length > 1:
            _dilate(rows, one, length)
        for n in range(count):
            if runs[n, 3] != length:
                continue
            shift = bz - 1 - runs[n, 2] + around
            big = shift >> 6
            small = np.uint64(shift & 63)
            for x in range(ax):
                tx = x - runs[n, 0] + bx - 1 + around
                for y in range(ay):
                    if not used[x, y]:
                        continue
                    ty = y - runs[n, 1] + by - 1 + around
                    for k in range(words - big):
                        word = rows[x, y, k]
                        if word == 0:
                            continue
                        # A shift by 64 is undefined, so the carry is only taken if small > 0.
                        out[tx, ty, k + big] |= word << small
                        if small and k + big + 1 < words:
                            out[tx, ty, k + big + 1] |= word >> (np.uint64(64) - small)
    found = np.zeros(shape, np.uint8)
    for x in range(shape[0]):
        for y in range(shape[1]):
            for z in range(shape[2]):
                found[x, y, z] = (out[x, y, z >> 6] >> np.uint64(z & 63)) & np.uint64(1)
    return found


@inner_kernel
def _dilate(rows, one, length):
    """Add to the rows of words the voxels, shifted up by length - 1."""
    ax, ay, az = one.shape
    for x in range(ax):
        for y in range(ay):
            for z in range(az):
                if one[x, y, z]:
                    t = z + length - 1
                    rows[x, y, t >> 6] |= np.uint64(1) << np.uint64(t & 63)


@allocating_kernel
def _squared_distances(cells, value, limit):
    """Return the squared distance (u, v, w) of each cell to the nearest one of a value, bounded."""
    u, v, w = cells.shape
    first = np.empty(cells.shape, np.int32)
    for x in range(u):
        for y in range(v):
            last = -limit
            for z in range(w):
                if cells[x, y, z] == value:
                    last = z
                first[x, y, z] = min(limit, z - last) ** 2
            last = w + limit
            for z in range(w - 1, -1, -1):
                if cells[x, y, z] == value:
                    last = z
                first[x, y, z] = min(first[x, y, z], (last - z) ** 2)
    # A plane, or all of them, at a time: loops of one node, or one row, are slower.
    second = first.copy()
    for x in range(u):
        source, target = first[x].ravel(), second[x].ravel()
        for step in range(1, min(limit + 1, v)):
            _spread(source, target, step * w, np.int32(step**2))
    third = second.copy()
    for step in range(1, min(limit + 1, u)):
        _spread(second.ravel(), third.ravel(), step * v * w, np.int32(step**2))
    return third


@inlined
def _spread(values, out, step, added):
    """Lower numbers to those a step before and after them, with an addition."""
    _lower(values[:-step], out[step:], added)
    _lower(values[step:], out[:-step], added)


@inner_kernel
def _lower(values, out, added):
    for n in range(len(out)):
        out[n] = min(out[n], values[n] + added)


@inner_kernel
def encoded(distance, is_final):
    """Return a distance in voxels as an int16; its lowest bit says that it is final."""
    steps = round(distance * SCALE)
    # Clamped, so that twice the steps fit; no search needs distances of 125 voxels.
    return np.int16(2 * max(-16000, min(16000, steps)) + is_final)


@inner_kernel
def decoded(value):
    """Return the distance of a stored value, in voxels."""
    return (value >> 1) / SCALE
