"""Meshes as the validity check of packings compares them: drawn in by a tolerance."""

from __future__ import annotations

import math

import numpy as np
import trimesh

from packit_sim.core.caches import bounded_cache, cached_property
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import CONTACT_TOLERANCE, FINE_PER_CELL
from packit_sim.geometry.parts import by_part, closed_parts, part_numbers
from packit_sim.geometry.repair import repair_mesh
from packit_sim.geometry.triangle_tree_kernels import meeting
from packit_sim.geometry.triangle_trees import boxes_of, tree_order
from packit_sim.geometry.voxelization_kernels import reached_cells, touched_cells
from packit_sim.parts.packings.checked_items import MAX_SHRINKAGE
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.placement import LooseMesh, triangles_cross, winding_number

UNIT_MESHES_BUDGET = 4_000_000
"""Triangles in the process's cache of unit meshes: 0.2 kB each."""

VOXELS = 1500
"""Triangles that take as much memory as the voxels of a solid."""

RESOLUTION = 200
"""Voxels along the longest side of an item's solid."""

SAMPLES = 9
"""Points of a part that vote on whether it is inside a shell of another mesh."""

_GROWTH = MAX_SHRINKAGE * (1 + 1e-6)
"""Growth of the voxels that a surface touches: how deep one surface may be in another, at most."""

_LEAST = 1e-9
"""Least share of a side that is left after drawing in, where it is shorter than the tolerance."""

_ROUNDING = 1e-9
"""Regions are grown by this, so that rounding doesn't lose a triangle."""


class UnitMesh:
    """The mesh of a type of items, centred, with a longest side of 1: what is found out only once.

    Attributes
    ----------
    vertices : ndarray of float64, shape (n, 3)
        The vertices, from the centre of the bounding box.
    half : ndarray of float64, shape (3,)
        Half the sides of the bounding box.
    """

    def __init__(self, item_type: ItemType) -> None:
        self.faces = item_type.faces
        middle = (item_type.low + item_type.high) / 2
        longest = float(item_type.extents.max())
        self.vertices = (item_type.vertices - middle) / longest
        self.half = item_type.extents / longest / 2
        self._surfaces: dict[float, LooseMesh] = {}

    @cached_property
    def tree(self) -> tuple[Floats, Floats, Ints]:
        """The triangles, boxes and starts of its tree (see `triangle_trees`)."""
        triangles = self.vertices[self.faces]
        triangles = triangles[tree_order(triangles)]
        return triangles, *boxes_of(triangles)

    def surface(self, size: float) -> LooseMesh:
        """Look up the mesh with another longest side, for distances."""
        if size not in self._surfaces:
            self._surfaces[size] = LooseMesh(self.vertices * size, self.faces)
        return self._surfaces[size]

    @cached_property
    def shells(self) -> list[Floats]:
        """The corners (m, 3, 3) of the triangles of each shell: a closed part.

        The holes are filled that the importer would fill.
        """
        mesh, _ = repair_mesh(trimesh.Trimesh(self.vertices, self.faces, process=False))
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        part = part_numbers(faces, len(vertices))
        every = by_part(vertices[faces], part)
        return [every[n] for n in np.flatnonzero(closed_parts(faces, part))]

    @cached_property
    def shell_boxes(self) -> Floats:
        """The lowest and highest corner (k, 2, 3) of each shell."""
        boxes = [(shell.min(axis=(0, 1)), shell.max(axis=(0, 1))) for shell in self.shells]
        return np.array(boxes).reshape(-1, 2, 3)

    @cached_property
    def _part(self) -> Ints:
        """(m,) the number of each triangle's connected part."""
        return part_numbers(self.faces, len(self.vertices))

    @cached_property
    def sampled_faces(self) -> Ints:
        """Some triangles (p, SAMPLES, 3) of each connected part, as indices of vertices."""
        found = [
            triangles[np.linspace(0, len(triangles) - 1, SAMPLES).astype(int)]
            for triangles in by_part(np.arange(len(self.faces)), self._part)
        ]
        return np.asarray(self.faces[np.array(found)])

    @cached_property
    def vertices_by_part(self) -> tuple[Ints, Ints]:
        """The vertices (n,) sorted by connected part, and where each part starts (p,)."""
        part = np.zeros(len(self.vertices), np.int64)
        part[self.faces] = self._part[:, None]
        order = np.argsort(part, kind="stable")
        return order, np.flatnonzero(np.diff(part[order], prepend=-1))

    @cached_property
    def enclosed(self) -> tuple[Words, float, Floats]:
        """The enclosed voxels [x, y, z] around the origin, their words' side, and their bounds."""
        side = 1 / RESOLUTION * FINE_PER_CELL
        cells = np.ceil(2 * self.half / side).astype(np.int64) + 2
        touched = touched_cells(self.tree[0], cells, side, _GROWTH)
        enclosed = ~(touched | reached_cells(touched))
        found = np.argwhere(enclosed)
        if len(found) == 0:
            return enclosed, side, np.zeros((2, 3))
        bounds = np.array((found.min(axis=0), found.max(axis=0) + 1)) - cells / 2
        return enclosed, side, bounds * side


@bounded_cache(
    "unit meshes",
    UNIT_MESHES_BUDGET,
    "triangles",
    size=lambda mesh: len(mesh.faces) + VOXELS,
    key=lambda item_type: item_type.digest,
)
def unit_mesh(item_type: ItemType) -> UnitMesh:
    """Look up the unit mesh of a type."""
    return UnitMesh(item_type)


class CheckedMesh:
    """The mesh of a type of items, drawn in towards the centre of its bounding box.

    Lengths are in some unit, from that centre, along the axes of the type's mesh. The other mesh of
    a method is rotated by `turn` (3, 3) and then translated by `shift` (3,), from the one frame to
    the other.

    Parameters
    ----------
    scale : float
        The scale of its lengths.
    unit : float
        The unit, in that of the type.
    drawn_in : float
        How much the bounding box becomes shorter along each axis, in the unit of the type.
    """

    def __init__(self, item_type: ItemType, scale: float, unit: float, drawn_in: float) -> None:
        self.mesh = unit_mesh(item_type)
        self._unit = unit
        self._longest = scale * float(item_type.extents.max())
        self._size = self._longest / unit
        extents = 2 * self.mesh.half * self._longest
        left = np.maximum(extents - drawn_in, _LEAST * extents) / extents
        self._sizes = self._size * left

    @cached_property
    def vertices(self) -> Floats:
        """The vertices (n, 3)."""
        return self.mesh.vertices * self._sizes

    def crosses(self, other: CheckedMesh, turn: Floats, shift: Floats) -> bool:
        """Return whether a triangle of it crosses one of another mesh.

        Only triangles in the common part of their bounding boxes are looked at.
        """
        half, other_half = self.mesh.half * self._sizes, other.mesh.half * other._sizes
        reach = np.abs(turn) @ other_half
        low, high = np.maximum(-half, shift - reach), np.minimum(half, shift + reach)
        if (low > high + _ROUNDING).any():
            return False
        own = self._in(low, high)
        others = other._seen_in(low, high, turn, shift)
        if len(own) == 0 or len(others) == 0:
            return False
        middle = (low + high) / 2  # near the origin, numbers are most accurate
        return triangles_cross(own - middle, others - middle)

    def _in(self, low: Floats, high: Floats) -> Floats:
        """Return its triangles (k, 3, 3) in a region."""
        tree = self.mesh.tree
        region = np.stack((low - _ROUNDING, high + _ROUNDING)) / self._sizes
        return tree[0][meeting(tree, region)] * self._sizes

    def _seen_in(self, low: Floats, high: Floats, turn: Floats, shift: Floats) -> Floats:
        """Return its triangles (k, 3, 3) that meet a region of another frame, in that frame."""
        middle, half = turn.T @ ((low + high) / 2 - shift), np.abs(turn.T) @ ((high - low) / 2)
        triangles = self._in(middle - half, middle + half) @ turn.T + shift
        near = (triangles.min(axis=1) <= high + _ROUNDING) & (
            triangles.max(axis=1) >= low - _ROUNDING
        )
        return triangles[near.all(axis=1)]

    def distance(self, other: CheckedMesh, turn: Floats, shift: Floats) -> float:
        """Compute the distance to another mesh, in the unit of the types; neither is drawn in.

        FCL's distances are too short or too long by up to 1/500 in numbers that are much smaller
        than these: the fine unit is nearly the tolerance. As a power of two, pairs share it.
        """
        fine = 2.0 ** math.floor(math.log2(CONTACT_TOLERANCE * self._unit))
        one = self.mesh.surface(self._longest / fine)
        two = other.mesh.surface(other._longest / fine)
        return one.distance(two, shift * (self._unit / fine), turn) * fine

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
        return self._holds_part(other, turn, shift) or self._holds_surface(other, turn, shift)

    def _holds_part(self, other: CheckedMesh, turn: Floats, shift: Floats) -> bool:
        half = self.mesh.half * self._sizes * (1 + 1e-9)
        corners = other.mesh.vertices[other.mesh.sampled_faces] * other._sizes @ turn.T + shift
        if not (np.abs(corners) <= half).all(axis=(1, 2, 3)).any():  # most pairs: spares the rest
            return False
        order, starts = other.mesh.vertices_by_part
        by_part = (other.vertices @ turn.T + shift)[order]
        low = np.minimum.reduceat(by_part, starts)
        high = np.maximum.reduceat(by_part, starts)
        if not ((-half <= low) & (high <= half)).all(axis=1).any():
            return False
        boxes = self.mesh.shell_boxes[:, None] * self._sizes
        within = np.all((boxes[:, :, 0] <= low) & (high <= boxes[:, :, 1]), axis=2)
        points = corners.mean(axis=2) / self._sizes
        for shell, part in np.argwhere(within).tolist():
            winds = [abs(winding_number(self.mesh.shells[shell], p)) for p in points[part]]
            if np.median(winds) > 0.5:
                return True
        return False

    def _holds_surface(self, other: CheckedMesh, turn: Floats, shift: Floats) -> bool:
        enclosed, side, bounds = self.mesh.enclosed
        low, high = bounds * self._size
        corners = other._seen_in(low, high, turn, shift) / self._size
        if len(corners) == 0:
            return False
        low = np.maximum(bounds[0], corners.min(axis=(0, 1)))
        high = np.minimum(bounds[1], corners.max(axis=(0, 1)))
        middle = np.array(enclosed.shape) / 2
        start = np.maximum(np.floor(low / side + middle).astype(np.int64) - 1, 0)
        stop = np.minimum(np.ceil(high / side + middle).astype(np.int64) + 1, enclosed.shape)
        centre = ((start + stop) / 2 - middle) * side
        touched = touched_cells(corners - centre, stop - start, side, 0.0)
        block = enclosed[tuple(map(slice, start, stop))]
        return bool((touched & block).any())
