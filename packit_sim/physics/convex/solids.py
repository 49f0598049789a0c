"""How far from a shape a place is, by voxels: what tells whether a hull fills what is hollow."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from packit_sim.geometry.lattice import FINE, cell_box
from packit_sim.geometry.shapes import Shape
from packit_sim.geometry.voxelization import fine_cells
from packit_sim.geometry.voxels import unpack
from packit_sim.physics.convex.pieces import Floats, Piece
from packit_sim.physics.convex.polytope_kernels import farthest_inside

RESOLUTION = 128
"""Voxels along the longest side of a shape."""


class Solid:
    """What a shape's surface touches or encloses, as voxels in its canonical frame.

    voxel: their side, 1/128 of the shape's longest. Distances are from centre to centre, less one
    voxel: what is out by less than about that much counts as not out at all.
    """

    def __init__(self, shape: Shape) -> None:
        self.voxel = float(shape.extents.max()) / RESOLUTION
        enlarged = FINE / self.voxel
        x, y, z = cell_box(shape.extents * enlarged)
        cells = x + 2, y + 2, z + 2  # room around it
        touched, reached = fine_cells(shape.mesh.triangles * enlarged, cells)
        outside = unpack(reached)
        self._enclosed = unpack(~(touched | reached))
        away = ndimage.distance_transform_edt(outside) - 1
        self._distance = np.maximum(away, 0) * self.voxel
        self._middle = np.array(outside.shape) / 2

    def overhang(self, piece: Piece) -> float:
        """How far from the shape the farthest place in a piece is, in canonical units."""
        places = piece.vertices / self.voxel + self._middle
        low = np.maximum(np.floor(places.min(axis=0)), 0).astype(np.int64)
        high = np.minimum(np.ceil(places.max(axis=0)), self._distance.shape).astype(np.int64)
        planes = piece.planes.copy()
        planes[:, 3] = planes[:, 3] / self.voxel - planes[:, :3] @ (self._middle - 0.5)
        return float(farthest_inside(self._distance, low, high, planes))

    def encloses(self, points: Floats) -> npt.NDArray[np.bool_]:
        """Bool (n,): which of points (n, 3) in the shape's bounding box are in enclosed voxels."""
        x, y, z = np.floor(points / self.voxel + self._middle).astype(int).T
        return self._enclosed[x, y, z]
