"""Types of items: a mesh, how many of it to place, and the rotations that it may take."""

from __future__ import annotations

import hashlib
import math
import operator
from copy import copy
from dataclasses import InitVar, dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from packit_sim.core.caches import cached_property
from packit_sim.core.checks import check_range
from packit_sim.core.errors import ArgumentError, MeshError, located
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.repair import clean_mesh, repair_mesh
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.mesh_files import read
from packit_sim.parts.packings import rotation_sets
from packit_sim.parts.packings.bounds import DISTANCES, LENGTHS, MAX_LENGTH
from packit_sim.parts.packings.turning import ANY_TURN, Turning


@dataclass(frozen=True, eq=False)
class ItemType:
    """A mesh, how many of it to place, and which rotations it may take.

    Parameters
    ----------
    name : str
        Its name, in messages and files.
    vertices : ndarray of float64, shape (n, 3)
        The vertices, in any frame, in the container's unit of length. Vertices that are equal or
        unused, and triangles that are equal or have no area, are dropped.
    faces : ndarray of int64, shape (m, 3)
        The triangles, as indices of vertices.
    demand : int
        How many of it to place, at least 1.
    rotations : str
        The rotations that it may take, from the mesh's own frame (see `rotation_sets`).
    value : float, optional
        Its value in a knapsack, at least 0; by default its volume.
    file : Path, optional
        The mesh file that holds the same mesh, in the same coordinates.
    known_volume : float, optional
        Its volume, if it is known better than from the mesh.
    repaired : bool
        Whether the mesh's winding is made consistent and its small holes are filled (see
        `repair_mesh`).
    clearance : float, optional
        The smallest distance to other items, if it is larger than that of the packing.
    turning : Turning
        Limits on its rotations.
    turns : ndarray of float64, shape (n, 3, 3), optional
        The rotations that a search tries; by default all of the set, or 24 of `free`.

    Attributes
    ----------
    volume : float
        The volume: as given, of the closed body, or else of the solid by voxels (see `Shape`).

    Raises
    ------
    MeshError
        If the mesh is empty, not finite, too large or small, or without extent along an axis.
    ArgumentError
        If the demand, the rotations, the value or the clearance are not possible, or no rotation
        keeps the limits.

    Examples
    --------
    >>> import trimesh
    >>> from packit_sim import ItemType
    >>> mesh = trimesh.creation.cylinder(radius=20, height=50)
    >>> can = ItemType("can", mesh.vertices, mesh.faces, demand=6, rotations="axis-4")
    >>> can.demand, round(can.volume)
    (6, 62429)
    >>> can.changed(demand=2).demand
    2
    """

    name: str
    vertices: Floats
    faces: Ints
    demand: int = 1
    rotations: str = "cube"
    value: float | None = None
    file: Path | None = None
    known_volume: InitVar[float | None] = None
    repaired: InitVar[bool] = False
    clearance: float | None = None
    turning: Turning = ANY_TURN
    turns: Floats | None = None
    volume: float = field(init=False)

    def __post_init__(self, known_volume: float | None, repaired: bool) -> None:
        self._check_settings()
        vertices, faces = _cleaned(self.vertices, self.faces, self.name, repaired)
        for name, array in (("vertices", vertices), ("faces", faces)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if known_volume is None:
            size = float(np.linalg.norm(self.extents))
            known_volume = self._canonical().volume * size**3
        object.__setattr__(self, "volume", known_volume)

    def _check_settings(self) -> None:
        try:
            demand = operator.index(self.demand)
        except TypeError:
            demand = 0
        if demand < 1:
            raise ArgumentError(
                f"item type {self.name!r}: a demand of {self.demand!r} is not possible: "
                "a whole number of at least 1"
            )
        if self.value is not None and not 0 <= self.value < math.inf:
            raise ArgumentError(
                f"item type {self.name!r}: a value of {self.value!r} is not possible: "
                "at least 0, finite"
            )
        if self.clearance is not None:
            check_range(f"item type {self.name!r}: a clearance of", self.clearance, DISTANCES)
        rotation_sets.check(self.rotations)
        with located(f"item type {self.name!r}", ArgumentError):
            self.turning.check(self.rotations)
        object.__setattr__(self, "demand", demand)

    @classmethod
    def from_file(
        cls,
        path: Path | str,
        demand: int = 1,
        rotations: str = "cube",
        value: float | None = None,
    ) -> ItemType:
        """Read and repair the mesh of a file, without a change of its up axis or unit.

        Parameters
        ----------
        path : Path or str
            The mesh file.
        demand : int
            How many of it to place.
        rotations : str
            The rotations that it may take.
        value : float, optional
            Its value in a knapsack.

        Returns
        -------
        ItemType
            Named after the file.

        Raises
        ------
        MeshError
            If the file can't be read, or its mesh can't be used.
        """
        path = Path(path)
        mesh = read(path).mesh
        given = path.name, mesh.vertices, mesh.faces, demand, rotations, value, path
        return cls(*given, repaired=True)

    @classmethod
    def from_item(
        cls, item: Item, demand: int = 1, rotations: str = "cube", value: float | None = None
    ) -> ItemType:
        """Take the mesh of a shape at its scale, in the item's rotation; lengths in box units.

        Parameters
        ----------
        demand : int
            How many of it to place.
        rotations : str
            The rotations that it may take, from the item's own.
        value : float, optional
            Its value in a knapsack.

        Returns
        -------
        ItemType
            Named after the shape, and of the item's volume.
        """
        mesh = item.mesh
        return cls(
            item.shape.id,
            mesh.vertices,
            mesh.faces,
            demand,
            rotations,
            value,
            known_volume=item.volume,
        )

    def changed(
        self,
        demand: int | None = None,
        rotations: str | None = None,
        value: float | None = None,
        clearance: float | None = None,
        turning: Turning | None = None,
        turns: Floats | None = None,
    ) -> ItemType:
        """Return a type of the same mesh, whose checks and measures are not repeated.

        Parameters
        ----------
        demand : int, optional
            Its demand; by default the same.
        rotations : str, optional
            Its rotations; by default the same.
        value : float, optional
            Its value; by default the same.
        clearance : float, optional
            Its clearance; by default the same.
        turning : Turning, optional
            The limits on its rotations; by default the same.
        turns : ndarray of float64, shape (n, 3, 3), optional
            The rotations that a search tries; by default the same.

        Returns
        -------
        ItemType
            The new type.

        Raises
        ------
        ArgumentError
            If a setting is not possible.
        """
        new = copy(self)
        settings: dict[str, object] = {"demand": demand, "rotations": rotations, "value": value}
        settings |= {"clearance": clearance, "turning": turning, "turns": turns}
        for name, setting in settings.items():
            if setting is not None:
                object.__setattr__(new, name, setting)
        new._check_settings()
        return new

    @cached_property
    def low(self) -> Floats:
        """The lower corner (3,) of the bounding box."""
        return np.asarray(self.vertices.min(axis=0))

    @cached_property
    def high(self) -> Floats:
        """The upper corner (3,) of the bounding box."""
        return np.asarray(self.vertices.max(axis=0))

    @property
    def middle(self) -> Floats:
        """The middle (3,) of the bounding box."""
        return np.asarray((self.low + self.high) / 2)

    @property
    def extents(self) -> Floats:
        """The extents (3,) of the bounding box."""
        return self.high - self.low

    @cached_property
    def shape(self) -> Shape:
        """The shape of the mesh, in its canonical frame."""
        size = float(np.linalg.norm(self.extents))
        shape = self._canonical()
        return Shape(shape.mesh, shape.id, shape.category, self.volume / size**3)

    def _canonical(self) -> Shape:
        """Return the shape of the mesh, with a volume of its own."""
        return Shape.from_mesh(trimesh.Trimesh(self.vertices, self.faces, process=False), self.name)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the mesh, in hex."""
        sha = hashlib.sha256(self.vertices.astype("<f8").tobytes())
        sha.update(self.faces.astype("<i8").tobytes())
        return sha.hexdigest()

    def __repr__(self) -> str:
        return (
            f"ItemType({self.name!r}, {len(self.faces)} triangles, "
            f"demand={self.demand}, rotations={self.rotations!r})"
        )


def _cleaned(vertices: Floats, faces: Ints, name: str, repaired: bool) -> tuple[Floats, Ints]:
    """Check a mesh, and drop what adds nothing to its surface; repair it if wanted."""
    try:
        vertices = np.array(vertices, dtype=float).reshape(-1, 3)
        faces = np.array(faces, dtype=np.int64).reshape(-1, 3)
    except (TypeError, ValueError) as error:
        raise MeshError(f"item type {name!r}: no triangle mesh: {error}") from None
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    Shape.from_mesh(mesh, name)  # refuses a mesh that is empty, not finite or flat
    numbers, faces = np.unique(faces, return_inverse=True)
    vertices = vertices[numbers]
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    size = float(np.abs(vertices - middle).max())
    if not (size in LENGTHS and np.abs(vertices).max() < MAX_LENGTH):
        raise MeshError(f"item type {name!r}: its lengths are not possible: {LENGTHS}")
    scaled = (vertices - middle) / size
    clean, _ = clean_mesh(trimesh.Trimesh(scaled, faces.reshape(-1, 3), process=False))
    if repaired:
        clean, _ = repair_mesh(clean)
    rows = np.concatenate([scaled, clean.vertices])
    _, first, same = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    kept = first[same.ravel()[len(scaled) :]]  # of equal rows, the first is one of the mesh's own
    return vertices[kept], np.array(clean.faces, dtype=np.int64)
