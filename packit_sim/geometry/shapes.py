"""Shapes and items: what there is to pack, and what is placed.

A `Shape` is a mesh in its canonical frame; an `Item` is a shape at a scale in one of the 24
rotations. Both are values: they never change, and what is derived from them is computed once.
"""

from __future__ import annotations

import hashlib
import math
import operator
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.core.caches import bounded_cache, cached_property
from packit_sim.core.errors import ArgumentError, MeshError
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import Triple, cell_box
from packit_sim.geometry.repair import Repairs, clean_mesh, repair_mesh
from packit_sim.geometry.voxelization import solid_volume
from packit_sim.geometry.voxels import Voxels

VOXELS_BUDGET = 512 * 2**20
"""Bytes in each of the process's two caches of voxels: upright ones, and turned ones."""

Axis = Literal["x", "y", "z"]

UP_AXES: tuple[Axis, ...] = get_args(Axis)
"""The axes that may point up in a mesh file."""

_MIN_EXTENT = 1e-9
"""Extents below this share of the bounding box's diagonal are none: rounding of a flat mesh."""


class Shape:
    """A mesh in its canonical frame: centred on its bounding box, diagonal 1, z up.

    id, category: names, of which the first is unique in a library.
    mesh: the canonical mesh, triangles only. volume: in canonical units, of the closed body or of
    its solid by voxels (see `voxelization.solid_volume`). digest: SHA-256 of the geometry, in hex.
    """

    def __init__(
        self, mesh: trimesh.Trimesh, id: str, category: str, volume: float | None = None
    ) -> None:
        """Takes a mesh that is canonical already; `from_mesh` makes one of any mesh."""
        self.mesh = mesh
        self.id = id
        self.category = category
        if volume is not None:
            self.volume = volume

    @classmethod
    def from_mesh(cls, mesh: trimesh.Trimesh, id: str, category: str = "", up: str = "z") -> Shape:
        """The shape of any triangle mesh; `up` is the mesh's own up axis, "x", "y" or "z".

        Doubled vertices are merged and triangles without area dropped. Raises MeshError where the
        mesh is empty, not finite, or has no extent along an axis.
        """
        return cls(_canonical(mesh, id, up)[0], id, category)

    @classmethod
    def repaired(
        cls, mesh: trimesh.Trimesh, id: str, category: str = "", up: str = "z"
    ) -> tuple[Shape, Repairs]:
        """The shape of a mesh whose winding and small holes are repaired, and what was done.

        See `repair.repair_mesh`; else as `from_mesh`.
        """
        clean, cleaning = _canonical(mesh, id, up)
        whole, mending = repair_mesh(clean)
        shape = cls(_canonical(whole, id, "z")[0] if mending else clean, id, category)
        return shape, replace(
            cleaning,
            flipped_triangles=mending.flipped_triangles,
            filled_holes=mending.filled_holes,
        )

    @cached_property
    def extents(self) -> npt.NDArray[np.float64]:
        """(3,) canonical extents."""
        return np.array(self.mesh.extents)

    @cached_property
    def is_solid(self) -> bool:
        """Whether the mesh is one closed body with consistent winding: its volume is exact."""
        mesh = self.mesh
        return bool(
            mesh.is_watertight
            and mesh.is_winding_consistent
            and mesh.body_count == 1
            and _signed_volume(mesh) > 0
        )

    @cached_property
    def volume(self) -> float:
        """In canonical units: of the closed body, or of the solid by voxels."""
        if self.is_solid:
            return _signed_volume(self.mesh)
        return solid_volume(self.mesh.triangles)

    @cached_property
    def digest(self) -> str:
        sha = hashlib.sha256(np.ascontiguousarray(self.mesh.vertices, dtype="<f8").tobytes())
        sha.update(np.ascontiguousarray(self.mesh.faces, dtype="<i8").tobytes())
        return sha.hexdigest()

    def __repr__(self) -> str:
        return f"Shape({self.id!r}, {self.category!r}, {len(self.mesh.faces)} triangles)"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Shape):
            return NotImplemented
        return self is other or (self.id, self.digest) == (other.id, other.digest)

    def __hash__(self) -> int:
        return hash(self.digest)


@dataclass(frozen=True)
class Item:
    """A shape at a scale in a rotation: what is placed.

    scale: ratio of volumes to the canonical shape, more than 0. rotation: 0 to 23.
    Raises ValueError where either is out of range.
    """

    shape: Shape
    scale: float = 1.0
    rotation: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale > 0):
            raise ArgumentError(f"scale {self.scale!r} is not possible: it must be more than 0")
        try:
            rotation = operator.index(self.rotation)
        except TypeError:
            rotation = -1
        if not 0 <= rotation < rotations.COUNT:
            raise ArgumentError(
                f"rotation {self.rotation!r} is not one of 0 to {rotations.COUNT - 1}"
            )
        object.__setattr__(self, "scale", float(self.scale))
        object.__setattr__(self, "rotation", rotation)

    def turned(self, rotation: int) -> Item:
        """The same shape and scale in another of the 24 rotations, counted from the canonical."""
        return Item(self.shape, self.scale, rotation)

    @cached_property
    def key(self) -> tuple[str, float, int]:
        """What the item is, whichever objects stand for it: geometry, scale and rotation."""
        return self.shape.digest, self.scale, self.rotation

    @cached_property
    def volume(self) -> float:
        """In box units cubed: the scale times the shape's."""
        return self.scale * self.shape.volume

    @cached_property
    def extents(self) -> npt.NDArray[np.float64]:
        """(3,) in box units."""
        return rotations.turn_extents(self.shape.extents, self.rotation) * np.cbrt(self.scale)

    @cached_property
    def cells(self) -> Triple:
        """Cells an axis of the cell box, which is centred on the item."""
        return cell_box(self.extents)

    @cached_property
    def linear(self) -> npt.NDArray[np.float64]:
        """(3, 3): turns and scales the canonical shape into the item's frame."""
        return rotations.MATRICES[self.rotation] * np.cbrt(self.scale)

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """The shape's mesh scaled and turned, centred on the origin, in box units."""
        vertices = rotations.turn_vectors(self.shape.mesh.vertices, self.rotation)
        return trimesh.Trimesh(vertices * np.cbrt(self.scale), self.shape.mesh.faces, process=False)

    @property
    def voxels(self) -> Voxels:
        """The outer and inner fine cells: made once a shape and scale, then turned."""
        return _turned_voxels(self)

    @property
    def outer(self) -> npt.NDArray[np.bool_]:
        """Bool over `cells`: cells that the surface touches or that hold an enclosed fine cell."""
        return self.voxels.outer_cells

    @property
    def inner(self) -> npt.NDArray[np.bool_]:
        """Bool over `cells`: cells that are enclosed and that the surface does not touch."""
        return self.voxels.inner_cells


def _canonical(mesh: trimesh.Trimesh, id: str, up: str) -> tuple[trimesh.Trimesh, Repairs]:
    """A mesh cleaned and in its canonical frame, and what was cleaned away."""
    if up not in UP_AXES:
        raise ArgumentError(f"up axis {up!r} is not known: choose from {', '.join(UP_AXES)}")
    if not isinstance(mesh, trimesh.Trimesh):
        raise MeshError(f"shape {id!r}: expected a trimesh.Trimesh, not {type(mesh).__name__}")
    vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    used = np.unique(faces)
    if len(used) == 0:
        raise MeshError(
            f"shape {id!r}: the mesh is empty: {len(vertices)} vertices, {len(faces)} triangles"
        )
    if used[0] < 0 or used[-1] >= len(vertices):
        raise MeshError(
            f"shape {id!r}: triangles refer to vertices {used[0]} to {used[-1]}, "
            f"the mesh has 0 to {len(vertices) - 1}"
        )
    bad = used[~np.isfinite(vertices[used]).all(axis=1)]
    if len(bad):
        raise MeshError(
            f"shape {id!r}: {len(bad)} of {len(used)} vertices are not finite, "
            f"the first is number {bad[0]}: {vertices[bad[0]].tolist()}"
        )
    if up == "y":
        vertices = vertices[:, [0, 2, 1]] * (1, -1, 1)
    elif up == "x":
        vertices = vertices[:, [1, 2, 0]]
    vertices = vertices / (np.abs(vertices[used]).max() or 1.0)
    vertices = vertices - (vertices[used].min(axis=0) + vertices[used].max(axis=0)) / 2
    clean, repairs = clean_mesh(trimesh.Trimesh(vertices, faces, process=False))
    extents = clean.extents if len(clean.faces) else np.ptp(vertices[used], axis=0)
    flat = np.flatnonzero(extents <= _MIN_EXTENT * np.linalg.norm(extents))
    if len(flat):
        raise MeshError(
            f"shape {id!r}: the mesh has no extent along "
            f"{' and '.join('xyz'[axis] for axis in flat)}: a shape needs all three"
        )
    if len(clean.faces) == 0:
        raise MeshError(f"shape {id!r}: none of its {len(faces)} triangles has an area")
    vertices = clean.vertices - clean.bounds.mean(axis=0)
    vertices = vertices / np.linalg.norm(clean.extents)
    canonical = trimesh.Trimesh(vertices, clean.faces, process=False)
    closed = canonical.is_watertight and canonical.is_winding_consistent
    if closed and _signed_volume(canonical) < 0:
        canonical.invert()
    return canonical, repairs


def _signed_volume(mesh: trimesh.Trimesh) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):  # its centre of mass, where it is 0
        return float(mesh.volume)


@bounded_cache(
    "voxels",
    VOXELS_BUDGET,
    "bytes",
    size=lambda voxels: voxels.nbytes,
    key=lambda shape, scale: (shape.digest, scale),
)
def _upright_voxels(shape: Shape, scale: float) -> Voxels:
    vertices = np.asarray(shape.mesh.vertices) * np.cbrt(scale)
    return Voxels.of(vertices[shape.mesh.faces], Item(shape, scale).cells)


@bounded_cache(
    "turned voxels",
    VOXELS_BUDGET,
    "bytes",
    size=lambda voxels: voxels.nbytes,
    key=operator.attrgetter("key"),
)
def _turned_voxels(item: Item) -> Voxels:
    return _upright_voxels(item.shape, item.scale).turned(item.rotation)
