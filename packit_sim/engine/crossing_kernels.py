"""Kernels that decide whether two surfaces cross, where rounding can't matter.

A *proof* that two triangles are apart is an axis along which there is a gap between them, and a
proof that they cross is an edge of one that passes through the inside of the other: both by more
than `MARGIN`, which is far more than rounding. Where there is no proof, the caller asks FCL. So the
answers are those of FCL, which remains the definition: neither proof may contradict it.

Sources: separating axes (as Gottschalk, Lin and Manocha, 1996, for boxes), of two triangles the two
normals, nine products of edges and, for coplanar ones, six normals of edges in their planes; edges
through triangles by signed volumes of tetrahedra, the orientation predicates of Guigue and
Devillers (2003), here with a margin instead of their signs alone. Two trees of boxes are descended
together, the larger box first.

Trees and offsets are never changed. Triangles are passed as an array and a number: a view of one
would cost reference counts in the innermost loop.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.geometry.deviation_kernels import divided

APART, CROSSING, UNSURE = 0, 1, 2

MARGIN = 1e-9
"""Box units; coordinates are at most a few units, so that rounding is below 1e-14."""

_STACK = 256
"""Pairs of nodes that can wait: at most one more for each level of both trees."""


@kernel
def relation(one, other, turn, shift, region):
    """Decide whether two surfaces cross in a region.

    Parameters
    ----------
    one, other : tuple
        The triangles, boxes and starts of a tree (see `triangle_trees`).
    turn : ndarray
        (2, 3) int64, the rotation of the other surface: for each axis of the first, the axis of the
        other that becomes it, and 1 or -1 if it is reversed.
    shift : ndarray
        (3,) float64, the translation of the other surface after its rotation.
    region : ndarray
        (2, 3) float64, lowest and highest corner of a box that contains all common points.

    Returns
    -------
    int
        `APART`, `CROSSING`, or `UNSURE` if neither is proved.
    """
    _, boxes, starts = one
    _, other_boxes, other_starts = other
    leaves, other_leaves = len(starts) - 1, len(other_starts) - 1
    moved = np.empty((2, 3, 3))
    waiting = np.empty((_STACK, 2), np.int64)
    waiting[0] = 1
    top = 1
    unsure = False
    while top:
        top -= 1
        a, b = waiting[top, 0], waiting[top, 1]
        if _boxes_apart(boxes, a, other_boxes, b, turn, shift, region):
            continue
        if a >= leaves and b >= other_leaves:
            found = _leaf_relation(one, other, waiting[top], turn, shift, region, moved)
            if found == CROSSING:
                return CROSSING
            unsure = unsure or found == UNSURE  # another pair may still be a proof of a crossing
        else:
            is_first = b >= other_leaves or (
                a < leaves and _size(boxes, a) >= _size(other_boxes, b)
            )
            top = divided(waiting, top, a, b, is_first)
    return UNSURE if unsure else APART


@inner_kernel
def _leaf_relation(one, other, pair, turn, shift, region, moved):
    """Return the relation of the triangles in two leaves; `moved` (2, 3, 3) is overwritten.

    It holds a triangle of the other surface, moved, and the corners of its box in the region.
    """
    triangles, boxes, starts = one
    others, _, other_starts = other
    leaf, other_leaf = pair[0] - len(starts) + 1, pair[1] - len(other_starts) + 1
    unsure = False
    for m in range(other_starts[other_leaf], other_starts[other_leaf + 1]):
        is_outside = False
        for d in range(3):
            axis, sign = turn[0, d], turn[1, d]
            p = sign * others[m, 0, axis] + shift[d]
            q = sign * others[m, 1, axis] + shift[d]
            r = sign * others[m, 2, axis] + shift[d]
            moved[0, 0, d], moved[0, 1, d], moved[0, 2, d] = p, q, r
            low = max(min(p, q, r), region[0, d]) - MARGIN
            high = min(max(p, q, r), region[1, d]) + MARGIN
            moved[1, 0, d], moved[1, 1, d] = low, high
            is_outside = (
                is_outside
                or high < low
                or boxes[pair[0], 1, d] < low
                or high < boxes[pair[0], 0, d]
            )
        if is_outside:
            continue
        for n in range(starts[leaf], starts[leaf + 1]):
            # Boxes first: they leave out most pairs without the 17 axes of `apart`.
            if _is_outside(triangles, n, moved) or apart(triangles, n, moved, 0):
                continue
            if cross(triangles, n, moved, 0):
                return CROSSING
            unsure = True
    return UNSURE if unsure else APART


@inner_kernel
def _is_outside(a, n, moved):
    """Return whether triangle a[n] is outside the box in `moved` (see `_leaf_relation`)."""
    for d in range(3):
        p, q, r = a[n, 0, d], a[n, 1, d], a[n, 2, d]
        if max(p, q, r) < moved[1, 0, d] or min(p, q, r) > moved[1, 1, d]:
            return True
    return False


@inner_kernel
def _size(boxes, node):
    """Return the sum of the extents of a node's box."""
    low, high = 0.0, 0.0
    for d in range(3):
        low += boxes[node, 0, d]
        high += boxes[node, 1, d]
    return high - low


@inner_kernel
def _boxes_apart(boxes, a, other_boxes, b, turn, shift, region):
    """Return whether the boxes of two nodes have no common point in the region."""
    for d in range(3):
        axis = turn[0, d]
        if turn[1, d] > 0:
            low, high = other_boxes[b, 0, axis] + shift[d], other_boxes[b, 1, axis] + shift[d]
        else:
            low, high = shift[d] - other_boxes[b, 1, axis], shift[d] - other_boxes[b, 0, axis]
        low, high = max(low, region[0, d]) - MARGIN, min(high, region[1, d]) + MARGIN
        if high < low or boxes[a, 1, d] < low or high < boxes[a, 0, d]:
            return True
    return False


@kernel
def apart(a, n, b, m):
    """Return whether there is a proof that triangles a[n] and b[m] are apart, by their planes."""
    # The normals first: a triangle is often on one side of the other's plane.
    x, y, z = _normal(a, n)
    if _separates(a, n, b, m, x, y, z):
        return True
    u, v, w = _normal(b, m)
    if _separates(a, n, b, m, u, v, w):
        return True
    for i in range(3):
        ex, ey, ez = _edge(a, n, i)
        if _separates(a, n, b, m, *_cross_product(ex, ey, ez, x, y, z)):
            return True
        fx, fy, fz = _edge(b, m, i)
        if _separates(a, n, b, m, *_cross_product(fx, fy, fz, u, v, w)):
            return True
        for j in range(3):
            fx, fy, fz = _edge(b, m, j)
            if _separates(a, n, b, m, *_cross_product(ex, ey, ez, fx, fy, fz)):
                return True
    return False


@inner_kernel
def _separates(a, n, b, m, x, y, z):
    """Return whether there is a gap between triangles a[n] and b[m] along the axis (x, y, z)."""
    p = x * a[n, 0, 0] + y * a[n, 0, 1] + z * a[n, 0, 2]
    q = x * a[n, 1, 0] + y * a[n, 1, 1] + z * a[n, 1, 2]
    r = x * a[n, 2, 0] + y * a[n, 2, 1] + z * a[n, 2, 2]
    s = x * b[m, 0, 0] + y * b[m, 0, 1] + z * b[m, 0, 2]
    t = x * b[m, 1, 0] + y * b[m, 1, 1] + z * b[m, 1, 2]
    u = x * b[m, 2, 0] + y * b[m, 2, 1] + z * b[m, 2, 2]
    gap = max(min(p, q, r) - max(s, t, u), min(s, t, u) - max(p, q, r))
    # Compared squared and by length, so that the axis needs no root and a zero axis proves nothing.
    return gap > 0 and gap * gap > MARGIN * MARGIN * (x * x + y * y + z * z)


@kernel
def cross(a, n, b, m):
    """Return whether there is a proof that triangles a[n] and b[m] cross."""
    found = False
    for i in range(3):
        found = found or _pierces(a, n, i, b, m) or _pierces(b, m, i, a, n)
    return found


@inner_kernel
def _pierces(a, n, i, b, m):
    """Return whether edge i of triangle a[n] passes through the inside of triangle b[m]."""
    x, y, z = _normal(b, m)
    end = _height(a, n, i, b, m, x, y, z)
    start = _height(a, n, i - 1, b, m, x, y, z)
    margin = MARGIN * np.sqrt(x * x + y * y + z * z)
    if not (min(start, end) < -margin and max(start, end) > margin):
        return False
    ex, ey, ez = _edge(a, n, i)
    length = ex * ex + ey * ey + ez * ez
    before = 0
    for j in range(3):
        fx, fy, fz = _edge(b, m, j)
        x, y, z = _cross_product(ex, ey, ez, fx, fy, fz)
        apart = (
            x * (a[n, i, 0] - b[m, j, 0])
            + y * (a[n, i, 1] - b[m, j, 1])
            + z * (a[n, i, 2] - b[m, j, 2])
        )
        # The line of the edge passes the triangle's edge too closely to be sure of the side.
        if apart * apart <= MARGIN * MARGIN * length * (fx * fx + fy * fy + fz * fz):
            return False
        side = 1 if apart > 0 else -1
        if side == -before:
            return False
        before = side
    return True


@inner_kernel
def _height(a, n, i, b, m, x, y, z):
    """Return the height of corner i of a[n] above the first corner of b[m], along (x, y, z)."""
    return (
        x * (a[n, i, 0] - b[m, 0, 0])
        + y * (a[n, i, 1] - b[m, 0, 1])
        + z * (a[n, i, 2] - b[m, 0, 2])
    )


@inner_kernel
def _edge(a, n, i):
    """Return edge i of triangle a[n], which ends at its corner i."""
    return a[n, i, 0] - a[n, i - 1, 0], a[n, i, 1] - a[n, i - 1, 1], a[n, i, 2] - a[n, i - 1, 2]


@inner_kernel
def _normal(a, n):
    """Return the normal of triangle a[n], as long as twice its area."""
    ax, ay, az = _edge(a, n, 0)
    bx, by, bz = _edge(a, n, 1)
    return _cross_product(ax, ay, az, bx, by, bz)


@inner_kernel
def _cross_product(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
