"""Voxels around the origin that a surface touches or encloses."""

from __future__ import annotations

from typing import Any

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import FINE_PER_CELL
from packit_sim.geometry.voxelization_kernels import reached_cells, touched_cells


def voxelized(triangles: Floats, voxel: float) -> Any:
    """Return the voxels of a solid.

    Parameters
    ----------
    triangles : ndarray of float64, shape (n, 3, 3)
        The corners of its surface.
    voxel : float
        The side of the voxels, which are symmetric to the origin.

    Returns
    -------
    ndarray of uint8, shape (x, y, z)
        1 for the voxels that the surface touches or encloses.
    """
    touched, inner = _cells(triangles, voxel)
    return np.ascontiguousarray(touched | inner).view(np.uint8)


def enclosed(triangles: Floats, voxel: float) -> Any:
    """Return the voxels that a surface encloses and does not touch; as `voxelized`."""
    return np.ascontiguousarray(_cells(triangles, voxel)[1]).view(np.uint8)


def _cells(triangles: Floats, voxel: float) -> tuple[Any, Any]:
    """Return the voxels (x, y, z) that are touched, and those that are enclosed, as booleans."""
    reach = np.abs(triangles).max(axis=(0, 1))
    count = np.maximum(1, np.ceil(2 * reach / voxel - 1e-6)).astype(np.int64)
    words = (count + 2 + FINE_PER_CELL - 1) // FINE_PER_CELL
    total = words * FINE_PER_CELL
    shift = np.where((total - count) % 2, voxel / 2, 0.0)
    touched = touched_cells(triangles + shift, words, voxel * FINE_PER_CELL, 1e-6 * voxel)
    inner = ~reached_cells(touched) & ~touched
    margin = (total - count + (shift > 0)) // 2
    a, b, c = (slice(first, first + n) for first, n in zip(margin, count, strict=True))
    return _unpacked(touched)[a, b, c], _unpacked(inner)[a, b, c]


def _unpacked(words: Any) -> Any:
    """Return the bits of words of 4 x 4 x 4 cells as booleans (x, y, z)."""
    bits = (words[..., None] >> np.arange(64, dtype=np.uint64)) & np.uint64(1)
    x, y, z = words.shape
    cells = bits.astype(bool).reshape(x, y, z, 4, 4, 4).transpose(0, 3, 1, 4, 2, 5)
    return cells.reshape(4 * x, 4 * y, 4 * z)
