"""Which fine cells a surface touches and which it encloses, exactly.

An exact triangle-box test, then a flood fill from outside, 64 fine cells at a time.
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
"""Voxels along the longest side where the volume of a shape that is no closed body is measured."""


def fine_cells(triangles: npt.NDArray[np.float64], cells: Triple) -> tuple[Words, Words]:
    """The touched fine cells of a surface, and the reached ones: words [x, y, z] over its cell box.

    triangles: (n, 3, 3) corners in box units; the cell box is centred on the origin. A fine cell,
    grown by half the contact tolerance, is touched where a triangle meets it; reached are those to
    which a path over faces of untouched ones leads from outside, so that all others are outer, and
    those that are neither are inner (DESIGN: Shapes). Raises ValueError where the cell box has more
    than `MAX_CELLS` along an axis.
    """
    if max(cells) > MAX_CELLS:
        raise ArgumentError(
            f"a mesh of {' x '.join(map(str, cells))} cells is too large to voxelise: "
            f"at most {MAX_CELLS} an axis"
        )
    touched = touched_cells(triangles, np.array(cells), CELL, CONTACT_TOLERANCE / 2)
    return touched, reached_cells(touched)


def lattice_cells(
    triangles: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.int64], Words, Words]:
    """As `fine_cells`, of a surface anywhere: from which cell on, touched and reached ones.

    triangles: (n, 3, 3) corners in box units. The cells are the box's own, all that the grown
    surface meets, from a grid node (3,) on.
    """
    grow = CONTACT_TOLERANCE / 2
    low, high = triangles.min(axis=(0, 1)) - grow, triangles.max(axis=(0, 1)) + grow
    start = np.floor(low / (STEP * CELL)).astype(np.int64) * STEP
    stop = np.ceil(high / CELL).astype(np.int64)
    x, y, z = (stop - start).tolist()
    return start, *fine_cells(triangles - (start + stop) * (CELL / 2), (x, y, z))


def solid_volume(triangles: npt.NDArray[np.float64]) -> float:
    """Volume of what a surface encloses, for surfaces that are no closed body (DESIGN: Shapes).

    Voxels of 1/256 of the longest side; enclosed ones count whole and touched ones half, which is
    the middle of `solid_volume_bounds`.
    """
    low, high = solid_volume_bounds(triangles)
    return (low + high) / 2


def solid_volume_bounds(triangles: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Least and largest volume that a closed surface with these voxels can have: that of the
    enclosed ones, and with it that of the touched ones.
    """
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    voxel = float((high - low).max()) / VOLUME_RESOLUTION
    cell = voxel * FINE_PER_CELL
    room_outside = 2  # a face on the border of voxels touches those on both sides of it
    cells = np.ceil((high - low) / cell).astype(np.int64) + room_outside
    touched = touched_cells(triangles - (low + high) / 2, cells, cell, voxel * 1e-9)
    enclosed = ~(touched | reached_cells(touched))
    least = int(np.bitwise_count(enclosed).sum())
    return least * voxel**3, (least + int(np.bitwise_count(touched).sum())) * voxel**3
