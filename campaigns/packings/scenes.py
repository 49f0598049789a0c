"""Scenes: meshes at places, as GLB, glTF, COLLADA and 3MF files have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from campaigns.packings.shapes import Floats, Shape


@dataclass(frozen=True, eq=False)
class Node:
    """A mesh at a place.

    Attributes
    ----------
    mesh : int
        Its number.
    user_from_mesh : ndarray of float64, shape (4, 4)
        Where it is, in millimetres with z up; it may scale.
    is_printed : bool
        Whether a 3MF file says that it is to be printed.
    """

    mesh: int
    user_from_mesh: Floats
    is_printed: bool = True


@dataclass(frozen=True, eq=False)
class Scene:
    """The content of a file.

    Attributes
    ----------
    names : tuple of str
        The names of the meshes.
    shapes : tuple of Shape
        The meshes in millimetres.
    nodes : tuple of Node
        Where they are.
    unit : float
        Millimetres in the file's unit.
    up : ndarray of float64, shape (3, 3)
        From the file's axes to z up.
    inner : float
        Units of a mesh's own coordinates in a millimetre, where nodes may scale.
    """

    names: tuple[str, ...]
    shapes: tuple[Shape, ...]
    nodes: tuple[Node, ...]
    unit: float
    up: Floats
    inner: float

    def local(self, number: int) -> Floats:
        """Return the vertices (n, 3) of a mesh in its own coordinates."""
        return self.shapes[number].vertices * self.inner

    def matrix(self, node: Node) -> Floats:
        """Return a node's matrix (4, 4) from a mesh's own coordinates to the file's."""
        found = np.eye(4)
        found[:3, :3] = self.up.T @ node.user_from_mesh[:3, :3] / (self.unit * self.inner)
        found[:3, 3] = self.up.T @ node.user_from_mesh[:3, 3] / self.unit
        return found


def quaternion(matrix: Floats) -> Sequence[float]:
    """Return a rotation (3, 3) as x, y, z, w."""
    four = np.array(
        [
            [1 + matrix[0, 0] - matrix[1, 1] - matrix[2, 2], 0, 0, 0],
            [0, 1 - matrix[0, 0] + matrix[1, 1] - matrix[2, 2], 0, 0],
            [0, 0, 1 - matrix[0, 0] - matrix[1, 1] + matrix[2, 2], 0],
            [0, 0, 0, 1 + matrix[0, 0] + matrix[1, 1] + matrix[2, 2]],
        ]
    )
    for i, j in ((0, 1), (0, 2), (1, 2)):
        four[i, j] = four[j, i] = matrix[i, j] + matrix[j, i]
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        four[k, 3] = four[3, k] = matrix[i, j] - matrix[j, i]
    column = four[:, int(np.argmax(np.diag(four)))]
    return [float(each) for each in column / np.linalg.norm(column)]
