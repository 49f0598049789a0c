"""Kernel of lattices: how many equal boxes at the points of a lattice are free, by its offset."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel


@kernel
def lattice_counts(sums, voxel, size, sides, pitches, steps, slack):
    """Return how many boxes of a lattice are free, for all of its offsets.

    Parameters
    ----------
    sums : ndarray
        int32 (x + 1, y + 1, z + 1), how many voxels below each corner are blocked.
    voxel : float
        The side of the voxels.
    size : ndarray
        (3,) float64, the sides of the space.
    sides, pitches : ndarray
        (3,) float64, the sides of the boxes, and the distances of the lattice's points.
    steps : ndarray
        (3,) int64, offsets along each axis.
    slack : float
        By how much a box is made smaller at each side before its voxels are looked up.

    Returns
    -------
    ndarray
        int64 (sx, sy, sz), the counts.
    """
    counts = np.zeros((steps[0], steps[1], steps[2]), np.int64)
    most = np.int64(2)
    for axis in range(3):
        most = max(most, np.int64(size[axis] / pitches[axis]) + 2)
    first = np.zeros((3, most), np.int64)
    last = np.zeros((3, most), np.int64)
    number = np.zeros(3, np.int64)
    for i in range(steps[0]):
        for j in range(steps[1]):
            for k in range(steps[2]):
                for axis in range(3):
                    n = i if axis == 0 else (j if axis == 1 else k)
                    low = pitches[axis] * n / steps[axis]
                    number[axis] = 0
                    while low + sides[axis] <= size[axis] + slack:
                        first[axis, number[axis]] = np.int64((low + slack) / voxel)
                        high = np.int64(np.ceil((low + sides[axis] - slack) / voxel))
                        if high > sums.shape[axis] - 1:
                            high = np.int64(sums.shape[axis] - 1)
                        last[axis, number[axis]] = high
                        number[axis] += 1
                        low += pitches[axis]
                count = np.int64(0)
                for x in range(number[0]):
                    for y in range(number[1]):
                        for z in range(number[2]):
                            a, d = first[0, x], last[0, x]
                            b, e = first[1, y], last[1, y]
                            c, f = first[2, z], last[2, z]
                            blocked = sums[d, e, f] - sums[a, e, f] - sums[d, b, f] - sums[d, e, c]
                            blocked += sums[a, b, f] + sums[a, e, c] + sums[d, b, c] - sums[a, b, c]
                            count += blocked == 0
                counts[i, j, k] = count
    return counts
