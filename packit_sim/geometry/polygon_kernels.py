"""The kernel that cuts ears off a polygon.

Ear clipping (Meisters, 1975): a simple polygon has a convex corner whose triangle contains no other
corner; cut it off, and repeat. Time is quadratic for usual outlines and cubic at worst; faces have
few corners. An outline may touch itself, so that points equal to a corner of the ear do not count
as inside. There are always n - 2 triangles; if the outline crosses itself, they may overlap.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import inner_kernel, kernel


@kernel
def cut_ears(points):
    """Return the triangles of a polygon.

    Parameters
    ----------
    points : ndarray
        (n, 2) float64, the corners, anticlockwise.

    Returns
    -------
    ndarray
        (n - 2, 3) int64, indices of corners.
    """
    count = len(points)
    triangles = np.empty((count - 2, 3), np.int64)
    ring = np.arange(count)
    at, failed = 0, 0
    while count > 3 and failed < count:
        before, after = (at - 1) % count, (at + 1) % count
        if _is_ear(points, ring[:count], ring[before], ring[at], ring[after]):
            triangles[len(points) - count] = ring[before], ring[at], ring[after]
            ring[at : count - 1] = ring[at + 1 : count].copy()
            count -= 1
            at %= count
            failed = 0
        else:
            at = after
            failed += 1  # a whole round without an ear: the outline crosses itself
    for n in range(1, count - 1):  # one triangle; more if the outline crosses itself
        triangles[len(points) - count + n - 1] = ring[0], ring[n], ring[n + 1]
    return triangles


@inner_kernel
def _is_ear(points, ring, a, b, c):
    """Return whether the corner b is convex, and no other point of the ring is in its triangle."""
    if _area(points[a], points[b], points[c]) <= 0:  # straight corners too: no empty triangle
        return False
    for n in ring:
        p = points[n]
        if (
            _area(points[a], points[b], p) >= 0
            and _area(points[b], points[c], p) >= 0
            and _area(points[c], points[a], p) >= 0
            and not (_same(p, points[a]) or _same(p, points[b]) or _same(p, points[c]))
        ):
            return False
    return True


@inner_kernel
def _same(p, q):
    """Return whether two points are equal."""
    return p[0] == q[0] and p[1] == q[1]


@inner_kernel
def _area(p, q, r):
    """Return twice the area of a triangle, negative if it is clockwise."""
    return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
