"""Centres of mass of parts, by voxels."""

from __future__ import annotations

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import FINE_PER_CELL
from packit_sim.geometry.voxelization_kernels import reached_cells, touched_cells
from packit_sim.geometry.voxels import unpack
from packit_sim.parts.packings.item_types import ItemType

VOXELS = 100
"""Voxels along the longest side of a part."""


def centre_of_mass(own: ItemType) -> Floats:
    """Compute the centre of mass of a mesh of uniform density.

    Parameters
    ----------
    own : ItemType
        The type with the mesh.

    Returns
    -------
    ndarray of float64, shape (3,)
        In its coordinates, by voxels: enclosed ones count fully, touched ones by half.
        Each coordinate is off by at most about a voxel, 1/100 of the longest side.
    """
    middle = (own.low + own.high) / 2
    voxel = float(own.extents.max()) / VOXELS
    cell = voxel * FINE_PER_CELL
    cells = np.ceil(own.extents / cell).astype(np.int64) + 2
    triangles = (own.vertices - middle)[own.faces]
    touched = touched_cells(triangles, cells, cell, voxel * 1e-9)
    enclosed = unpack(~(touched | reached_cells(touched)))
    weights = enclosed + 0.5 * unpack(touched)
    sums = [weights.sum(axis=axes) for axes in ((1, 2), (0, 2), (0, 1))]
    places = [np.average(np.arange(len(each)), weights=each) for each in sums]
    return middle + (np.array(places) + 0.5 - np.array(weights.shape) / 2) * voxel
