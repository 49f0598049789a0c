"""Shapes, and items: shapes at a scale in one of the 24 rotations.

A `Shape` is a mesh in its canonical frame. Both are immutable; derived values are computed once.
"""

from __future__ import annotations

import hashlib
import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.core.caches import bounded_cache, cached_property
from packit_sim.core.choices import Axis
from packit_sim.core.errors import ArgumentError, MeshError
from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Ints
from packit_sim.geometry.lattice import Triple, cell_box
from packit_sim.geometry.parts import Parts
from packit_sim.geometry.repair import Repairs, clean_mesh, repair_mesh
from packit_sim.geometry.triangle_trees import tree_order
from packit_sim.geometry.voxelization import solid_volume_bounds
from packit_sim.geometry.voxels import Voxels

VOXELS_BUDGET = 128 * 2**20
"""Maximum size of all cached voxels of shapes in their canonical rotation, in bytes."""

TURNED_VOXELS_BUDGET = 256 * 2**20
"""The same for items in any rotation; evolution turns each shape of its pool many times."""

UP_AXES: tuple[Axis, ...] = get_args(Axis)
"""The axes that may point up in a mesh file."""

ORIENTATIONS_BUDGET = 1024
"""Shapes at a scale whose rotated items are cached, at most 25 kB each."""

_MIN_EXTENT = 1e-9
"""Extents below this, relative to the bounding box's diagonal, are rounding errors."""


class Shape:
    """A mesh in its canonical frame: centred on its bounding box, diagonal 1, z up.

    Use `from_mesh` to create the shape of any mesh.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        The mesh, already in its canonical frame.
    id : str
        Name, unique in a library.
    category : str
        Name of the shape's category.
    volume : float | None
        Volume in canonical units, if known.

    Examples
    --------
    >>> import trimesh
    >>> from packit_sim import Shape
    >>> shape = Shape.from_mesh(trimesh.creation.box((40, 30, 20)), "brick", category="toy")
    >>> shape
    Shape('brick', 'toy', 12 triangles)
    >>> shape.extents.round(3).tolist()  # the diagonal is 1
    [0.743, 0.557, 0.371]
    >>> shape.is_solid, round(shape.volume, 3)
    (True, 0.154)
    """

    def __init__(
        self, mesh: trimesh.Trimesh, id: str, category: str, volume: float | None = None
    ) -> None:
        self.mesh = mesh
        self.id = id
        self.category = category
        if volume is not None:
            self.volume = volume

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle, without parts and values that trimesh derived.

        To find them again is cheaper than to send them.
        """
        state = {name: value for name, value in self.__dict__.items() if name != "parts"}
        return state | {"mesh": trimesh.Trimesh(self.mesh.vertices, self.mesh.faces, process=False)}

    @classmethod
    def from_mesh(cls, mesh: trimesh.Trimesh, id: str, category: str = "", up: str = "z") -> Shape:
        """Create the shape of a triangle mesh.

        Duplicate vertices are merged, and triangles without area dropped.

        Parameters
        ----------
        mesh : trimesh.Trimesh
            The mesh, in any frame and unit.
        id : str
            Name, unique in a library.
        category : str
            Name of the shape's category.
        up : str
            The mesh's up axis: "x", "y" or "z".

        Returns
        -------
        Shape
            The mesh in its canonical frame.

        Raises
        ------
        MeshError
            If the mesh is empty, not finite, or has no extent along an axis.
        """
        return cls(_canonical(mesh, id, up)[0], id, category)

    @classmethod
    def repaired(
        cls, mesh: trimesh.Trimesh, id: str, category: str = "", up: str = "z"
    ) -> tuple[Shape, Repairs]:
        """Create the shape of a mesh after repairing its winding and small holes.

        Parameters
        ----------
        mesh : trimesh.Trimesh
            The mesh, in any frame and unit.
        id : str
            Name, unique in a library.
        category : str
            Name of the shape's category.
        up : str
            The mesh's up axis: "x", "y" or "z".

        Returns
        -------
        shape : Shape
            The shape of the repaired mesh.
        repairs : Repairs
            Counts of the repairs (see `repair.repair_mesh`).
        """
        clean, cleaning = _canonical(mesh, id, up)
        whole, fixed = repair_mesh(clean)
        shape = cls(_outward(whole), id, category)
        return shape, replace(
            cleaning,
            flipped_triangles=fixed.flipped_triangles,
            filled_holes=fixed.filled_holes,
        )

    @cached_property
    def extents(self) -> npt.NDArray[np.float64]:
        """Extents (3,) of the bounding box, in canonical units."""
        return np.array(self.mesh.extents)

    @cached_property
    def is_solid(self) -> bool:
        """True if the mesh is one closed body with consistent winding: its volume is exact."""
        mesh = self.mesh
        return bool(
            mesh.is_watertight
            and mesh.is_winding_consistent
            and mesh.body_count == 1
            and _signed_volume(mesh) > 0
        )

    @cached_property
    def volume(self) -> float:
        """Volume in canonical units, exact if `is_solid`, else measured by voxels."""
        if self.is_solid:
            return _signed_volume(self.mesh)
        return sum(self.volume_bounds) / 2

    @cached_property
    def volume_bounds(self) -> tuple[float, float]:
        """Bounds of the volume in canonical units by voxels (see `solid_volume_bounds`)."""
        return solid_volume_bounds(np.asarray(self.mesh.triangles))

    @cached_property
    def is_shell(self) -> bool:
        """True if the mesh is open and encloses next to nothing: its volume is that of a sheet.

        Voxels that only touch the surface are then more than those inside. Cracks narrower than a
        voxel, 1/256 of the longest side, don't open a surface.
        """
        if self.mesh.is_watertight:
            return False
        enclosed, filled = self.volume_bounds
        return enclosed < filled - enclosed

    @cached_property
    def fill(self) -> float:
        """Volume relative to that of the bounding box."""
        return self.volume / float(self.extents.prod())

    @cached_property
    def parts(self) -> Parts:
        """The connected parts of the surface, and which of them are closed."""
        return Parts.of(np.asarray(self.mesh.vertices), np.asarray(self.mesh.faces))

    @cached_property
    def order(self) -> Ints:
        """The order (n,) of the triangles in a tree (see `triangle_trees`)."""
        return tree_order(np.asarray(self.mesh.triangles))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the geometry, in hex."""
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
    """A shape at a scale in one of the 24 rotations.

    Parameters
    ----------
    scale : float
        Ratio of the item's volume to the canonical shape's, more than 0.
    rotation : int
        Index of the rotation, 0 to 23 (see `rotations`).

    Raises
    ------
    ArgumentError
        If the scale or the rotation is out of range.

    Examples
    --------
    >>> import trimesh
    >>> from packit_sim import Item, Shape
    >>> item = Item(Shape.from_mesh(trimesh.creation.box((3, 2, 1)), "brick"), scale=0.25)
    >>> item.extents.round(3).tolist()
    [0.505, 0.337, 0.168]
    >>> item.cells
    (51, 34, 17)
    >>> item.turned(8).cells
    (17, 34, 51)
    >>> item.by_alignment[0].cells  # the lowest, then the narrowest along x
    (34, 51, 17)
    """

    shape: Shape
    scale: float = 1.0
    rotation: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale > 0):
            raise ArgumentError(f"scale {self.scale!r} is not possible: it must be more than 0")
        object.__setattr__(self, "scale", float(self.scale))
        object.__setattr__(self, "rotation", _checked_rotation(self.rotation))

    @classmethod
    def of_size(cls, shape: Shape, size: float | Sequence[float], unit: float = 1.0) -> Item:
        """Create an item from its size instead of its scale.

        Parameters
        ----------
        size : float or sequence of float
            The longest extent, or the extents along x, y and z of the canonical shape.
        unit : float
            The length of a box unit in the unit of `size`: by default, sizes are in box units.

        Returns
        -------
        Item
            The item, in the canonical rotation.

        Raises
        ------
        ArgumentError
            If a length is not possible, or the extents are not those of the shape, by more than 1%
            of the longest, at any scale.

        Examples
        --------
        >>> import trimesh
        >>> from packit_sim import Item, Shape
        >>> brick = Shape.from_mesh(trimesh.creation.box((3, 2, 1)), "brick")
        >>> Item.of_size(brick, 0.6).extents.round(3).tolist()
        [0.6, 0.4, 0.2]
        >>> in_a_box_of_50_cm = Item.of_size(brick, (24, 16, 8), unit=50)
        >>> in_a_box_of_50_cm.extents.round(3).tolist()
        [0.48, 0.32, 0.16]
        """
        lengths = np.array(size, dtype=np.float64)
        for name, value in (("size", lengths), ("unit", np.float64(unit))):
            if not (np.isfinite(value).all() and (value > 0).all()):
                raise ArgumentError(
                    f"{name} {value.tolist()!r:.80} is not possible: more than 0, and finite"
                )
        if lengths.ndim == 0:
            return cls(shape, float((lengths / unit / shape.extents.max()) ** 3))
        diagonal = math.hypot(*lengths.ravel())
        if lengths.shape != (3,) or (
            np.abs(lengths / diagonal - shape.extents).max() > 0.01 * shape.extents.max()
        ):
            like = " x ".join(f"{length:.3g}" for length in shape.extents * diagonal)
            raise ArgumentError(
                f"size {lengths.tolist()!r:.80} is not that of {shape.id!r}: its extents are as "
                f"{like}"
            )
        return cls(shape, (diagonal / unit) ** 3)

    def turned(self, rotation: int) -> Item:
        """Return the same shape and scale in another rotation of the canonical shape."""
        return _orientations(self).item(rotation)

    @property
    def by_alignment(self) -> tuple[Item, ...]:
        """The item in all 24 rotations, in the order of alignment (`rotations.by_alignment`)."""
        return _orientations(self).by_alignment

    @cached_property
    def key(self) -> tuple[str, float, int]:
        """Digest of the shape, scale and rotation: equal for equal items."""
        return self.shape.digest, self.scale, self.rotation

    @cached_property
    def volume(self) -> float:
        """Volume in cubic box units."""
        return self.scale * self.shape.volume

    @cached_property
    def extents(self) -> npt.NDArray[np.float64]:
        """Extents (3,) of the bounding box, in box units."""
        return rotations.turn_extents(self.shape.extents, self.rotation) * np.cbrt(self.scale)

    @cached_property
    def cells(self) -> Triple:
        """Cells along each axis of the cell box, which is centred on the item."""
        return cell_box(self.extents)

    @cached_property
    def linear(self) -> npt.NDArray[np.float64]:
        """Matrix (3, 3) that turns and scales the canonical shape."""
        return rotations.MATRICES[self.rotation] * np.cbrt(self.scale)

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """Mesh of the shape, scaled and rotated, centred on the origin, in box units."""
        vertices = rotations.turn_vectors(self.shape.mesh.vertices, self.rotation)
        return trimesh.Trimesh(vertices * np.cbrt(self.scale), self.shape.mesh.faces, process=False)

    @property
    def voxels(self) -> Voxels:
        """The outer and inner fine cells, computed once for each shape and scale, then turned."""
        return _turned_voxels(self)

    @property
    def outer(self) -> npt.NDArray[np.bool_]:
        """Bool over `cells`: cells that the surface touches, or with an enclosed fine cell."""
        return self.voxels.outer_cells

    @property
    def inner(self) -> npt.NDArray[np.bool_]:
        """Bool over `cells`: cells that are enclosed and that the surface does not touch."""
        return self.voxels.inner_cells


class _Orientations:
    """The items of a shape at a scale in all rotations, so that each is created once."""

    def __init__(self, item: Item) -> None:
        self._shape, self._scale = item.shape, item.scale
        self._items: dict[int, Item] = {}

    def item(self, rotation: int) -> Item:
        number = _checked_rotation(rotation)
        found = self._items.get(number)
        if found is None:
            found = self._items[number] = Item(self._shape, self._scale, number)
        return found

    @cached_property
    def by_alignment(self) -> tuple[Item, ...]:
        return tuple(map(self.item, rotations.by_alignment(self.item(0).extents)))


def _checked_rotation(rotation: int) -> int:
    try:
        number = operator.index(rotation)
    except TypeError:
        number = -1
    if not 0 <= number < rotations.COUNT:
        raise ArgumentError(f"rotation {rotation!r} is not one of 0 to {rotations.COUNT - 1}")
    return number


def _canonical(mesh: trimesh.Trimesh, id: str, up: str) -> tuple[trimesh.Trimesh, Repairs]:
    """Return a mesh cleaned and in its canonical frame, and what was cleaned."""
    if up not in UP_AXES:
        raise ArgumentError(f"up axis {up!r} is not known: choose from {', '.join(UP_AXES)}")
    if not isinstance(mesh, trimesh.Trimesh):
        raise MeshError(f"shape {id!r}: expected a trimesh.Trimesh, not {type(mesh).__name__}")
    vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if len(faces) == 0:
        raise MeshError(
            f"shape {id!r}: the mesh is empty: {len(vertices)} vertices, {len(faces)} triangles"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(
            f"shape {id!r}: triangles refer to vertices {faces.min()} to {faces.max()}, "
            f"the mesh has 0 to {len(vertices) - 1}"
        )
    used = np.flatnonzero(np.bincount(faces.ravel()))
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
    largest = np.abs(vertices[used]).max()
    vertices = vertices / (largest or 1.0)
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
        raise MeshError(
            f"shape {id!r}: none of its {len(faces)} triangles has an area next to its largest "
            f"coordinate, {largest:.3g}"
        )
    vertices = clean.vertices - clean.bounds.mean(axis=0)
    vertices = vertices / np.linalg.norm(clean.extents)
    return _outward(trimesh.Trimesh(vertices, clean.faces, process=False)), repairs


def _outward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Invert a closed mesh that faces inwards, in place."""
    if mesh.is_watertight and mesh.is_winding_consistent and _signed_volume(mesh) < 0:
        mesh.invert()
    return mesh


def _signed_volume(mesh: trimesh.Trimesh) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):  # the centre of mass, if it is 0
        return float(mesh.volume)


@bounded_cache(
    "rotated items",
    ORIENTATIONS_BUDGET,
    "items",
    size=lambda orientations: 1,
    key=lambda item: (id(item.shape), item.scale),  # the value keeps the shape alive
)
def _orientations(item: Item) -> _Orientations:
    return _Orientations(item)


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
    TURNED_VOXELS_BUDGET,
    "bytes",
    size=lambda voxels: voxels.nbytes,
    key=operator.attrgetter("key"),
)
def _turned_voxels(item: Item) -> Voxels:
    return _upright_voxels(item.shape, item.scale).turned(item.rotation)
