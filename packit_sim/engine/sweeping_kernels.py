"""Kernels of the swept test, on the trees of two surfaces (see `triangle_trees`).

Two triangles, seen along the motion, overlap in a convex polygon on which the distance between them
is linear. So it is least at a corner of the polygon: a corner of one triangle that the other
covers, or a crossing of two edges. The least over all pairs is the exact length of a straight move
(our own; a continuous collision test for translations, without time steps). Branch and bound on two
trees leaves out boxes that do not overlap from above, and those higher than the least rise so far;
near boxes come first. Pairs of triangles are left out in the same way.

Exactness: up to rounding, with `_ROUNDING` against edges that are parallel seen from above, whose
crossing has no meaning; then their ends decide. Upright triangles are left to their edges.

A *rise* is the height of a point of the other surface above the item's point below it.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel
from packit_sim.geometry.deviation_kernels import divided

_STACK = 256
"""Pairs of nodes that can wait: at most one more for each level of both trees."""

_ROUNDING = 1e-10
"""Box units, or the sine of an angle: below it, points and edges seen from above are on one line.
Rounding alone makes collinear edges differ by as much, and a crossing computed for them would be
arbitrary."""

_ANY = 1e9
"""Box units, more than any distance: the search ends at the first rise."""


@kernel
def rises(item, other, offsets):
    """Return any rise of the other surface, moved by each of offsets (n, 3); inf if none: (n,)."""
    found = np.empty(len(offsets))
    for n in range(len(offsets)):
        found[n] = least_rise(item, other, offsets[n], _ANY)
    return found


@kernel
def least_rise(item, other, offset, enough):
    """Return the smallest rise of the other surface, moved by offset.

    Parameters
    ----------
    item : Surface
        The lower surface.
    other : Surface
        The upper surface.
    offset : ndarray
        (3,) float64, translation of the upper surface.
    enough : float
        Any rise of at most this may be returned.

    Returns
    -------
    float
        The rise; inf if there is none.
    """
    waiting = np.empty((_STACK, 2), np.int64)
    waiting[0] = 1
    top = 1
    least = np.inf
    leaves, other_leaves = len(item.starts) - 1, len(other.starts) - 1
    while top:
        top -= 1
        a, b = waiting[top]
        if (
            item.boxes[a, 1, 0] < other.boxes[b, 0, 0] + offset[0]
            or item.boxes[a, 0, 0] > other.boxes[b, 1, 0] + offset[0]
            or item.boxes[a, 1, 1] < other.boxes[b, 0, 1] + offset[1]
            or item.boxes[a, 0, 1] > other.boxes[b, 1, 1] + offset[1]
            or item.boxes[a, 0, 2] > other.boxes[b, 1, 2] + offset[2]
            or other.boxes[b, 0, 2] + offset[2] - item.boxes[a, 1, 2] >= least
        ):
            continue
        if a >= leaves and b >= other_leaves:
            mine = item.triangles[item.starts[a - leaves] : item.starts[a - leaves + 1]]
            start, stop = other.starts[b - other_leaves], other.starts[b - other_leaves + 1]
            least = least_rise_of_pairs(mine, other.triangles[start:stop], offset, least, enough)
            if least <= enough:
                return least
        else:
            # The smaller number is nearer to its root, so that its box is usually the larger one.
            top = divided(waiting, top, a, b, b >= other_leaves or (a < leaves and a <= b))
            near, far = waiting[top - 1], waiting[top - 2]
            if (
                other.boxes[far[1], 0, 2] - item.boxes[far[0], 1, 2]
                < other.boxes[near[1], 0, 2] - item.boxes[near[0], 1, 2]
            ):
                for side in range(2):
                    near[side], far[side] = far[side], near[side]
    return least


@kernel
def least_rise_of_pairs(triangles, others, offset, least, enough):
    """Return the smallest rise over all pairs of triangles, at most `least` (see `least_rise`)."""
    moved = np.empty((3, 3))
    for m in range(len(others)):
        for c in range(3):
            for d in range(3):
                moved[c, d] = others[m, c, d] + offset[d]
        for n in range(len(triangles)):
            if not _may_rise(triangles[n], moved, least):
                continue
            for c in range(3):
                least = min(least, _rise_at_point(moved, triangles[n, c], 1.0))
                least = min(least, _rise_at_point(triangles[n], moved[c], -1.0))
                for e in range(3):
                    rise = _rise_at_crossing(
                        triangles[n, c], triangles[n, c - 2], moved[e], moved[e - 2]
                    )
                    least = min(least, rise)
            if least <= enough:
                return least
    return least


@inner_kernel
def _may_rise(triangle, other, least):
    """Decide by their boxes whether a triangle may be below another, by less than some rise."""
    for axis in range(2):
        if (
            max(triangle[0, axis], triangle[1, axis], triangle[2, axis])
            < min(other[0, axis], other[1, axis], other[2, axis])
        ) or (
            min(triangle[0, axis], triangle[1, axis], triangle[2, axis])
            > max(other[0, axis], other[1, axis], other[2, axis])
        ):
            return False
    highest = max(triangle[0, 2], triangle[1, 2], triangle[2, 2])
    lowest = min(triangle[0, 2], triangle[1, 2], triangle[2, 2])
    return (
        lowest <= max(other[0, 2], other[1, 2], other[2, 2])
        and min(other[0, 2], other[1, 2], other[2, 2]) - highest < least
    )


@inner_kernel
def _rise_at_point(triangle, point, sign):
    """Return the height of a triangle above a point that it covers; below the point for sign -1."""
    ux, uy = triangle[1, 0] - triangle[0, 0], triangle[1, 1] - triangle[0, 1]
    vx, vy = triangle[2, 0] - triangle[0, 0], triangle[2, 1] - triangle[0, 1]
    px, py = point[0] - triangle[0, 0], point[1] - triangle[0, 1]
    area = ux * vy - uy * vx
    if area * area <= _ROUNDING**2 * (ux * ux + uy * uy) * (vx * vx + vy * vy):
        return np.inf  # upright: its edges decide
    s, t = (px * vy - py * vx) / area, (ux * py - uy * px) / area
    if s < 0 or t < 0 or s + t > 1:
        return np.inf
    z = triangle[0, 2] + s * (triangle[1, 2] - triangle[0, 2])
    z += t * (triangle[2, 2] - triangle[0, 2])
    return _positive(sign * (z - point[2]))


@inner_kernel
def _rise_at_crossing(a, b, c, d):
    """Return the height of the edge from c to d above that from a to b, where they cross."""
    ux, uy = b[0] - a[0], b[1] - a[1]
    vx, vy = d[0] - c[0], d[1] - c[1]
    px, py = c[0] - a[0], c[1] - a[1]
    area = ux * vy - uy * vx
    if area * area <= _ROUNDING**2 * (ux * ux + uy * uy) * (vx * vx + vy * vy):  # parallel
        return min(
            min(_rise_at_end(a, b, c, 1.0), _rise_at_end(a, b, d, 1.0)),
            min(_rise_at_end(c, d, a, -1.0), _rise_at_end(c, d, b, -1.0)),
        )
    s, t = (px * vy - py * vx) / area, (px * uy - py * ux) / area
    if s < 0 or s > 1 or t < 0 or t > 1:
        return np.inf
    return _positive(c[2] + t * (d[2] - c[2]) - a[2] - s * (b[2] - a[2]))


@inner_kernel
def _rise_at_end(a, b, point, sign):
    """Return the height of a point above the edge from a to b, if it is on it seen from above.

    For sign -1, return the height of the edge above the point.
    """
    ux, uy = b[0] - a[0], b[1] - a[1]
    px, py = point[0] - a[0], point[1] - a[1]
    across = ux * py - uy * px
    length = ux * ux + uy * uy
    if length <= _ROUNDING**2:  # upright
        if px * px + py * py > _ROUNDING**2:
            return np.inf
        low, high = min(a[2], b[2]), max(a[2], b[2])
        if sign > 0:
            return max(point[2] - high, 0.0) if point[2] > low else np.inf
        return max(low - point[2], 0.0) if point[2] < high else np.inf
    if across * across > _ROUNDING**2 * length:
        return np.inf
    t = (px * ux + py * uy) / length
    if t < 0 or t > 1:
        return np.inf
    return _positive(sign * (point[2] - a[2] - t * (b[2] - a[2])))


@inner_kernel
def _positive(rise):
    """Return a rise if it is positive: what is level or below does not stop the item."""
    return rise if rise > 0 else np.inf
