"""The kernel that sums the solid angles of a surface's triangles, seen from points.

A triangle's angle is that of van Oosterom and Strackee (1983). The cost is the number of points
times that of triangles.
"""

from __future__ import annotations

import math

import numpy as np

from packit_sim.core.compilation import kernel


@kernel
def solid_angles(triangles, points):
    """Return half of the solid angle under which a surface is seen from each of some points.

    Parameters
    ----------
    triangles : ndarray
        (m, 3, 3) float64, corners.
    points : ndarray
        (n, 3) float64.

    Returns
    -------
    ndarray
        (n,) float64, with the sign of the side that is seen.
    """
    found = np.zeros(len(points))
    for n in range(len(points)):
        x, y, z = points[n]
        for m in range(len(triangles)):
            t = triangles[m]
            ax, ay, az = t[0, 0] - x, t[0, 1] - y, t[0, 2] - z
            bx, by, bz = t[1, 0] - x, t[1, 1] - y, t[1, 2] - z
            cx, cy, cz = t[2, 0] - x, t[2, 1] - y, t[2, 2] - z
            la = math.sqrt(ax * ax + ay * ay + az * az)
            lb = math.sqrt(bx * bx + by * by + bz * bz)
            lc = math.sqrt(cx * cx + cy * cy + cz * cz)
            ab = ax * bx + ay * by + az * bz
            bc = bx * cx + by * cy + bz * cz
            ca = cx * ax + cy * ay + cz * az
            volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            found[n] += math.atan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return found
