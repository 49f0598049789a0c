"""Quantized meshes of stored libraries: compact, and bit for bit the same on every machine."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.core.errors import MeshError
from packit_sim.core.files import naming
from packit_sim.core.npz_arrays import read_array
from packit_sim.geometry.shapes import Shape

MAX_COMPRESSION = 32
"""Maximum bytes of an array per byte of its file; meshes compress to about half."""

DIAGONAL_SLACK = 1e-6
"""Largest difference of a stored mesh's diagonal from 1: rounding."""

LATTICE_STEPS = 65535
"""Steps of the bounding box's lattice along each axis: vertices are stored as uint16."""


@dataclass(frozen=True, eq=False)
class QuantizedMesh:
    """A canonical mesh with vertices on the lattice of its bounding box.

    Attributes
    ----------
    vertices : ndarray
        (n, 3) uint16, from 0 to 65535 along each axis.
    faces : ndarray
        (m, 3) uint16, or uint32 if there are more vertices.
    extents : ndarray
        (3,) float64, in canonical units.
    """

    vertices: npt.NDArray[np.uint16]
    faces: npt.NDArray[np.unsignedinteger[Any]]
    extents: npt.NDArray[np.float64]

    @classmethod
    def of(cls, shape: Shape) -> QuantizedMesh:
        """Quantize a shape's mesh, without the triangles that lose their area.

        Parameters
        ----------
        shape : Shape
            The shape; its vertices move by up to half a lattice step.

        Returns
        -------
        QuantizedMesh
            Its mesh on the lattice.

        Raises
        ------
        MeshError
            If nothing solid is left.
        """
        while True:
            low, extents = shape.mesh.bounds[0], np.array(shape.mesh.extents, dtype=np.float64)
            lattice = np.rint((shape.mesh.vertices - low) / extents * LATTICE_STEPS).astype(int)
            on_lattice = trimesh.Trimesh(lattice, shape.mesh.faces, process=False)
            on_lattice.merge_vertices(digits_vertex=0)
            a, b, c = on_lattice.vertices[on_lattice.faces].astype(int).swapaxes(0, 1)
            on_lattice.update_faces(np.cross(b - a, c - a).any(axis=1))
            on_lattice.update_faces(on_lattice.unique_faces())
            on_lattice.remove_unreferenced_vertices()
            vertices = on_lattice.vertices.astype(np.uint16)
            if len(vertices) and (np.ptp(vertices, axis=0) == LATTICE_STEPS).all():
                index = np.uint16 if len(vertices) <= LATTICE_STEPS else np.uint32
                return cls(vertices, on_lattice.faces.astype(index), extents)
            left = trimesh.Trimesh(on_lattice.vertices * extents, on_lattice.faces, process=False)
            shape = Shape.from_mesh(left, shape.id, shape.category)

    @classmethod
    def load(cls, file: Path) -> QuantizedMesh:
        """Read a file that `save` wrote.

        Returns
        -------
        QuantizedMesh
            Its mesh.

        Raises
        ------
        MeshError
            If the file can't be read, is not of this form, or is damaged. The memory that this
            takes is bounded by the size of the file, not by what the file says of itself.
        """
        try:
            max_bytes = MAX_COMPRESSION * file.stat().st_size
            with ZipFile(file) as archive:
                vertices = read_array(archive, "vertices", ("<u2",), (None, 3), max_bytes)
                faces = read_array(archive, "faces", ("<u2", "<u4"), (None, 3), max_bytes)
                extents = read_array(archive, "extents", ("<f8",), (3,), max_bytes)
        except Exception as error:  # numpy and zipfile raise any error for a damaged file
            raise MeshError(f"not a stored mesh: {error or type(error).__name__}") from error
        if not len(vertices) or not len(faces) or faces.max() >= len(vertices):
            raise MeshError("not a stored mesh: a triangle has no vertices")
        diagonal = math.hypot(*extents.tolist())
        if not (abs(diagonal - 1) < DIAGONAL_SLACK and (extents > 0).all()):
            raise MeshError(
                f"not a stored mesh: its extents are {extents.tolist()}, their diagonal must be 1"
            )
        return cls(vertices, faces, extents)

    def save(self, file: Path) -> None:
        """Write the shape as npz; missing folders are created."""
        file.parent.mkdir(parents=True, exist_ok=True)
        with naming(file):
            np.savez_compressed(
                file, vertices=self.vertices, faces=self.faces, extents=self.extents
            )

    def mesh(self) -> trimesh.Trimesh:
        """Return the canonical mesh: exactly centred, bit for bit the same on every machine."""
        vertices = (self.vertices / LATTICE_STEPS - 0.5) * self.extents
        return trimesh.Trimesh(vertices, self.faces.astype(np.int64), process=False)
