"""Kernels for two surfaces: whether they cross, and how far apart they are, by trees of triangles.

Two complete binary trees of boxes (`triangle_trees`) are descended together: of a pair of nodes
whose boxes meet, the larger is replaced by its children, down to pairs of leaves, as in Gottschalk,
Lin and Manocha's OBBTree (1996). The second tree is not rotated: its boxes are bounded along the
axes of the first, which is quick and conservative, so that a pair is only left out if it is apart.

*Crossing* means that an edge of one triangle passes through the other: it does if its ends are on
both sides of the plane (heights of unequal sign), and its point on the plane is on the inner side
of all edges. This is Moeller's first step (1997), followed by a test of each edge. Coplanar
triangles do not cross: surfaces that only touch are no conflict, and the unequal drawing in of
a pair keeps equal items from coinciding (`build.DRAWN_IN`). Rounding is not bounded here: the
surfaces are drawn in by less than the tolerance, and the check of a packing has the last word.

*Distance* is the least over pairs of edges (Ericson, 2005, closest points of two segments) and over
corners above the inside of a triangle, which is complete for triangles that don't cross. Each edge
and corner is measured for one of its triangles only (`owned`): a quarter of the pairs of edges.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel

STACK = 512
"""Pairs of nodes that can wait: depth first, two trees add at most one for each level."""


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
        True if there are such triangles.
    """
    one_leaves = len(one_starts) - 1
    other_leaves = len(other_starts) - 1
    waiting[0, 0] = 1
    waiting[0, 1] = 1
    top = 1
    while top:
        top -= 1
        a, b = waiting[top, 0], waiting[top, 1]  # the last pair first: depth before breadth
        if _boxes_apart(one_boxes, a, other_boxes, b, turn, shift):
            continue
        if a >= one_leaves and b >= other_leaves:
            for m in range(other_starts[b - other_leaves], other_starts[b - other_leaves + 1]):
                _transform(other, m, turn, shift, triangle)
                for n in range(one_starts[a - one_leaves], one_starts[a - one_leaves + 1]):
                    if _bounds_meet(one, n, triangle) and triangles_cross(one[n], triangle):
                        return True
        elif b >= other_leaves or (
            a < one_leaves and _diagonal(one_boxes, a) > _diagonal(other_boxes, b)
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
def _diagonal(boxes, a):
    """Return the squared diagonal of one of the boxes (n, 2, 3)."""
    total = 0.0
    for d in range(3):
        total += (boxes[a, 1, d] - boxes[a, 0, d]) ** 2
    return total


@inner_kernel
def _boxes_apart(one, a, other, b, turn, shift):
    """Return whether the axes of the one's frame separate its box a from the other's b."""
    for d in range(3):
        middle = shift[d]
        half = 0.0
        for e in range(3):
            middle += turn[d, e] * (other[b, 0, e] + other[b, 1, e]) * 0.5
            half += abs(turn[d, e]) * (other[b, 1, e] - other[b, 0, e]) * 0.5
        if middle - half > one[a, 1, d] or middle + half < one[a, 0, d]:
            return True
    return False


@inner_kernel
def _transform(corners, m, turn, shift, out):
    """Write the rotated and translated corners (3, 3) of triangle m to `out`."""
    for c in range(3):
        x, y, z = corners[m, c, 0], corners[m, c, 1], corners[m, c, 2]
        for d in range(3):
            out[c, d] = shift[d] + (turn[d, 0] * x + turn[d, 1] * y + turn[d, 2] * z)


@inner_kernel
def _bounds_meet(one, n, other):
    """Return whether the bounding boxes of triangle n and of another one (3, 3) meet."""
    for d in range(3):
        a, b, c = one[n, 0, d], one[n, 1, d], one[n, 2, d]
        x, y, z = other[0, d], other[1, d], other[2, d]
        if max(a, b, c) < min(x, y, z) or min(a, b, c) > max(x, y, z):
            return False
    return True


@inner_kernel
def triangles_cross(one, other):
    """Return whether an edge of one of two triangles (3, 3) passes through the other."""
    if _is_on_one_side(one, other) or _is_on_one_side(other, one):
        return False
    return _edges_pass(one, other) or _edges_pass(other, one)


@inner_kernel
def _is_on_one_side(one, other):
    """Return whether all corners of a triangle are on one side of another triangle's plane."""
    # Strictly: a corner in the plane may be an end of an edge that passes through.
    nx, ny, nz = _normal(other)
    s0 = _height(one, 0, other, nx, ny, nz)
    s1 = _height(one, 1, other, nx, ny, nz)
    s2 = _height(one, 2, other, nx, ny, nz)
    return (s0 > 0 and s1 > 0 and s2 > 0) or (s0 < 0 and s1 < 0 and s2 < 0)


@inner_kernel
def _edges_pass(one, other):
    """Return whether an edge of a triangle passes through another triangle."""
    nx, ny, nz = _normal(other)
    s0 = _height(one, 0, other, nx, ny, nz)
    s1 = _height(one, 1, other, nx, ny, nz)
    s2 = _height(one, 2, other, nx, ny, nz)
    return (
        _passes(one, 0, 1, s0, s1, other, nx, ny, nz)
        or _passes(one, 1, 2, s1, s2, other, nx, ny, nz)
        or _passes(one, 2, 0, s2, s0, other, nx, ny, nz)
    )


@inner_kernel
def _normal(triangle):
    """Return the normal (3) of a triangle, of twice the length of its area."""
    ax, ay, az = triangle[0, 0], triangle[0, 1], triangle[0, 2]
    ux, uy, uz = triangle[1, 0] - ax, triangle[1, 1] - ay, triangle[1, 2] - az
    vx, vy, vz = triangle[2, 0] - ax, triangle[2, 1] - ay, triangle[2, 2] - az
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@inner_kernel
def _height(corners, n, triangle, nx, ny, nz):
    """Return the height of a corner above a triangle's plane, times the length of its normal."""
    x = corners[n, 0] - triangle[0, 0]
    y = corners[n, 1] - triangle[0, 1]
    z = corners[n, 2] - triangle[0, 2]
    return x * nx + y * ny + z * nz


@inner_kernel
def _passes(corners, m, n, s, e, triangle, nx, ny, nz):
    """Return whether an edge between corners of heights s and e passes through a triangle."""
    # A height of 0 counts as below: an edge that ends in the plane passes from one side only.
    if (s > 0) == (e > 0) or s == e:
        return False
    t = s / (s - e)
    px = corners[m, 0] + t * (corners[n, 0] - corners[m, 0])
    py = corners[m, 1] + t * (corners[n, 1] - corners[m, 1])
    pz = corners[m, 2] + t * (corners[n, 2] - corners[m, 2])
    for c in range(3):
        d = (c + 1) % 3
        ax, ay, az = triangle[c, 0], triangle[c, 1], triangle[c, 2]
        ex, ey, ez = triangle[d, 0] - ax, triangle[d, 1] - ay, triangle[d, 2] - az
        qx, qy, qz = px - ax, py - ay, pz - az
        side = (ey * qz - ez * qy) * nx + (ez * qx - ex * qz) * ny + (ex * qy - ey * qx) * nz
        if side < 0:
            return False
    return True


@inner_kernel
def surfaces_distance(
    one,
    one_owned,
    one_boxes,
    one_starts,
    other,
    other_owned,
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
    one_owned, other_owned : ndarray
        (n,) uint8, which edges and corners count for each triangle (see `problem.Surfaces`).
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
        a, b = waiting[top, 0], waiting[top, 1]
        # Branch and bound: boxes as far apart as the best pair so far can't hold a nearer one.
        if _boxes_gap(one_boxes, a, other_boxes, b, turn, shift) >= best:
            continue
        if a >= one_leaves and b >= other_leaves:
            for m in range(other_starts[b - other_leaves], other_starts[b - other_leaves + 1]):
                _transform(other, m, turn, shift, triangle)
                for n in range(one_starts[a - one_leaves], one_starts[a - one_leaves + 1]):
                    if _bounds_gap(one, n, triangle) < best:
                        gap = triangles_gap(one[n], one_owned[n], triangle, other_owned[m])
                        best = min(best, gap)
        elif b >= other_leaves or (
            a < one_leaves and _diagonal(one_boxes, a) > _diagonal(other_boxes, b)
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
def _boxes_gap(one, a, other, b, turn, shift):
    """Return a lower bound of the squared distance of box a and the other's rotated box b."""
    total = 0.0
    for d in range(3):
        middle = shift[d]
        half = 0.0
        for e in range(3):
            middle += turn[d, e] * (other[b, 0, e] + other[b, 1, e]) * 0.5
            half += abs(turn[d, e]) * (other[b, 1, e] - other[b, 0, e]) * 0.5
        gap = max(middle - half - one[a, 1, d], one[a, 0, d] - middle - half, 0.0)
        total += gap * gap
    return total


@inner_kernel
def _bounds_gap(one, n, other):
    """Return the squared distance of the bounding boxes of triangle n and another one (3, 3)."""
    total = 0.0
    for d in range(3):
        a, b, c = one[n, 0, d], one[n, 1, d], one[n, 2, d]
        x, y, z = other[0, d], other[1, d], other[2, d]
        gap = max(min(a, b, c) - max(x, y, z), min(x, y, z) - max(a, b, c), 0.0)
        total += gap * gap
    return total


@inner_kernel
def triangles_gap(one, one_owned, other, other_owned):
    """Return the least squared distance of own edges and corners of triangles that don't cross."""
    best = 1e300
    for m in range(3):
        if not one_owned >> m & 1:
            continue
        for n in range(3):
            if other_owned >> n & 1:
                gap = edges_gap(one, m, other, n)
                best = min(best, gap)
    for n in range(3):
        if other_owned >> (3 + n) & 1:
            best = min(best, _face_gap(other, n, one))
        if one_owned >> (3 + n) & 1:
            best = min(best, _face_gap(one, n, other))
    return best


@inner_kernel
def _face_gap(corners, n, triangle):
    """Return the squared distance of a corner above the inside of a triangle, else a large one."""
    ax, ay, az = triangle[0, 0], triangle[0, 1], triangle[0, 2]
    ux, uy, uz = triangle[1, 0] - ax, triangle[1, 1] - ay, triangle[1, 2] - az
    vx, vy, vz = triangle[2, 0] - ax, triangle[2, 1] - ay, triangle[2, 2] - az
    wx, wy, wz = corners[n, 0] - ax, corners[n, 1] - ay, corners[n, 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    square = nx * nx + ny * ny + nz * nz
    if square == 0:  # a triangle without area: its edges decide
        return 1e300
    s = (wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz
    t = (uy * wz - uz * wy) * nx + (uz * wx - ux * wz) * ny + (ux * wy - uy * wx) * nz
    if s < 0 or t < 0 or s + t > square:
        return 1e300
    height = wx * nx + wy * ny + wz * nz
    return height * height / square


@inner_kernel
def edges_gap(one, m, other, n):
    """Return the squared distance of two triangles' edges, from corner m and n to the next one."""
    after, other_after = (m + 1) % 3, (n + 1) % 3
    px, py, pz = one[m, 0], one[m, 1], one[m, 2]
    rx, ry, rz = other[n, 0], other[n, 1], other[n, 2]
    ux, uy, uz = one[after, 0] - px, one[after, 1] - py, one[after, 2] - pz
    vx = other[other_after, 0] - rx
    vy = other[other_after, 1] - ry
    vz = other[other_after, 2] - rz
    wx, wy, wz = px - rx, py - ry, pz - rz
    a = ux * ux + uy * uy + uz * uz
    b = ux * vx + uy * vy + uz * vz
    c = vx * vx + vy * vy + vz * vz
    d = ux * wx + uy * wy + uz * wz
    e = vx * wx + vy * wy + vz * wz
    det = a * c - b * b
    s = 0.0
    if det > 1e-14 * a * c:  # else parallel, where any s is as good if t is clamped to it
        s = min(1.0, max(0.0, (b * e - c * d) / det))
    t = (b * s + e) / c if c > 0 else 0.0
    if t < 0:
        t = 0.0
        s = min(1.0, max(0.0, -d / a)) if a > 0 else 0.0
    elif t > 1:
        t = 1.0
        s = min(1.0, max(0.0, (b - d) / a)) if a > 0 else 0.0
    x, y, z = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return x * x + y * y + z * z
