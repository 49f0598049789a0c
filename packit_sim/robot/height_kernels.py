"""Kernels that look at a surface from above: its highest points, and how flat it is in a disc.

Samples decide whether a disc is flat; its highest point is exact.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel


@kernel
def top_heights(triangles, low, spacing, shape):
    """Return the height of the highest triangle at each point of a grid; -inf where there is none.

    Parameters
    ----------
    triangles : ndarray
        (n, 3, 3) float64.
    low : ndarray
        (2,) float64, x and y of the first point.
    spacing : float
        Distance of points.
    shape : tuple
        Points along x and y.
    """
    found = np.full(shape, -np.inf)
    for n in range(len(triangles)):
        a, b, c = triangles[n, 0], triangles[n, 1], triangles[n, 2]
        ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
        area = ux * vy - uy * vx
        if abs(area) < 1e-14:
            continue
        first = np.empty(2, np.int64)
        last = np.empty(2, np.int64)
        for d in range(2):
            least = min(a[d], min(b[d], c[d]))
            most = max(a[d], max(b[d], c[d]))
            first[d] = max(0, int(np.ceil((least - low[d]) / spacing - 1e-9)))
            last[d] = min(shape[d] - 1, int(np.floor((most - low[d]) / spacing + 1e-9)))
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                px, py = low[0] + i * spacing - a[0], low[1] + j * spacing - a[1]
                s, t = (px * vy - py * vx) / area, (ux * py - uy * px) / area
                if s >= -1e-9 and t >= -1e-9 and s + t <= 1 + 1e-9:
                    height = a[2] + s * (b[2] - a[2]) + t * (c[2] - a[2])
                    found[i, j] = max(found[i, j], height)
    return found


@kernel
def flat_discs(heights, order, radius, spacing, compliance, slope, most):
    """Return the first points of an order around which a disc of the surface is flat.

    Parameters
    ----------
    heights : ndarray
        See `top_heights`.
    order : ndarray
        (n, 2) int64, the points in the order in which they are tried.
    radius, spacing : float
        Radius of the disc, and distance of points.
    compliance : float
        Largest difference of heights from the plane through the disc.
    slope : float
        Largest slope of that plane.
    most : int
        Number of points to return at most.

    Returns
    -------
    ndarray
        (m,) int64, indices into order.
    """
    reach = int(np.floor(radius / spacing + 1e-9))
    found = np.empty(most, np.int64)
    count = 0
    for n in range(len(order)):
        if count == most:
            break
        x, y = order[n]
        if x < reach or y < reach or x + reach >= heights.shape[0] or y + reach >= heights.shape[1]:
            continue
        total = along_x = along_y = square = 0.0
        points = 0
        is_whole = True
        for i in range(-reach, reach + 1):
            for j in range(-reach, reach + 1):
                if (i * i + j * j) * spacing * spacing > radius * radius:
                    continue
                height = heights[x + i, y + j]
                if height == -np.inf:
                    is_whole = False
                    break
                total += height
                along_x += i * height
                along_y += j * height
                square += i * i
                points += 1
            if not is_whole:
                break
        if not is_whole or points < 5:
            continue
        mean, dx, dy = total / points, along_x / square, along_y / square
        if dx * dx + dy * dy > (slope * spacing) ** 2:
            continue
        least, largest = np.inf, -np.inf
        for i in range(-reach, reach + 1):
            for j in range(-reach, reach + 1):
                if (i * i + j * j) * spacing * spacing <= radius * radius:
                    rest = heights[x + i, y + j] - mean - i * dx - j * dy
                    least, largest = min(least, rest), max(largest, rest)
        if largest - least <= compliance:
            found[count] = n
            count += 1
    return found[:count]


@kernel
def highest_in_disc(triangles, x, y, radius):
    """Return the exact height of the highest point of triangles in a disc; -inf if there is none.

    It is a corner in the disc, a point where an edge crosses the circle, or the point of the circle
    in the direction in which a triangle rises; the middle if it is level.

    Parameters
    ----------
    triangles : ndarray
        (n, 3, 3) float64.
    x, y : float
        The middle of the disc.
    radius : float
        Its radius.
    """
    found, square = -np.inf, radius * radius
    for n in range(len(triangles)):
        top = max(triangles[n, 0, 2], max(triangles[n, 1, 2], triangles[n, 2, 2]))
        if top <= found:
            continue
        a, b, c = triangles[n, 0], triangles[n, 1], triangles[n, 2]
        low = min(a[0], min(b[0], c[0])) - x, min(a[1], min(b[1], c[1])) - y
        high = max(a[0], max(b[0], c[0])) - x, max(a[1], max(b[1], c[1])) - y
        if low[0] > radius or low[1] > radius or high[0] < -radius or high[1] < -radius:
            continue
        for i in range(3):
            start, end = triangles[n, i], triangles[n, (i + 1) % 3]
            px, py = start[0] - x, start[1] - y
            if px * px + py * py <= square:
                found = max(found, start[2])
            ux, uy = end[0] - start[0], end[1] - start[1]
            length, along = ux * ux + uy * uy, ux * px + uy * py
            root = along * along - length * (px * px + py * py - square)
            if length == 0.0 or root < 0.0:
                continue
            for sign in (-1.0, 1.0):
                share = (-along + sign * np.sqrt(root)) / length
                if 0.0 <= share <= 1.0:
                    found = max(found, start[2] + share * (end[2] - start[2]))
        ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
        area = ux * vy - uy * vx
        if abs(area) < 1e-14:
            continue
        up, vp = b[2] - a[2], c[2] - a[2]
        dx, dy = (up * vy - vp * uy) / area, (vp * ux - up * vx) / area
        slope = np.sqrt(dx * dx + dy * dy)
        away = radius / slope if slope > 0.0 else 0.0
        qx, qy = x + away * dx - a[0], y + away * dy - a[1]
        s, t = (qx * vy - qy * vx) / area, (ux * qy - uy * qx) / area
        if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
            found = max(found, a[2] + dx * qx + dy * qy)
    return found
