"""Kernels for how deep points of one surface are in another item, by its signed distances.

Each type has a grid of signed distances around its solid and some points spread over its surface
(`voxel_sets`). The least distance of the points of either item in the grid of the other estimates
how deep two items overlap, and the gradient of the trilinear interpolation there is the way out.
This is the usual point-against-distance-field test of collision detection; for an item of many
triangles it costs a small part of what its surfaces do.

It is an estimate: an edge may pass between points, and voxels are wrong by about half a cell. The
points of both items are needed: a spike's tip may be in a plate that has no point in the spike.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel

STEPS = 64.0
"""Steps of the stored distances per cell."""


@inner_kernel
def least_distance(distances, first, other, turn, sx, sy, sz):
    """Compute the least signed distance of points of two surfaces to the other item.

    Parameters
    ----------
    distances : Distances
        The distances of all types, and points of their surfaces.
    first, other : int
        The types.
    turn : ndarray
        (3, 3) float64, the other's rotation in the first's frame.
    sx, sy, sz : float
        The other's origin in the first's frame.

    Returns
    -------
    float
        The distance, negative inside; at most the margin of the grids.
    float
    float
    float
        Its gradient for moves of the other's origin.
    """
    found = distances.margin
    dx, dy, dz = 0.0, 0.0, 0.0
    points = distances.points
    px, py, pz = distances.placed[:, 0], distances.placed[:, 1], distances.placed[:, 2]
    reached, listed = distances.reached, distances.listed
    xa, xb, xc, xs = turn[0, 0], turn[0, 1], turn[0, 2], sx
    ya, yb, yc, ys = turn[1, 0], turn[1, 1], turn[1, 2], sy
    za, zb, zc, zs = turn[2, 0], turn[2, 1], turn[2, 2], sz
    for side in range(2):  # points of the other in the first, then of the first in the other
        around, inside = (first, other) if side == 0 else (other, first)
        values = distances.values
        start = distances.starts[around]
        u, v, w = distances.dims[around, 0], distances.dims[around, 1], distances.dims[around, 2]
        cell = distances.cells[around]
        scale = cell / STEPS
        per_cell = 1 / cell
        if side == 1:  # the inverse motion: the transposed rotation, and -R^T s
            xa, xb, xc, ya, yb, yc, za, zb, zc = xa, ya, za, xb, yb, zb, xc, yc, zc
            xs, ys, zs = (
                -(xa * sx + xb * sy + xc * sz),
                -(ya * sx + yb * sy + yc * sz),
                -(za * sx + zb * sy + zc * sz),
            )
        begin, end = distances.point_starts[inside], distances.point_starts[inside + 1]
        pa, pb, pc = points[begin:end, 0], points[begin:end, 1], points[begin:end, 2]
        # Two loops without branches: the first places several points at a time, if their columns
        # are known to be contiguous.
        for n in range(len(pa)):
            a, b, c = pa[n], pb[n], pc[n]
            x = (xa * a + xb * b + xc * c + xs) * per_cell + (u - 1) * 0.5
            y = (ya * a + yb * b + yc * c + ys) * per_cell + (v - 1) * 0.5
            z = (za * a + zb * b + zc * c + zs) * per_cell + (w - 1) * 0.5
            px[n], py[n], pz[n] = x, y, z
            reached[n] = (x >= 0) & (x < u - 1) & (y >= 0) & (y < v - 1) & (z >= 0) & (z < w - 1)
        count = 0
        for n in range(len(pa)):
            listed[count] = n
            count += reached[n]
        for m in range(count):
            n = listed[m]
            x, y, z = px[n], py[n], pz[n]
            i, j, k = int(x), int(y), int(z)
            at = start + (i * v + j) * w + k
            # A distance changes by at most the way: within a cell by sqrt(3) cells, less than 2.
            if (values[at] - 2 * STEPS) * scale >= found:
                continue
            fx, fy, fz = x - i, y - j, z - k
            gx, gy, gz = 1 - fx, 1 - fy, 1 - fz
            low = (values[at] * gz + values[at + 1] * fz) * gy + (
                values[at + w] * gz + values[at + w + 1] * fz
            ) * fy
            at += v * w
            high = (values[at] * gz + values[at + 1] * fz) * gy + (
                values[at + w] * gz + values[at + w + 1] * fz
            ) * fy
            value = (low * gx + high * fx) * scale
            if value < found:
                found = value
                at -= v * w
                dx = high - low
                dy = (
                    (values[at + w] - values[at]) * gz + (values[at + w + 1] - values[at + 1]) * fz
                ) * gx + (
                    (values[at + v * w + w] - values[at + v * w]) * gz
                    + (values[at + v * w + w + 1] - values[at + v * w + 1]) * fz
                ) * fx
                dz = (
                    (values[at + 1] - values[at]) * gy + (values[at + w + 1] - values[at + w]) * fy
                ) * gx + (
                    (values[at + v * w + 1] - values[at + v * w]) * gy
                    + (values[at + v * w + w + 1] - values[at + v * w + w]) * fy
                ) * fx
                if side == 1:  # from moves of the points to moves of the other's origin
                    dx, dy, dz = (
                        -(xa * dx + ya * dy + za * dz),
                        -(xb * dx + yb * dy + zb * dz),
                        -(xc * dx + yc * dy + zc * dz),
                    )
    return found, dx / STEPS, dy / STEPS, dz / STEPS


@kernel
def farthest_points(points, count):
    """Choose points one after the other, each the farthest from those before (Gonzalez, 1985).

    Parameters
    ----------
    points : ndarray
        (n, 3) float64.
    count : int
        The number of points to choose.

    Returns
    -------
    ndarray
        (count,) int64, their indices; the first is the farthest from the origin.
    """
    chosen = np.empty(count, np.int64)
    gaps = (points**2).sum(axis=1)
    for n in range(count):
        last = chosen[n] = np.argmax(gaps)
        if n == 0:  # until now the gaps were distances to the origin, for the first choice
            gaps[:] = np.inf
        for m in range(len(points)):
            x = points[m, 0] - points[last, 0]
            y = points[m, 1] - points[last, 1]
            z = points[m, 2] - points[last, 2]
            gaps[m] = min(gaps[m], x * x + y * y + z * z)
    return chosen
