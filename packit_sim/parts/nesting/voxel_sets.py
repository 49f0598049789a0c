"""Voxel sets of solids: touched and enclosed voxels, signed distances and spread points."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.lattice import FINE_PER_CELL
from packit_sim.geometry.voxelization_kernels import reached_cells, touched_cells
from packit_sim.parts.nesting.distance_kernels import farthest_points

BIAS = 0.45
"""Cells by which the distance to touched cells is on average less than that to the surface."""


def voxelized(triangles: Floats, voxel: float, grow: float = 0.0) -> Any:
    """Return the voxels of a solid, which may be grown.

    Parameters
    ----------
    triangles : ndarray of float64, shape (n, 3, 3)
        The corners of its surface.
    voxel : float
        The side of the voxels, which lie symmetrically around the origin.
    grow : float
        Length by which the surface is grown along each axis.

    Returns
    -------
    ndarray of uint8, shape (x, y, z)
        1 for the voxels that the surface touches or encloses.
    """
    touched, inner = _cells(triangles, voxel, grow)
    return np.ascontiguousarray(touched | inner).view(np.uint8)


def placed_voxels(triangles: Floats, voxel: float, grow: float) -> tuple[Ints, Any]:
    """Return the voxels of a solid in the grid whose voxel (0, 0, 0) begins at the origin.

    Parameters
    ----------
    triangles : ndarray of float64, shape (n, 3, 3)
        The corners of its surface.
    voxel : float
        The side of the voxels.
    grow : float
        Length by which the surface is grown along each axis.

    Returns
    -------
    ndarray of int64, shape (3,)
        The numbers of the lowest voxels.
    ndarray of uint8, shape (x, y, z)
        1 for the voxels from there on that the surface touches or encloses.
    """
    corners = triangles.reshape(-1, 3)
    low = np.floor((corners.min(axis=0) - grow) / voxel).astype(np.int64) - 1
    high = np.ceil((corners.max(axis=0) + grow) / voxel).astype(np.int64) + 1
    words = (high - low + FINE_PER_CELL - 1) // FINE_PER_CELL
    centre = (low + words * FINE_PER_CELL / 2) * voxel
    touched = touched_cells(triangles - centre, words, voxel * FINE_PER_CELL, grow + 1e-6 * voxel)
    inner = ~reached_cells(touched) & ~touched
    return low, np.ascontiguousarray(_unpacked(touched | inner)).view(np.uint8)


def turned_voxels(triangles: Floats, turns: Floats, voxel: float) -> list[Any]:
    """Return the voxels of a solid in several rotations.

    Parameters
    ----------
    triangles : ndarray of float64, shape (n, 3, 3)
        The corners of its surface.
    turns : ndarray of float64, shape (r, 3, 3)
        The rotations, the identity first.
    voxel : float
        The side of the voxels.

    Returns
    -------
    list of ndarray of uint8, shape (x, y, z)
        See `voxelized`.
    """
    first = voxelized(triangles, voxel)
    found = []
    for turn in turns:
        axes = np.abs(turn).argmax(axis=1)
        signs = turn[np.arange(3), axes]
        if (np.abs(signs) == 1).all():
            moved = np.flip(first.transpose(axes), tuple(np.flatnonzero(signs < 0)))
            found.append(np.ascontiguousarray(moved))
        else:
            found.append(voxelized(triangles @ turn.T, voxel))
    return found


def signed_distances(triangles: Floats, cell: float, margin: float) -> Floats:
    """Return the distances of a grid's nodes to a solid's surface, negative inside.

    Parameters
    ----------
    triangles : ndarray of float64, shape (n, 3, 3)
        The corners of its surface.
    cell : float
        The distance of neighbouring nodes, which lie symmetrically around the origin.
    margin : float
        Width of the grid beyond the solid's bounding box.

    Returns
    -------
    ndarray of float64, shape (x, y, z)
        The distances, with the error of about half a cell that voxels have.
    """
    around = int(np.ceil(margin / cell)) + 1
    touched, inner = _cells(triangles, cell)
    solid = np.pad(touched | inner, 1)
    inside = np.pad(distance_transform_edt(solid), around - 1)
    outside = distance_transform_edt(~np.pad(solid, around - 1))
    found = np.where(inside > 0, BIAS + 0.5 - inside, outside + BIAS - 0.5)
    return np.asarray(found * cell)


def spread_points(vertices: Floats, faces: Ints, count: int) -> Floats:
    """Return points of a surface by farthest-point sampling, from vertices and random points.

    Parameters
    ----------
    vertices : ndarray of float64, shape (n, 3)
        Its vertices.
    faces : ndarray of int64, shape (m, 3)
        Its triangles, as indices of vertices.
    count : int
        The number of points.

    Returns
    -------
    ndarray of float64, shape (count, 3)
        The points.
    """
    triangles = vertices[faces]
    areas = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    rng = np.random.default_rng(0)
    some = rng.choice(len(triangles), 4 * count, p=areas / areas.sum())
    shares = rng.random((4 * count, 2))
    shares = np.where(shares.sum(axis=1, keepdims=True) > 1, 1 - shares, shares)
    own = triangles[some]
    points = own[:, 0] + np.einsum("nk,nkd->nd", shares, own[:, 1:] - own[:, :1])
    points = np.concatenate((rng.permutation(vertices)[: 4 * count], points))
    return np.asarray(points[farthest_points(points, min(count, len(points)))])


def enclosed(triangles: Floats, voxel: float) -> tuple[Any, Floats]:
    """Return the voxels that a surface encloses and does not touch.

    Parameters
    ----------
    triangles : ndarray of float64, shape (n, 3, 3)
        The corners of its triangles.
    voxel : float
        The side of the voxels.

    Returns
    -------
    ndarray of uint64, shape (x, y, z)
        Words of 4 x 4 x 4 voxels (see `word_kernels`).
    ndarray of float64, shape (3,)
        The lowest corner of the first word.
    """
    _, inner, low, _ = _words(triangles, voxel)
    return inner, low


def _cells(triangles: Floats, voxel: float, grow: float = 0.0) -> tuple[Any, Any]:
    """Return the touched and the enclosed voxels (x, y, z) as booleans.

    Both are symmetric to the origin.
    """
    touched, inner, low, count = _words(triangles, voxel, grow)
    first = np.round((-count * voxel / 2 - low) / voxel).astype(np.int64)
    a, b, c = (slice(n, n + m) for n, m in zip(first, count, strict=True))
    return _unpacked(touched)[a, b, c], _unpacked(inner)[a, b, c]


def _words(triangles: Floats, voxel: float, grow: float = 0.0) -> tuple[Any, Any, Floats, Ints]:
    """Return touched and enclosed voxels in words, their lowest corner, and how many are needed."""
    reach = np.abs(triangles).max(axis=(0, 1)) + grow
    count = np.maximum(1, np.ceil(2 * reach / voxel - 1e-6)).astype(np.int64)
    words = (count + 2 + FINE_PER_CELL - 1) // FINE_PER_CELL
    total = words * FINE_PER_CELL
    shift = np.where((total - count) % 2, voxel / 2, 0.0)
    touched = touched_cells(triangles + shift, words, voxel * FINE_PER_CELL, grow + 1e-6 * voxel)
    inner = ~reached_cells(touched) & ~touched
    return touched, inner, -total * voxel / 2 - shift, count


def _unpacked(words: Any) -> Any:
    """Return the bits of words of 4 x 4 x 4 cells as booleans (x, y, z)."""
    octets = np.ascontiguousarray(words).astype("<u8").view(np.uint8)
    x, y, z = words.shape
    bits = np.unpackbits(octets, bitorder="little").view(bool)
    cells = bits.reshape(x, y, z, 4, 4, 4).transpose(0, 3, 1, 4, 2, 5)
    return cells.reshape(4 * x, 4 * y, 4 * z)
