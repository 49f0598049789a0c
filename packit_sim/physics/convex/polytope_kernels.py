"""Kernels for sets of points behind planes: clipped triangles, and voxels inside.

A convex region is the set of points behind all of its planes. Clipping a surface to it gives the
points whose hull is the region's piece (Sutherland and Hodgman's reentrant clipping, 1974); the
farthest voxel in a piece shows how far the piece protrudes from a solid (`solids.Solid`). A slack
keeps points that rounding puts in front of their own plane. Arguments are not changed.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import kernel


@kernel
def clip(triangles, planes, slack):
    """Return the corners of the parts of triangles that are behind all planes.

    Parameters
    ----------
    triangles : ndarray
        (m, 3, 3) float64.
    planes : ndarray
        (k, 4) float64, unit normals and offsets.
    slack : float
        Distance beyond a plane up to which a point counts as behind it.

    Returns
    -------
    ndarray
        (n, 3) float64.

    Notes
    -----
    Each triangle is cut by one plane after the other (Sutherland and Hodgman, 1974).
    """
    most = len(planes) + 4
    polygon, left, beyond = np.empty((most, 3)), np.empty((most, 3)), np.empty(most)
    points, count = np.empty((64, 3)), 0
    for t in range(len(triangles)):
        polygon[:3], corners = triangles[t], 3
        for p in range(len(planes)):
            farthest = -np.inf
            for c in range(corners):
                beyond[c] = planes[p, 3] - slack
                for d in range(3):
                    beyond[c] += planes[p, d] * polygon[c, d]
                farthest = max(farthest, beyond[c])
            if farthest <= 0:  # as a whole behind this plane
                continue
            kept = 0
            for c in range(corners):
                e = c + 1 if c + 1 < corners else 0
                if beyond[c] <= 0:
                    left[kept] = polygon[c]
                    kept += 1
                if (beyond[c] <= 0) != (beyond[e] <= 0):
                    share = beyond[c] / (beyond[c] - beyond[e])
                    for d in range(3):
                        left[kept, d] = polygon[c, d] + share * (polygon[e, d] - polygon[c, d])
                    kept += 1
            # Each plane adds at most one corner to a convex polygon: `most` are enough.
            polygon, left, corners = left, polygon, kept
            if corners == 0:
                break
        if count + corners > len(points):
            longer = np.empty((2 * (count + corners), 3))
            longer[:count] = points[:count]
            points = longer
        points[count : count + corners] = polygon[:corners]
        count += corners
    return points[:count]


@kernel
def farthest_inside(distance, low, high, planes):
    """Return the largest distance among the voxels behind all planes.

    Parameters
    ----------
    distance : ndarray
        float64 [x, y, z], the distance at each voxel.
    low : ndarray
        (3,) int64, the first voxel to look at along each axis.
    high : ndarray
        (3,) int64, the end of the range.
    planes : ndarray
        (k, 4) float64, normals and offsets, in voxels.

    Returns
    -------
    float
        The distance; 0 if no voxel is behind all planes.
    """
    farthest = 0.0
    for x in range(low[0], high[0]):
        for y in range(low[1], high[1]):
            for z in range(low[2], high[2]):
                if distance[x, y, z] <= farthest:  # the cheap test before the planes
                    continue
                inside = True
                for p in range(len(planes)):
                    across = planes[p, 0] * x + planes[p, 1] * y + planes[p, 2] * z
                    if across + planes[p, 3] > 0:
                        inside = False
                        break
                if inside:
                    farthest = distance[x, y, z]
    return farthest
