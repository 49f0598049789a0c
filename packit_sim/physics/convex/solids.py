"""Voxels of a shape, which measure how far a convex piece protrudes from it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import FINE, cell_box
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.voxelization import fine_cells
from packit_sim.geometry.voxels import unpack
from packit_sim.physics.convex.pieces import Piece
from packit_sim.physics.convex.polytope_kernels import farthest_inside

RESOLUTION = 128
"""Voxels along the longest side of a shape."""


class Solid:
    """A shape as voxels in its canonical frame: those that its surface touches or encloses.

    Distances are between centres of voxels, less one voxel, so that distances below about the side
    of a voxel are 0.

    Attributes
    ----------
    voxel : float
        Side of a voxel: 1/128 of the shape's longest side.
    """

    def __init__(self, shape: Shape) -> None:
        self.voxel = float(shape.extents.max()) / RESOLUTION
        enlarged = FINE / self.voxel
        x, y, z = cell_box(shape.extents * enlarged)
        cells = x + 2, y + 2, z + 2  # a margin
        touched, reached = fine_cells(shape.mesh.triangles * enlarged, cells)
        outside = unpack(reached)
        self._enclosed = unpack(~(touched | reached))
        away = ndimage.distance_transform_edt(outside) - 1
        self._distance = np.maximum(away, 0) * self.voxel
        self._middle = np.array(outside.shape) / 2

    def hausdorff(self, piece: Piece) -> float:
        """Return the one-sided Hausdorff distance of a piece from the shape, in canonical units."""
        places = piece.vertices / self.voxel + self._middle
        low = np.maximum(np.floor(places.min(axis=0)), 0).astype(np.int64)
        high = np.minimum(np.ceil(places.max(axis=0)), self._distance.shape).astype(np.int64)
        planes = piece.planes.copy()
        planes[:, 3] = planes[:, 3] / self.voxel - planes[:, :3] @ (self._middle - 0.5)
        return float(farthest_inside(self._distance, low, high, planes))

    def encloses(self, points: Floats) -> npt.NDArray[np.bool_]:
        """Return bool (n,): whether points (n, 3) in the bounding box are in enclosed voxels."""
        x, y, z = np.floor(points / self.voxel + self._middle).astype(int).T
        return self._enclosed[x, y, z]
