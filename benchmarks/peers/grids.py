"""Items as a voxel packer or a heightmap packer sees them, from their fine cells (1/400).

Conservative: a voxel is full where the surface touches it or encloses any of it, so that what is
free is free. Sampled: it is full where its centre is, or to be exact the fine cell beyond that, as
voxels by points and depth images are; thin walls slip through.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import FINE_PER_CELL
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import centred

Voxels = npt.NDArray[np.bool_]


def voxels(item: Item, side: int, sampled: bool) -> Voxels:
    """Bool over voxels of so many cells a side, in whose middle the item stands upright."""
    edge = FINE_PER_CELL * side
    fine = item.turned(0).voxels.outer_fine
    x, y, z = (-(-size // edge) * edge for size in fine.shape)
    full = centred(fine, (x, y, z))
    for axis in range(3):
        full = _coarser(full, axis, edge, sampled)
    return full


def profiles(item: Item, sampled: bool) -> tuple[Voxels, Voxels, Voxels]:
    """Bool over the upright item's cells, but fine cells along one axis: x, y and z in turn."""
    fine = item.turned(0).voxels.outer_fine
    made = []
    for along in range(3):
        profile = fine
        for axis in {0, 1, 2} - {along}:
            profile = _coarser(profile, axis, FINE_PER_CELL, sampled)
        made.append(profile)
    return made[0], made[1], made[2]


def profile_turned(made: tuple[Voxels, Voxels, Voxels], rotation: int) -> Voxels:
    """Bool [x, y, z] over the turned item's cells, but fine cells along z."""
    upright = made[rotations.AXES[rotation, 2]]
    return rotations.turn_array(upright, rotation)


def _coarser(cells: Voxels, axis: int, edge: int, sampled: bool) -> Voxels:
    """One for each `edge` cells along an axis: full where the middle one is, or any."""
    strided = np.moveaxis(cells, axis, 0)
    if sampled:
        coarse = strided[edge // 2 :: edge]
    else:
        coarse = np.logical_or.reduce([strided[n::edge] for n in range(edge)])
    return np.moveaxis(coarse, 0, axis)
