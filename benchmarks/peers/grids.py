"""Voxels and height profiles of items for other packers, computed from fine cells (1/400).

Conservative: a voxel is full if the surface touches it or encloses any part of it, so that empty
voxels are free. Sampled: a voxel is full if its centre is (precisely, the fine cell beyond it), as
in voxels from points and in depth images; thin walls are missed.
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
    """Compute voxels of `side` cells; the unrotated item is centred in the array."""
    edge = FINE_PER_CELL * side
    fine = item.turned(0).voxels.outer_fine
    x, y, z = (-(-size // edge) * edge for size in fine.shape)
    full = centred(fine, (x, y, z))
    for axis in range(3):
        full = _coarser(full, axis, edge, sampled)
    return full


def profiles(item: Item, sampled: bool) -> tuple[Voxels, Voxels, Voxels]:
    """Compute the unrotated item's cells, with fine cells along x, along y and along z."""
    fine = item.turned(0).voxels.outer_fine
    found = []
    for along in range(3):
        profile = fine
        for axis in {0, 1, 2} - {along}:
            profile = _coarser(profile, axis, FINE_PER_CELL, sampled)
        found.append(profile)
    return found[0], found[1], found[2]


def profile_turned(upright: tuple[Voxels, Voxels, Voxels], rotation: int) -> Voxels:
    """Compute the rotated item's cells [x, y, z], with fine cells along z, from `profiles`."""
    return rotations.turn_array(upright[rotations.AXES[rotation, 2]], rotation)


def _coarser(cells: Voxels, axis: int, edge: int, sampled: bool) -> Voxels:
    """Merge each `edge` cells along an axis: full if the middle one is, or if any is."""
    strided = np.moveaxis(cells, axis, 0)
    if sampled:
        coarse = strided[edge // 2 :: edge]
    else:
        coarse = np.logical_or.reduce([strided[n::edge] for n in range(edge)])
    return np.moveaxis(coarse, 0, axis)
