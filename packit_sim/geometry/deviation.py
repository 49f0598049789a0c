"""How far two surfaces are apart at most: a bound of their Hausdorff distance, not an estimate.

The distance from a convex set is a convex function: no point of a piece of one surface is farther
from a triangle of the other than the farthest of its corners is. Pieces are cut until the best
triangle for each says enough: branch and bound, as by Tang, Lee and Kim ("Interactive Hausdorff
distance computation for general polygonal models", 2009).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.spatial import cKDTree

from packit_sim.core.errors import MeshError
from packit_sim.geometry.deviation_kernels import bound, farthest

RELATIVE_SLACK = 0.02
"""How much more than the distance its bound may be, as a share of it."""

SLACK = 1e-5
"""How much more it may be beside that, as a share of the larger bounding box's diagonal: a tenth of
the contact tolerance for an item as long as the box."""

_PER_LEAF = 4
"""Triangles in a leaf of a tree, at most."""


def deviation(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """A bound of the Hausdorff distance of two surfaces: no point of either is farther from the
    other, in their unit of length.

    It is more than that distance by at most `RELATIVE_SLACK` of it and `SLACK` of the larger
    diagonal. Both hold but for the rounding of 64-bit arithmetic, for any triangles: open surfaces,
    crossing ones, triangles without area. Raises MeshError where a mesh has no triangles, or
    vertices that are not finite.
    """
    one, other = sorted((Surface.of(a), Surface.of(b)), key=lambda surface: -len(surface.triangles))
    slack = SLACK * max(one.diagonal, other.diagonal)
    low = farthest(one.triangles.reshape(-1, 3), other, 0.0)
    low = farthest(other.triangles.reshape(-1, 3), one, low)
    low, high = bound(one.triangles, other, low, low, RELATIVE_SLACK, slack)
    low, high = bound(other.triangles, one, low, high, RELATIVE_SLACK, slack)
    return float(high)


class Surface(NamedTuple):
    """Triangles in a complete binary tree of boxes; the children of node n are 2 n and 2 n + 1.

    triangles: (n, 3, 3), those of a leaf together. boxes: (2 leaves, 2, 3), lowest and highest
    corners, from the root at 1 to the leaves at the end. starts: (leaves + 1,), where each leaf's
    triangles start.
    """

    triangles: npt.NDArray[np.float64]
    boxes: npt.NDArray[np.float64]
    starts: npt.NDArray[np.int64]

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> Surface:
        """Raises MeshError where there are no triangles, or vertices that are not finite."""
        triangles = np.array(mesh.triangles, dtype=np.float64)
        if len(triangles) == 0:
            raise MeshError("a mesh without triangles is at no distance from anything")
        if not np.isfinite(triangles).all():
            raise MeshError("a mesh whose vertices are not finite is at no distance from anything")
        tree = cKDTree(triangles.mean(axis=1), leafsize=_PER_LEAF)  # halves it, and so on
        triangles = triangles[tree.indices]
        leaves = 1
        while leaves * _PER_LEAF < len(triangles):
            leaves *= 2
        starts = np.arange(leaves + 1) * len(triangles) // leaves
        boxes = np.empty((2 * leaves, 2, 3))
        boxes[leaves:, 0] = np.minimum.reduceat(triangles.min(axis=1), starts[:-1])
        boxes[leaves:, 1] = np.maximum.reduceat(triangles.max(axis=1), starts[:-1])
        while leaves > 1:
            children = boxes[leaves : 2 * leaves]
            leaves //= 2
            boxes[leaves : 2 * leaves, 0] = np.minimum(children[::2, 0], children[1::2, 0])
            boxes[leaves : 2 * leaves, 1] = np.maximum(children[::2, 1], children[1::2, 1])
        return cls(triangles, boxes, starts)

    @property
    def diagonal(self) -> float:
        """Of the bounding box."""
        return float(np.linalg.norm(self.boxes[1, 1] - self.boxes[1, 0]))
