"""Trees of boxes around the triangles of a surface."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from packit_sim.geometry.arrays import Floats, Ints

_PER_LEAF = 4
"""Maximum number of triangles in a leaf of a tree."""


def tree_order(triangles: Floats) -> Ints:
    """Order the triangles of a surface so that those near each other follow each other.

    Parameters
    ----------
    triangles : ndarray of float64, shape (n, 3, 3)
        The corners of its triangles.

    Returns
    -------
    ndarray of int32, shape (n,)
        The numbers of the triangles, for a tree of the surface at any scale.
    """
    middles = triangles[:, 0] + triangles[:, 1] + triangles[:, 2]
    return cKDTree(middles, leafsize=_PER_LEAF).indices.astype(np.int32)  # halves recursively


def boxes_of(triangles: Floats) -> tuple[Floats, Ints]:
    """Build a complete binary tree of boxes; the children of node n are 2 n and 2 n + 1.

    Parameters
    ----------
    triangles : ndarray of float64, shape (n, 3, 3)
        The corners of the triangles in the order of the tree, at least one.

    Returns
    -------
    boxes : ndarray of float64, shape (2 leaves, 2, 3)
        Lowest and highest corners, from the root at 1 to the leaves.
    starts : ndarray of int64, shape (leaves + 1,)
        The first triangle of each leaf.
    """
    leaves = 1
    while leaves * _PER_LEAF < len(triangles):
        leaves *= 2
    starts = np.arange(leaves + 1) * len(triangles) // leaves
    first, second, third = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    low = np.minimum(np.minimum(first, second), third)
    high = np.maximum(np.maximum(first, second), third)
    boxes = np.empty((2 * leaves, 2, 3))
    boxes[leaves:, 0] = np.minimum.reduceat(low, starts[:-1])
    boxes[leaves:, 1] = np.maximum.reduceat(high, starts[:-1])
    while leaves > 1:
        children = boxes[leaves : 2 * leaves]
        leaves //= 2
        boxes[leaves : 2 * leaves, 0] = np.minimum(children[::2, 0], children[1::2, 0])
        boxes[leaves : 2 * leaves, 1] = np.maximum(children[::2, 1], children[1::2, 1])
    return boxes, starts
