"""Kernels that decide whether a part of one surface is inside a closed part of another.

A ray from the point straight up meets the surface's triangles; those that face up less those that
face down are the winding number, and the point is inside where it is not 0. Whether the ray meets a
triangle is decided in the plane, seen from above: by the winding number of its three edges around
the point, without angles (Hormann and Agathos, 2001; Sunday, 2001).

Exactness: the callers ask only where surfaces do not cross, so that one vertex decides for its
whole part, and the point is not on the surface. An edge's side of the point is computed from its
lower to its higher end, so that both triangles of an edge round alike: closed parts have no leaks
and none counts twice. A tree of boxes (`triangle_trees`), enlarged by more than rounding
(`containment.SLACK`), only leaves out triangles that the ray can't meet. `any_inside` is the
oracle: the same test by a loop over all triangles.

The kernels change no argument but the named outputs.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inner_kernel, kernel

_STACK = 64
"""Nodes that can wait: depth first, at most one more for each level of the tree."""


@kernel
def holds(points, triangles, part, boxes, starts, turn, points_turn, shift):
    """Return whether one of some points is inside a closed part of a surface.

    Parameters
    ----------
    points : ndarray
        (p, 3) float64, the points.
    triangles, part, boxes, starts : ndarray
        See `containment.PartArrays`.
    turn, points_turn : ndarray
        (3, 3) float64, the rotations of the surface and of the points.
    shift : ndarray
        (3,) float64, from the origin of the surface to that of the points.

    Returns
    -------
    bool
        True if there is such a point.
    """
    to_frame, moved = _to_frame(turn, points_turn, shift)
    point = np.empty(3)
    windings = np.empty(0, np.int64)
    for n in range(len(points)):
        _move(points[n], to_frame, moved, point)
        if not _is_in(boxes[1], point):  # most points: no array is taken for them
            continue
        if len(windings) == 0:
            windings = np.empty(part.max() + 1, np.int64)
        windings[:] = 0
        _count_windings(triangles, part, boxes, starts, point, windings)
        # Each closed part counts alone: a hollow ball's inner shell must not cancel its outer one.
        if windings.any():
            return True
    return False


@kernel
def points_within(points, outline, other, shift):
    """Select the points of parts whose boxes are within the box of another surface's closed parts.

    Parameters
    ----------
    points : ndarray
        (p, 3) float64, a vertex of each part.
    outline, other : ndarray
        (1 + p, 2, 3) float64, of this surface and the other (see `containment.PartArrays.outline`).
    shift : ndarray
        (3,) float64, from the origin of the other surface to that of this one.

    Returns
    -------
    ndarray
        (k, 3) float64. No other part is inside a closed part of the other surface.
    """
    # Counted first, since usually there is none.
    count = 0
    for n in range(len(points)):
        count += _is_within(outline[n + 1], other[0], shift)
    found = np.empty((count, 3))
    if count:
        count = 0
        for n in range(len(points)):
            if _is_within(outline[n + 1], other[0], shift):
                for d in range(3):
                    found[count, d] = points[n, d]
                count += 1
    return found


@inner_kernel
def _is_within(box, other, shift):
    """Return whether a box that is moved is within another."""
    for d in range(3):
        if not (other[0, d] <= box[0, d] + shift[d] and box[1, d] + shift[d] <= other[1, d]):
            return False
    return True


@allocating_kernel
def _to_frame(turn, points_turn, shift):
    """Return the rotation (3, 3) and translation (3,) from the points' frame to the surface's."""
    to_frame = np.empty((3, 3))
    moved = np.zeros(3)
    for d in range(3):
        for e in range(3):
            moved[d] += turn[e, d] * shift[e]
            to_frame[d, e] = (
                turn[0, d] * points_turn[0, e]
                + turn[1, d] * points_turn[1, e]
                + turn[2, d] * points_turn[2, e]
            )
    return to_frame, moved


@inner_kernel
def _move(point, to_frame, moved, out):
    """Write the point in another frame to `out`."""
    for d in range(3):
        out[d] = moved[d] + (
            to_frame[d, 0] * point[0] + to_frame[d, 1] * point[1] + to_frame[d, 2] * point[2]
        )


@allocating_kernel
def _count_windings(triangles, part, boxes, starts, point, windings):
    """Add to `windings` (q,) how often each closed part winds around the point."""
    waiting = np.empty(_STACK, np.int64)
    waiting[0] = 1
    top = 1
    leaves = len(starts) - 1
    while top:
        top -= 1
        node = waiting[top]
        if not _meets_ray(boxes[node], point):
            continue
        if node < leaves:
            waiting[top], waiting[top + 1] = 2 * node, 2 * node + 1
            top += 2
        else:
            for n in range(starts[node - leaves], starts[node - leaves + 1]):
                windings[part[n]] += _crossing(triangles[n], point)


@inner_kernel
def _is_in(box, point):
    """Return whether a point is in a box."""
    return box[0, 2] <= point[2] and _meets_ray(box, point)


@inner_kernel
def _meets_ray(box, point):
    """Return whether the ray from a point straight up meets a box."""
    return (
        box[0, 0] <= point[0] <= box[1, 0]
        and box[0, 1] <= point[1] <= box[1, 1]
        and point[2] <= box[1, 2]
    )


@kernel
def any_inside(points, triangles):
    """Return whether one of the points (p, 3) is inside a closed surface, by a loop over all."""
    inside = False
    for n in range(len(points)):
        inside |= winding_number(triangles, points[n]) != 0
    return inside


@kernel
def winding_number(triangles, point):
    """Count how often a closed surface winds around a point that is not on it.

    Parameters
    ----------
    triangles : ndarray
        (m, 3, 3) float64, the corners of the surface's triangles.
    point : ndarray
        (3,) float64, the point.

    Returns
    -------
    int
        0 outside, 1 inside a surface that faces outwards, -1 inside one that faces inwards.

    Notes
    -----
    It is the number of triangles above the point that face up, less those that face down. A
    triangle covers the point if its outline, seen from above, winds around it. Whether an edge
    passes the point on its right depends only on the edge's ends, so that triangles with a common
    edge agree: no point is between two of them or on both.
    """
    winding = 0
    for n in range(len(triangles)):
        winding += _crossing(triangles[n], point)
    return winding


@inner_kernel
def _crossing(triangle, point):
    """Return 1 if a triangle above a point faces up, -1 if it faces down, 0 if none is above."""
    x, y, z = point
    covers = 0
    for c in range(3):
        start, end = triangle[c - 1], triangle[c]
        # Half open: an end at exactly y counts as below, so that a corner is passed only once.
        if (start[1] <= y) == (end[1] <= y):
            continue
        rises = start[1] <= y
        low, high = (start, end) if rises else (end, start)
        if (high[0] - low[0]) * (y - low[1]) > (x - low[0]) * (high[1] - low[1]):
            covers += 1 if rises else -1
    if covers != 0 and _is_above(triangle, x, y, z, covers):
        return covers
    return 0


@inner_kernel
def _is_above(triangle, x, y, z, faces):
    """Return whether a triangle that covers a point and faces up (1) or down (-1) is above it."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    # Corners all above or all below decide without rounding; few points are between.
    if a[2] <= z and b[2] <= z and c[2] <= z:
        return False
    if a[2] > z and b[2] > z and c[2] > z:
        return True
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    height = (
        (uy * vz - uz * vy) * (x - a[0])
        + (uz * vx - ux * vz) * (y - a[1])
        + (ux * vy - uy * vx) * (z - a[2])
    )
    return faces * height < 0
