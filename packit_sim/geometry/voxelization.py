"""Exact voxelization: the fine cells that a surface touches, and those that it encloses.

An exact triangle-box test is followed by a flood fill from outside, 64 fine cells at a time.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import (
    CELL,
    CONTACT_TOLERANCE,
    FINE_PER_CELL,
    MAX_CELLS,
    STEP,
    Triple,
)
from packit_sim.geometry.voxelization_kernels import reached_cells, touched_cells

VOLUME_RESOLUTION = 256
"""Voxels along the longest side when the volume of an open surface is measured."""


def fine_cells(triangles: npt.NDArray[np.float64], cells: Triple) -> tuple[Words, Words]:
    """Compute the fine cells that a surface touches, and those that are reached from outside.

    Parameters
    ----------
    triangles : ndarray
        (n, 3, 3) float64, corners in box units.
    cells : Triple
        Cells along each axis of the surface's cell box, which is centred on the origin.

    Returns
    -------
    touched : Words
        Words [x, y, z] over the cell box: fine cells that meet a triangle when they are grown by
        half the contact tolerance.
    reached : Words
        Fine cells that are connected with the outside by a path over faces of untouched fine cells.

    Raises
    ------
    ArgumentError
        If the cell box has more than `MAX_CELLS` cells along an axis.

    Notes
    -----
    Fine cells that are not reached are outer; those that are not touched either are
    inner.
    """
    if max(cells) > MAX_CELLS:
        raise ArgumentError(
            f"a mesh of {' x '.join(map(str, cells))} cells is too large to voxelise: "
            f"at most {MAX_CELLS} along each axis"
        )
    touched = touched_cells(triangles, np.array(cells), CELL, CONTACT_TOLERANCE / 2)
    return touched, reached_cells(touched)


def lattice_cells(
    triangles: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.int64], Words, Words]:
    """Compute `fine_cells` on the box's lattice, for a surface anywhere.

    Parameters
    ----------
    triangles : ndarray
        (n, 3, 3) float64, corners in box units.

    Returns
    -------
    start : ndarray
        (3,) int64, the first cell, which is at a grid node.
    touched, reached : Words
        Words [x, y, z] over all cells that the grown surface meets, from `start` on.
    """
    grow = CONTACT_TOLERANCE / 2
    low, high = triangles.min(axis=(0, 1)) - grow, triangles.max(axis=(0, 1)) + grow
    start = np.floor(low / (STEP * CELL)).astype(np.int64) * STEP
    stop = np.ceil(high / CELL).astype(np.int64)
    x, y, z = (stop - start).tolist()
    return start, *fine_cells(triangles - (start + stop) * (CELL / 2), (x, y, z))


def solid_volume_bounds(triangles: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Bound the volume of a closed surface by its voxels of 1/256 of the longest side.

    Parameters
    ----------
    triangles : ndarray
        (n, 3, 3) float64, corners.

    Returns
    -------
    lower : float
        Volume of the enclosed voxels.
    upper : float
        Volume of the enclosed and the touched voxels.
    """
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    voxel = float((high - low).max()) / VOLUME_RESOLUTION
    cell = voxel * FINE_PER_CELL
    margin = 2  # a face on the border of voxels touches those on both sides of it
    cells = np.ceil((high - low) / cell).astype(np.int64) + margin
    touched = touched_cells(triangles - (low + high) / 2, cells, cell, voxel * 1e-9)
    enclosed = ~(touched | reached_cells(touched))
    inside = int(np.bitwise_count(enclosed).sum())
    return inside * voxel**3, (inside + int(np.bitwise_count(touched).sum())) * voxel**3
