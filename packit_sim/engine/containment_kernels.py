"""Kernels that decide whether a part of one surface is inside a closed part of another."""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel


@kernel
def nested(one, other, turn, other_turn, shift):
    """Return whether a part of one of two surfaces is inside a closed part of the other.

    Parameters
    ----------
    one, other : PartArrays
        The surfaces, which don't cross.
    turn, other_turn : ndarray
        (3, 3) float64, their rotations.
    shift : ndarray
        (3,) float64, from the centre of the first to that of the other.

    Returns
    -------
    bool
        Whether there is such a part.
    """
    return _holds(one, other.points, turn, other_turn, shift) or _holds(
        other, one.points, other_turn, turn, -shift
    )


@kernel
def _holds(around, points, turn, points_turn, shift):
    """Return whether one of the points (p, 3), turned and moved, is inside a closed part."""
    if len(around.starts) == 1:
        return False
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
    point = np.empty(3)
    for n in range(len(points)):
        for d in range(3):
            point[d] = moved[d] + (
                to_frame[d, 0] * points[n, 0]
                + to_frame[d, 1] * points[n, 1]
                + to_frame[d, 2] * points[n, 2]
            )
        if not _in_box(around.boxes[0], point):
            continue
        for m in range(len(around.starts) - 1):
            if _in_box(around.boxes[m + 1], point):
                triangles = around.triangles[around.starts[m] : around.starts[m + 1]]
                if winding_number(triangles, point) != 0:
                    return True
    return False


@kernel
def _in_box(box, point):
    return (
        box[0, 0] <= point[0] <= box[1, 0]
        and box[0, 1] <= point[1] <= box[1, 1]
        and box[0, 2] <= point[2] <= box[1, 2]
    )


@kernel
def any_inside(points, triangles, starts):
    """Return whether one of the points (p, 3) is inside a closed part, by a loop over all."""
    for n in range(len(points)):
        for m in range(len(starts) - 1):
            if winding_number(triangles[starts[m] : starts[m + 1]], points[n]) != 0:
                return True
    return False


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
    x, y, z = point
    for n in range(len(triangles)):
        triangle = triangles[n]
        covers = 0
        for c in range(3):
            start, end = triangle[c - 1], triangle[c]
            if (start[1] <= y) == (end[1] <= y):
                continue
            rises = start[1] <= y
            low, high = (start, end) if rises else (end, start)
            if (high[0] - low[0]) * (y - low[1]) > (x - low[0]) * (high[1] - low[1]):
                covers += 1 if rises else -1
        if covers != 0 and _is_above(triangle, x, y, z, covers):
            winding += covers
    return winding


@kernel
def _is_above(triangle, x, y, z, faces):
    """Return whether a triangle that covers a point and faces up (1) or down (-1) is above it."""
    a, b, c = triangle[0], triangle[1], triangle[2]
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
