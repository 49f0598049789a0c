"""Kernels that decide whether two surfaces cross, by their trees of triangles."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel

STACK = 512
"""Pairs of nodes that can wait."""


@inner_kernel
def surfaces_cross(
    one, one_boxes, one_starts, other, other_boxes, other_starts, turn, shift, waiting, triangle
):
    """Return whether a triangle of one surface crosses one of another.

    Parameters
    ----------
    one, other : ndarray
        (n, 3, 3) float64, the corners of the triangles, each surface in its own frame.
    one_boxes, other_boxes : ndarray
        (2 leaves, 2, 3) float64, the boxes of their trees (see `triangle_trees`).
    one_starts, other_starts : ndarray
        (leaves + 1,) int64, where each leaf's triangles start.
    turn : ndarray
        (3, 3) float64, the rotation from the other's frame to the one's.
    shift : ndarray
        (3,) float64, the other's origin in the one's frame.
    waiting, triangle : ndarray
        (STACK, 2) int64 and (3, 3) float64, work arrays.

    Returns
    -------
    bool
        Whether there are such triangles.
    """
    one_leaves = len(one_starts) - 1
    other_leaves = len(other_starts) - 1
    waiting[0, 0] = 1
    waiting[0, 1] = 1
    top = 1
    while top:
        top -= 1
        a, b = waiting[top]
        if _boxes_apart(one_boxes[a], other_boxes[b], turn, shift):
            continue
        if a >= one_leaves and b >= other_leaves:
            for m in range(other_starts[b - other_leaves], other_starts[b - other_leaves + 1]):
                _transform(other[m], turn, shift, triangle)
                for n in range(one_starts[a - one_leaves], one_starts[a - one_leaves + 1]):
                    if triangles_cross(one[n], triangle):
                        return True
        elif b >= other_leaves or (
            a < one_leaves and _diagonal(one_boxes[a]) > _diagonal(other_boxes[b])
        ):
            waiting[top] = (2 * a, b)
            waiting[top + 1] = (2 * a + 1, b)
            top += 2
        else:
            waiting[top] = (a, 2 * b)
            waiting[top + 1] = (a, 2 * b + 1)
            top += 2
    return False


@inner_kernel
def _diagonal(box):
    """Return the squared diagonal of a box (2, 3)."""
    return (
        (box[1, 0] - box[0, 0]) ** 2 + (box[1, 1] - box[0, 1]) ** 2 + (box[1, 2] - box[0, 2]) ** 2
    )


@inner_kernel
def _boxes_apart(one, other, turn, shift):
    """Return whether the axes of the one's frame separate its box (2, 3) from the other's."""
    for d in range(3):
        middle = shift[d]
        half = 0.0
        for e in range(3):
            middle += turn[d, e] * (other[0, e] + other[1, e]) * 0.5
            half += abs(turn[d, e]) * (other[1, e] - other[0, e]) * 0.5
        if middle - half > one[1, d] or middle + half < one[0, d]:
            return True
    return False


@inner_kernel
def _transform(corners, turn, shift, out):
    """Write the rotated and translated corners (3, 3) of a triangle to `out`."""
    for c in range(3):
        for d in range(3):
            out[c, d] = shift[d] + (
                turn[d, 0] * corners[c, 0] + turn[d, 1] * corners[c, 1] + turn[d, 2] * corners[c, 2]
            )


@inner_kernel
def triangles_cross(one, other):
    """Return whether an edge of one of two triangles (3, 3) passes through the other."""
    for d in range(3):
        if max(one[0, d], one[1, d], one[2, d]) < min(other[0, d], other[1, d], other[2, d]):
            return False
        if min(one[0, d], one[1, d], one[2, d]) > max(other[0, d], other[1, d], other[2, d]):
            return False
    return _edges_pass(one, other) or _edges_pass(other, one)


@inner_kernel
def _edges_pass(one, other):
    """Return whether an edge of a triangle passes through another triangle."""
    ux, uy, uz = other[1, 0] - other[0, 0], other[1, 1] - other[0, 1], other[1, 2] - other[0, 2]
    vx, vy, vz = other[2, 0] - other[0, 0], other[2, 1] - other[0, 1], other[2, 2] - other[0, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    s0 = _height(one[0], other[0], nx, ny, nz)
    s1 = _height(one[1], other[0], nx, ny, nz)
    s2 = _height(one[2], other[0], nx, ny, nz)
    if (s0 > 0 and s1 > 0 and s2 > 0) or (s0 < 0 and s1 < 0 and s2 < 0):
        return False
    return (
        _passes(one[0], one[1], s0, s1, other, nx, ny, nz)
        or _passes(one[1], one[2], s1, s2, other, nx, ny, nz)
        or _passes(one[2], one[0], s2, s0, other, nx, ny, nz)
    )


@inner_kernel
def _height(point, origin, nx, ny, nz):
    """Return the height of a point above a plane, times the length of its normal."""
    return (point[0] - origin[0]) * nx + (point[1] - origin[1]) * ny + (point[2] - origin[2]) * nz


@inner_kernel
def _passes(start, end, s, e, triangle, nx, ny, nz):
    """Return whether a segment with ends of heights s and e passes through a triangle."""
    if (s > 0) == (e > 0) or s == e:
        return False
    t = s / (s - e)
    px = start[0] + t * (end[0] - start[0])
    py = start[1] + t * (end[1] - start[1])
    pz = start[2] + t * (end[2] - start[2])
    for c in range(3):
        a, b = triangle[c], triangle[(c + 1) % 3]
        ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        qx, qy, qz = px - a[0], py - a[1], pz - a[2]
        side = (ey * qz - ez * qy) * nx + (ez * qx - ex * qz) * ny + (ex * qy - ey * qx) * nz
        if side < 0:
            return False
    return True


@inner_kernel
def surfaces_distance(
    one,
    one_boxes,
    one_starts,
    other,
    other_boxes,
    other_starts,
    turn,
    shift,
    waiting,
    triangle,
    limit,
):
    """Return the distance of two surfaces that don't cross, or the limit if it is more.

    Parameters
    ----------
    one, one_boxes, one_starts, other, other_boxes, other_starts, turn, shift, waiting, triangle
        As in `surfaces_cross`.
    limit : float
        The largest distance of interest.

    Returns
    -------
    float
        The distance.
    """
    one_leaves = len(one_starts) - 1
    other_leaves = len(other_starts) - 1
    waiting[0, 0] = 1
    waiting[0, 1] = 1
    top = 1
    best = limit * limit
    while top:
        top -= 1
        a, b = waiting[top]
        if _boxes_gap(one_boxes[a], other_boxes[b], turn, shift) >= best:
            continue
        if a >= one_leaves and b >= other_leaves:
            for m in range(other_starts[b - other_leaves], other_starts[b - other_leaves + 1]):
                _transform(other[m], turn, shift, triangle)
                for n in range(one_starts[a - one_leaves], one_starts[a - one_leaves + 1]):
                    best = min(best, triangles_gap(one[n], triangle))
        elif b >= other_leaves or (
            a < one_leaves and _diagonal(one_boxes[a]) > _diagonal(other_boxes[b])
        ):
            waiting[top] = (2 * a, b)
            waiting[top + 1] = (2 * a + 1, b)
            top += 2
        else:
            waiting[top] = (a, 2 * b)
            waiting[top + 1] = (a, 2 * b + 1)
            top += 2
    return np.sqrt(best)


@inner_kernel
def _boxes_gap(one, other, turn, shift):
    """Return at most the squared distance between a box and another one, rotated."""
    total = 0.0
    for d in range(3):
        middle = shift[d]
        half = 0.0
        for e in range(3):
            middle += turn[d, e] * (other[0, e] + other[1, e]) * 0.5
            half += abs(turn[d, e]) * (other[1, e] - other[0, e]) * 0.5
        gap = max(middle - half - one[1, d], one[0, d] - middle - half, 0.0)
        total += gap * gap
    return total


@inner_kernel
def triangles_gap(one, other):
    """Return the squared distance of two triangles (3, 3) that don't cross."""
    best = 1e300
    for m in range(3):
        for n in range(3):
            best = min(best, segments_gap(one[m], one[(m + 1) % 3], other[n], other[(n + 1) % 3]))
    for n in range(3):
        best = min(best, _face_gap(other[n], one), _face_gap(one[n], other))
    return best


@inner_kernel
def _face_gap(point, triangle):
    """Return the squared distance of a point above the inside of a triangle, else a large one."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = point[0] - a[0], point[1] - a[1], point[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    square = nx * nx + ny * ny + nz * nz
    if square == 0:
        return 1e300
    s = (wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz
    t = (uy * wz - uz * wy) * nx + (uz * wx - ux * wz) * ny + (ux * wy - uy * wx) * nz
    if s < 0 or t < 0 or s + t > square:
        return 1e300
    height = wx * nx + wy * ny + wz * nz
    return height * height / square


@inner_kernel
def segments_gap(p, q, r, s):
    """Return the squared distance of two segments, from p to q and from r to s."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = s[0] - r[0], s[1] - r[1], s[2] - r[2]
    wx, wy, wz = p[0] - r[0], p[1] - r[1], p[2] - r[2]
    a = ux * ux + uy * uy + uz * uz
    b = ux * vx + uy * vy + uz * vz
    c = vx * vx + vy * vy + vz * vz
    d = ux * wx + uy * wy + uz * wz
    e = vx * wx + vy * wy + vz * wz
    det = a * c - b * b
    m = 0.0
    if det > 1e-14 * a * c:
        m = min(1.0, max(0.0, (b * e - c * d) / det))
    n = (b * m + e) / c if c > 0 else 0.0
    if n < 0:
        n = 0.0
        m = min(1.0, max(0.0, -d / a)) if a > 0 else 0.0
    elif n > 1:
        n = 1.0
        m = min(1.0, max(0.0, (b - d) / a)) if a > 0 else 0.0
    x, y, z = wx + m * ux - n * vx, wy + m * uy - n * vy, wz + m * uz - n * vz
    return x * x + y * y + z * z
