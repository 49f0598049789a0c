"""Pieces of a cut box: their exact surfaces, and the items that they become.

Coordinates are integers in millionths of a box unit, so that two pieces are equal or they are not,
and a puzzle is the same on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Ints
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELLS_PER_UNIT, STEP, Triple
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.geometry.shapes import Item, Shape

UNITS = 1_000_000
"""Units of a piece's coordinates along a box unit."""

STEP_UNITS = UNITS // CELLS_PER_UNIT * STEP
"""Units along a step of the grid."""

NODES = CELLS_PER_UNIT // STEP
"""Steps of the grid along the box."""

NONE = -1
"""Fills the fourth place of a triangle among quadrilaterals."""


@dataclass(frozen=True, eq=False)
class PuzzlePiece:
    """A piece of a cut box, where it was cut.

    Attributes
    ----------
    category : str
        The kind of the piece, such as "cuboid".
    node : tuple of int
        The grid node at which the minimum corner of its cell box is.
    vertices : ndarray of int64, shape (n, 3)
        The corners of its surface, in millionths of the box.
    faces : ndarray of int64, shape (m, 4)
        Planar, convex quadrilaterals, counterclockwise from outside, as indices of vertices;
        a triangle's last index is `NONE`.
    """

    category: str
    node: Triple
    vertices: Ints
    faces: Ints

    @classmethod
    def cuboid(cls, start: Triple, stop: Triple) -> PuzzlePiece:
        """Return the cuboid between two grid nodes."""
        ends = np.array([start, stop]) * STEP_UNITS
        corners = np.indices((2, 2, 2)).reshape(3, 8).T
        faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        return cls("cuboid", start, ends[corners, np.arange(3)], np.array(faces))

    def item(self) -> PlacedItem:
        """Return the piece as an item at its place.

        Returns
        -------
        PlacedItem
            The item. Equal pieces have the same shape: its canonical orientation is that, of 24, in
            which the sorted vertices and faces come first, and so does not give the piece's
            rotation in the box away.
        """
        doubled = 2 * self.vertices - self.vertices.min(axis=0) - self.vertices.max(axis=0)
        forms = [_sorted(doubled @ matrix.T, self.faces) for matrix in rotations.MATRICES]
        first = min(range(rotations.COUNT), key=lambda n: tuple(map(np.ndarray.tolist, forms[n])))
        vertices, faces = forms[first]
        inverse = (rotations.MATRICES == rotations.MATRICES[first].T).all(axis=(1, 2))
        diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0))) / (2 * UNITS)
        mesh = trimesh.Trimesh(vertices / (2 * UNITS * diagonal), _triangles(faces), process=False)
        digest = Shape(mesh, "", "").digest
        shape = Shape.from_mesh(mesh, f"{self.category}-{digest[:12]}", self.category)
        stored = Shape(QuantizedMesh.of(shape).mesh(), shape.id, shape.category)
        return PlacedItem(Item(stored, diagonal**3, int(np.flatnonzero(inverse)[0])), self.node)


def _sorted(vertices: Ints, faces: Ints) -> tuple[Ints, Ints]:
    """Sort vertices, and faces by them, each from its first vertex on."""
    order = np.lexsort(vertices.T[::-1])
    names = np.append(np.argsort(order), NONE)
    named = names[faces]
    is_triangle = named[:, 3] == NONE
    starts = np.where(named == NONE, len(vertices), named).argmin(axis=1)
    sides = np.where(is_triangle, 3, 4)
    turned = (starts[:, None] + np.arange(4)) % sides[:, None]
    named = np.take_along_axis(named, turned, axis=1)
    named[is_triangle, 3] = NONE
    return vertices[order], named[np.lexsort(named.T[::-1])]


def _triangles(faces: Ints) -> npt.NDArray[np.int64]:
    """Divide quadrilaterals at their first vertex."""
    quadrilaterals = faces[faces[:, 3] != NONE]
    return np.concatenate([faces[:, :3], quadrilaterals[:, [0, 2, 3]]])
