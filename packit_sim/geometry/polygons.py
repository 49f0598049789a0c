"""Triangulation of polygons."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.polygon_kernels import cut_ears

_SLACK = 1e-9
"""Largest area of a triangle that may face the other way, relative to the polygon's: rounding."""


def folded(corners: Floats) -> npt.NDArray[np.bool_]:
    """Find the polygons whose fan from the first corner folds over: it is not the polygon.

    Parameters
    ----------
    corners : ndarray of float64, shape (p, n, 3)
        The corners of polygons of n corners, in order.

    Returns
    -------
    ndarray of bool, shape (p,)
        Whether a triangle of the fan faces the other way than the polygon.
    """
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.cross(edges[:, :-1], edges[:, 1:])
    normals = areas.sum(axis=1, keepdims=True)
    heights = (areas * normals).sum(axis=2)
    return np.asarray((heights < -_SLACK * (normals**2).sum(axis=2)).any(axis=1))


def cut_into_triangles(corners: Floats) -> Ints:
    """Cut a polygon into triangles whose corners are the polygon's.

    Parameters
    ----------
    corners : ndarray of float64, shape (n, 3)
        The corners of a polygon that is about flat, in order.

    Returns
    -------
    ndarray of int64, shape (n - 2, 3)
        Triangles, as indices of corners, that face as the polygon does.
    """
    shifted = corners - corners[0]
    normal = np.cross(shifted[:-1], shifted[1:]).sum(axis=0)
    axis = int(np.abs(normal).argmax())
    kept = [(axis + 1) % 3, (axis + 2) % 3]
    points = shifted[:, kept if normal[axis] > 0 else kept[::-1]]
    return np.asarray(cut_ears(np.ascontiguousarray(points)))
