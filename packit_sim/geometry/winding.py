"""Generalised winding numbers: whether points are inside surfaces that need not be closed."""

from __future__ import annotations

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.winding_kernels import solid_angles


def winding_numbers(triangles: Floats, points: Floats) -> Floats:
    """Compute how often a surface winds around each of some points.

    Parameters
    ----------
    triangles : ndarray of float64, shape (m, 3, 3)
        The corners of the surface's triangles.
    points : ndarray of float64, shape (n, 3)
        The points.

    Returns
    -------
    ndarray of float64, shape (n,)
        For a closed surface 1 or -1 inside and 0 outside; for an open one the share of all
        directions in which it is seen.

    Notes
    -----
    Jacobson, Kavan and Sorkine-Hornung ("Robust inside-outside segmentation using generalized
    winding numbers", 2013), by the solid angles of van Oosterom and Strackee (1983).
    """
    corners = np.ascontiguousarray(triangles, dtype=np.float64)
    found = solid_angles(corners, np.ascontiguousarray(points, dtype=np.float64))
    return np.asarray(found / (2 * np.pi))
