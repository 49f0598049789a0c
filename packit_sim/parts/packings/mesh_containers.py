"""Closed meshes as containers, such as the trunk of a car."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from packit_sim.core.caches import cached_property
from packit_sim.core.errors import ArgumentError, located
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.parts import by_part, part_numbers
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.checked_meshes import CheckedMesh
from packit_sim.parts.packings.complements import CROSSES, complement
from packit_sim.parts.packings.containers import Measured, fixed_in_place, in_bounding_box
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.rotation_sets import FIXED
from packit_sim.placement import winding_number


@dataclass(frozen=True)
class MeshContainer:
    """The space inside a closed mesh, from the lower corner of its bounding box on.

    Parameters
    ----------
    mesh : ItemType
        The mesh, in any frame. It may have several parts: walls inside the container are closed
        surfaces that face the other way.
    obstacles : tuple of ItemType
        What is in it already and stays there: meshes in the container's coordinates, whose origin
        is the lower corner of the mesh's bounding box.
    name : str
        Its name, in tables and files.

    Raises
    ------
    ArgumentError
        If the mesh is not closed, or an obstacle is no `ItemType`.

    Notes
    -----
    An item is inside if its surface, drawn in by its tolerance, does not cross the mesh, if the
    mesh winds around each part of the item, and if no part of the mesh is inside the item.

    Examples
    --------
    >>> import trimesh
    >>> from packit_sim import ItemType, MeshContainer
    >>> mesh = trimesh.creation.icosphere(radius=100)
    >>> ball = MeshContainer(ItemType("ball", mesh.vertices, mesh.faces))
    >>> ball.size, round(ball.volume)
    ((200.0, 200.0, 200.0), 4152741)
    """

    mesh: ItemType
    obstacles: tuple[ItemType, ...] = ()
    name: str = "container"
    volume: float = field(init=False)

    def __post_init__(self) -> None:
        mesh = self.mesh
        surface = trimesh.Trimesh(mesh.vertices - mesh.low, mesh.faces, process=False)
        edges = np.unique(surface.edges_sorted, axis=0, return_counts=True)[1]
        if (wrong := int((edges != 2).sum())) or not surface.is_winding_consistent:
            why = f"{wrong} of its edges belong to one triangle, or to more than two"
            why = why if wrong else "its triangles do not all face outwards"
            raise ArgumentError(f"container {mesh.name!r} is not closed: {why}")
        if surface.volume < 0:
            turned = ItemType(mesh.name, mesh.vertices, mesh.faces[:, ::-1])
            object.__setattr__(self, "mesh", turned)
        object.__setattr__(self, "volume", abs(float(surface.volume)))
        self._check_solid()
        object.__setattr__(self, "obstacles", fixed_in_place(self.obstacles))

    def _check_solid(self) -> None:
        """Raise ArgumentError if parts of the surface overlap, by voxels, which fill cavities."""
        mesh = self.mesh
        scale = float(np.linalg.norm(mesh.extents)) ** 3
        low, high = (bound * scale for bound in mesh.shape.volume_bounds)
        numbers = part_numbers(mesh.faces, len(mesh.vertices))
        a, b, c = (mesh.vertices - mesh.middle)[mesh.faces].transpose(1, 0, 2)
        each = np.bincount(numbers, np.einsum("nd,nd->n", a, np.cross(b, c)) / 6)
        if not low <= each[each > 0].sum() <= high:
            raise ArgumentError(f"container {mesh.name!r}: {CROSSES}")

    @classmethod
    def from_file(cls, path: Path | str, name: str = "container") -> MeshContainer:
        """Read the mesh of a file, without a change of its up axis or unit.

        Parameters
        ----------
        path : Path or str
            The mesh file.
        name : str
            The container's name.

        Returns
        -------
        MeshContainer
            The container.

        Raises
        ------
        MeshError
            If the file can't be read, or its mesh can't be used.
        ArgumentError
            If the mesh is not closed.
        """
        return cls(ItemType.from_file(path), name=name)

    @property
    def size(self) -> tuple[float, float, float]:
        """The sides of its bounding box."""
        x, y, z = self.mesh.extents.tolist()
        return x, y, z

    @property
    def is_strip(self) -> bool:
        """False: it is closed."""
        return False

    @property
    def longest(self) -> float:
        """The longest side of its bounding box."""
        return max(self.size)

    @property
    def container_from_mesh(self) -> Motion:
        """The translation from the mesh's coordinates to the container's."""
        return Motion.shift(-self.mesh.low)

    def faults(
        self,
        item: CheckedItem,
        clearance: float | WallClearance = 0.0,
        slack: float | None = None,
    ) -> Iterator[str]:
        """Yield what is wrong with the place of an item, by its mesh and the container's."""
        clearance = WallClearance.of(clearance).largest
        wall = "the container's wall"
        depth = float(np.maximum(-item.low, item.high - self.size).max())
        if not depth <= item.tolerance:
            yield f"reaches {item.length(depth)} beyond {wall}"
            return
        drawn_in = 2 * item.tolerance  # by its tolerance at each side
        unit = drawn_in / CONTACT_TOLERANCE
        mesh = CheckedMesh(item.item_type, item.scale, unit, drawn_in)
        own_mesh = CheckedMesh(self.mesh, 1.0, unit, 0.0)
        place = Placement(0, self.container_from_mesh)
        own = CheckedItem(self.name, self.mesh, place, self.longest)
        turn, shift = item.seen_from(own, unit)
        if own_mesh.crosses(mesh, turn, shift):
            yield f"crosses {wall}"
        elif not self._is_around(mesh.vertices @ turn.T + shift, mesh.mesh.sampled_faces, unit):
            yield f"lies, in part or whole, beyond {wall}"
        elif self._has_part_in(item) and mesh.holds(own_mesh, *own.seen_from(item, unit)):
            yield f"is around a part of {wall}"
        elif clearance > 0:
            distance = own_mesh.distance(mesh, turn, shift)
            if not distance >= clearance - (item.tolerance if slack is None else slack):
                yield (
                    f"is {item.length(max(distance, 0.0))} from {wall}: "
                    f"less than the clearance of {item.length(clearance)}"
                )

    def _is_around(self, vertices: Floats, parts: Ints, unit: float) -> bool:
        """Return whether the mesh winds once around most of some triangles of each part."""
        for faces in parts:
            points = vertices[faces].mean(axis=1) * unit
            winds = np.array([winding_number(self._triangles, point) for point in points])
            if np.mean(winds == 1) < 0.5:
                return False
        return True

    def _has_part_in(self, item: CheckedItem) -> bool:
        """Return whether a connected part of the surface is in an item's bounding box."""
        low, high = self._parts
        return bool(((item.low <= low) & (high <= item.high)).all(axis=1).any())

    @cached_property
    def _parts(self) -> tuple[Floats, Floats]:
        """The corners (p, 3) of the bounding boxes of the surface's connected parts."""
        numbers = part_numbers(self.mesh.faces, len(self.mesh.vertices))
        corners = (self.mesh.vertices - self.mesh.low)[self.mesh.faces]
        own = [each.reshape(-1, 3) for each in by_part(corners, numbers)]
        return np.array([c.min(axis=0) for c in own]), np.array([c.max(axis=0) for c in own])

    @cached_property
    def _triangles(self) -> Floats:
        """The corners (m, 3, 3) of its triangles, from the middle of its bounding box."""
        return (self.mesh.vertices - self.mesh.middle)[self.mesh.faces]

    def walls(self, margin: float | WallClearance = 0.0, gap: float = 0.0) -> tuple[ItemType, ...]:
        """Return the bodies around it; see `complement`.

        Parameters
        ----------
        margin : float or WallClearance
            The smallest distance from the walls, of which the largest counts.
        gap : float
            The distance that the search keeps from the bodies.

        Returns
        -------
        tuple of ItemType
            The bodies; none for a mesh that fills its bounding box.

        Raises
        ------
        ArgumentError
            If the mesh crosses itself.
        MissingPackageError
            If manifold3d is not installed.
        """
        vertices = self.mesh.vertices - self.mesh.low
        with located(f"container {self.mesh.name!r}", ArgumentError):
            more = max(0.0, WallClearance.of(margin).largest - gap)
            bodies = complement(vertices, self.mesh.faces, more)
        return tuple(
            ItemType(f"wall {n}", *body, rotations=FIXED) for n, body in enumerate(bodies, start=1)
        )

    def with_obstacles(self, obstacles: Sequence[ItemType]) -> MeshContainer:
        """Return the same container, whose checks are not repeated, with these obstacles."""
        new = copy(self)
        object.__setattr__(new, "obstacles", fixed_in_place(obstacles))
        return new

    def has_space(self, part: Measured, margin: float | WallClearance, factor: float = 1.0) -> bool:
        """Return whether a part fits into its bounding box in one of its rotations."""
        return in_bounding_box(self.size, part, margin, factor)
