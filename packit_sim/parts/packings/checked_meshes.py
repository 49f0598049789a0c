"""Meshes as the validity check of packings compares them: drawn in by a tolerance."""

from __future__ import annotations

import numpy as np
import trimesh

from packit_sim.core.caches import bounded_cache, cached_property
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import CONTACT_TOLERANCE, FINE_PER_CELL
from packit_sim.geometry.parts import Parts, part_numbers
from packit_sim.geometry.repair import repair_mesh
from packit_sim.geometry.voxelization_kernels import reached_cells, touched_cells
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.placement import LooseMesh, winding_number

CHECKED_MESHES_BUDGET = 400_000
"""Triangles in the process's cache of checked meshes."""

RESOLUTION = 200
"""Voxels along the longest side of an item's solid."""

SAMPLES = 9
"""Points of a part that vote on whether it is inside a shell of another mesh."""

_GROWTH = CONTACT_TOLERANCE * (0.5 + 1e-6)
"""Growth of the voxels that a surface touches: what is drawn in may be half the tolerance deep."""


class CheckedMesh:
    """The mesh of a type of items, drawn in towards the centre of its bounding box.

    Lengths are in the unit in which the tolerance is the contact tolerance, from that centre, along
    the axes of the type's mesh. The other mesh of a method is rotated by `turn` (3, 3) and then
    translated by `shift` (3,), from the one frame to the other.

    Parameters
    ----------
    scale : float
        The scale of its lengths.
    tolerance : float
        How much the bounding box becomes shorter along each axis, in the container's unit.
    """

    def __init__(self, item_type: ItemType, scale: float, tolerance: float) -> None:
        self.item_type = item_type
        self._middle = (item_type.low + item_type.high) / 2
        self._size = scale / (tolerance / CONTACT_TOLERANCE)
        extents = item_type.extents * self._size
        self._drawn = self._size * np.maximum(extents - CONTACT_TOLERANCE, 0) / extents

    @cached_property
    def vertices(self) -> Floats:
        """The vertices (n, 3)."""
        return (self.item_type.vertices - self._middle) * self._drawn

    @cached_property
    def surface(self) -> LooseMesh:
        """The mesh for collision tests."""
        return LooseMesh(self.vertices, self.item_type.faces)

    @cached_property
    def full_surface(self) -> LooseMesh:
        """The mesh that is not drawn in, for collision tests."""
        vertices = (self.item_type.vertices - self._middle) * self._size
        return LooseMesh(vertices, self.item_type.faces)

    @cached_property
    def whole_surface(self) -> LooseMesh:
        """The mesh that is not drawn in, for distances, in tolerances.

        In much smaller numbers, FCL's distances are too short or too long by up to 1/500.
        """
        size = self._size / CONTACT_TOLERANCE
        vertices = (self.item_type.vertices - self._middle) * size
        return LooseMesh(vertices, self.item_type.faces)

    @cached_property
    def shells(self) -> list[Floats]:
        """The corners (m, 3, 3) of the triangles of each shell: a closed part.

        The holes are filled that the importer would fill.
        """
        item_type = self.item_type
        size = float(item_type.extents.max())
        frame = (item_type.vertices - self._middle) / size
        mesh, _ = repair_mesh(trimesh.Trimesh(frame, item_type.faces, process=False))
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        corners = vertices * size * self._drawn
        return [corners[shell] for shell in Parts.of(vertices, faces).shells]

    @cached_property
    def _shell_boxes(self) -> Floats:
        """(k, 2, 3) the bounding box of each shell."""
        boxes = [(shell.min(axis=(0, 1)), shell.max(axis=(0, 1))) for shell in self.shells]
        return np.array(boxes).reshape(-1, 2, 3)

    @cached_property
    def _part(self) -> Ints:
        """(m,) the number of each triangle's connected part."""
        return part_numbers(self.item_type.faces, len(self.vertices))

    @cached_property
    def sampled_faces(self) -> list[Ints]:
        """Some triangles (s, 3) of each connected part, as indices of vertices."""
        found = []
        for part in range(self._part.max() + 1):
            triangles = np.flatnonzero(self._part == part)
            some = np.linspace(0, len(triangles) - 1, min(SAMPLES, len(triangles))).astype(int)
            found.append(self.item_type.faces[triangles[some]])
        return found

    @cached_property
    def _vertices_by_part(self) -> tuple[Ints, Ints]:
        """The vertices (n,) sorted by connected part, and where each part starts (p,)."""
        part = np.zeros(len(self.vertices), np.int64)
        part[self.item_type.faces] = self._part[:, None]
        order = np.argsort(part, kind="stable")
        return order, np.flatnonzero(np.diff(part[order], prepend=-1))

    @cached_property
    def _enclosed(self) -> tuple[Words, float, Floats]:
        """The enclosed voxels [x, y, z] around the origin, their words' side, and their bounds."""
        half = self.item_type.extents * self._size / 2
        side = 2 * float(half.max()) / RESOLUTION * FINE_PER_CELL
        cells = np.ceil(2 * half / side).astype(np.int64) + 2
        corners = (self.item_type.vertices - self._middle) * self._size
        touched = touched_cells(corners[self.item_type.faces], cells, side, _GROWTH)
        enclosed = ~(touched | reached_cells(touched))
        found = np.argwhere(enclosed)
        if len(found) == 0:
            return enclosed, side, np.zeros((2, 3))
        bounds = np.array((found.min(axis=0), found.max(axis=0) + 1)) - cells / 2
        return enclosed, side, bounds * side

    def holds(self, other: CheckedMesh, turn: Floats, shift: Floats) -> bool:
        """Return whether a part of another mesh is in a shell, or its surface in the solid.

        Parameters
        ----------
        other : CheckedMesh
            The other mesh; the surfaces don't cross.
        turn : ndarray of float64, shape (3, 3)
            Its rotation.
        shift : ndarray of float64, shape (3,)
            Its translation.

        Returns
        -------
        bool
            Whether a part lies inside a shell, by the winding numbers of some of its points, or
            whether the surface meets a voxel that this mesh encloses.
        """
        vertices = other.vertices @ turn.T + shift
        return self._holds_part(other, vertices) or self._holds_surface(other, vertices)

    def _holds_part(self, other: CheckedMesh, vertices: Floats) -> bool:
        order, starts = other._vertices_by_part
        by_part = vertices[order]
        low = np.minimum.reduceat(by_part, starts)
        high = np.maximum.reduceat(by_part, starts)
        half = self.item_type.extents * self._drawn * (0.5 + 1e-9)
        if not ((-half <= low) & (high <= half)).all(axis=1).any():  # most pairs: spares shells
            return False
        boxes = self._shell_boxes[:, None]
        within = np.all((boxes[:, :, 0] <= low) & (high <= boxes[:, :, 1]), axis=2)
        for shell, part in np.argwhere(within).tolist():
            points = vertices[other.sampled_faces[part]].mean(axis=1)
            winds = [abs(winding_number(self.shells[shell], p)) for p in points]
            if np.median(winds) > 0.5:
                return True
        return False

    def _holds_surface(self, other: CheckedMesh, vertices: Floats) -> bool:
        enclosed, side, (low, high) = self._enclosed
        if (vertices.min(axis=0) > high).any() or (vertices.max(axis=0) < low).any():
            return False
        corners = [vertices[corner] for corner in other.item_type.faces.T]
        near = (np.minimum.reduce(corners) <= high) & (np.maximum.reduce(corners) >= low)
        corners = np.stack(corners, axis=1)[near.all(axis=1)]
        if len(corners) == 0:
            return False
        low = np.maximum(low, corners.min(axis=(0, 1)))
        high = np.minimum(high, corners.max(axis=(0, 1)))
        middle = np.array(enclosed.shape) / 2
        start = np.maximum(np.floor(low / side + middle).astype(np.int64) - 1, 0)
        stop = np.minimum(np.ceil(high / side + middle).astype(np.int64) + 1, enclosed.shape)
        centre = ((start + stop) / 2 - middle) * side
        touched = touched_cells(corners - centre, stop - start, side, 0.0)
        block = enclosed[tuple(map(slice, start, stop))]
        return bool((touched & block).any())


@bounded_cache(
    "checked meshes",
    CHECKED_MESHES_BUDGET,
    "triangles",
    size=lambda mesh: len(mesh.item_type.faces),
    key=lambda item_type, scale, tolerance: (item_type.digest, scale, tolerance),
)
def checked_mesh(item_type: ItemType, scale: float, tolerance: float) -> CheckedMesh:
    """Look up the mesh of a type at a scale, drawn in by a tolerance."""
    return CheckedMesh(item_type, scale, tolerance)
