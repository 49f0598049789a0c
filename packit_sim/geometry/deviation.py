"""The Hausdorff distance of two surfaces: a guaranteed bound, not an estimate.

The distance from a convex set is a convex function, so no point of a piece of one surface is
farther from a triangle of the other than the piece's farthest corner. Pieces are cut until the
nearest triangle of each gives a tight bound. This is branch and bound, as by Tang, Lee and Kim
("Interactive Hausdorff distance computation for general polygonal models", 2009).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.core.errors import MeshError
from packit_sim.geometry.deviation_kernels import bound, farthest
from packit_sim.geometry.triangle_trees import boxes_of, tree_order

RELATIVE_SLACK = 0.02
"""Relative slack of the bound: it exceeds the distance by at most this share."""

DIAGONAL_SLACK = 1e-5
"""Further slack, relative to the larger bounding box's diagonal: a tenth of the contact tolerance
for an item as long as the box."""


def deviation(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """Compute an upper bound of the Hausdorff distance of two surfaces.

    Parameters
    ----------
    a : trimesh.Trimesh
        Any triangles: open or intersecting surfaces, and triangles without area.
    b : trimesh.Trimesh
        Likewise.

    Returns
    -------
    float
        No point of either surface is farther from the other, in the meshes' unit. The bound exceeds
        the distance by at most `RELATIVE_SLACK` of it and `DIAGONAL_SLACK` of the larger diagonal;
        all this up to the rounding of 64-bit arithmetic.

    Raises
    ------
    MeshError
        If a mesh has no triangles, or vertices that are not finite.
    """
    one, other = sorted((Surface.of(a), Surface.of(b)), key=lambda surface: -len(surface.triangles))
    slack = DIAGONAL_SLACK * max(one.diagonal, other.diagonal)
    low = farthest(one.triangles.reshape(-1, 3), other, 0.0)
    low = farthest(other.triangles.reshape(-1, 3), one, low)
    low, high = bound(one.triangles, other, low, low, RELATIVE_SLACK, slack)
    low, high = bound(other.triangles, one, low, high, RELATIVE_SLACK, slack)
    return float(high)


class Surface(NamedTuple):
    """Triangles in a tree of boxes.

    Attributes
    ----------
    triangles : ndarray
        (n, 3, 3) float64, in the order of the tree.
    boxes, starts : ndarray
        See `triangle_trees.boxes_of`.
    """

    triangles: npt.NDArray[np.float64]
    boxes: npt.NDArray[np.float64]
    starts: npt.NDArray[np.int64]

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> Surface:
        """Build the tree of a mesh.

        Parameters
        ----------
        mesh : trimesh.Trimesh
            The surface.

        Returns
        -------
        Surface
            Its triangles in a tree.

        Raises
        ------
        MeshError
            If the mesh has no triangles, or vertices that are not finite.
        """
        triangles = np.array(mesh.triangles, dtype=np.float64)
        if len(triangles) == 0:
            raise MeshError("a mesh without triangles has no distance to another one")
        if not np.isfinite(triangles).all():
            raise MeshError("a mesh whose vertices are not finite has no distance to another one")
        triangles = triangles[tree_order(triangles)]
        return cls(triangles, *boxes_of(triangles))

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box."""
        return float(np.linalg.norm(self.boxes[1, 1] - self.boxes[1, 0]))
