"""Packings of other tools, off any grid, checked by the meshes themselves."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from itertools import combinations
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated

import numpy as np
import trimesh
from msgspec import Meta, Struct

from packit_sim.core import typed_json
from packit_sim.core.caches import cached_property
from packit_sim.core.errors import MeshError, PackFormatError, located
from packit_sim.core.sums import plain_sum
from packit_sim.datasets.pack_checks import named
from packit_sim.datasets.pack_files import read_bytes
from packit_sim.datasets.verification import Problem, Report
from packit_sim.engine.collision import LooseMesh
from packit_sim.engine.containment_kernels import winding_number
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.parts import Parts, part_numbers
from packit_sim.geometry.repair import clean_mesh, repair_mesh
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.mesh_files import read

POSE_SLACK = 1e-6
"""Largest relative error of a pose's rotation and scale: rounding of single precision."""

MAX_LENGTH = 1e30
"""Largest length of boxes, meshes and poses, in any unit; its inverse is the smallest."""

MAX_SHRINKAGE = 1e-3
"""Largest tolerance of an item, relative to the longest side of its bounding box."""

SAMPLES = 9
"""Points of a part that vote on whether it is inside another shell."""

AXIS_WALLS = (("left", "right"), ("back", "front"), ("bottom", "top"))
"""The walls of a box by axis, the one at 0 first."""

Length = Annotated[float, Meta(gt=-MAX_LENGTH, lt=MAX_LENGTH)]
Extent = Annotated[float, Meta(gt=1 / MAX_LENGTH, lt=MAX_LENGTH)]
Row = tuple[Length, Length, Length, Length]


def verify_packing(file: Path | str) -> Report:
    """Check a packing of another tool, off any grid, by its meshes themselves.

    Parameters
    ----------
    file : Path or str
        The JSON file (see Notes).

    Returns
    -------
    Report
        The problems. They include meshes that can't be used, and poses that shear or mirror.

    Raises
    ------
    PackFormatError
        If the file is not of this form; the message names the file and the field.

    Notes
    -----
    The file is a JSON object, which may have other fields as well:

        {"box": [600, 400, 300], "unit": "mm",
         "items": [{"mesh": "parts/mug.stl",
                    "pose": [[1, 0, 0, 50], [0, 1, 0, 50], [0, 0, 1, 60], [0, 0, 0, 1]]}]}

    - `box`: its extents, from (0, 0, 0).
    - `unit`: the name of the unit of length; it has no influence.
    - `mesh`: a file of one of `mesh_files.SUFFIXES`, by its path from the packing's folder, with
      "/" between folders, and inside that folder.
    - `pose`: (4, 4) by rows, a rotation, one scale for all axes and a translation. It maps the
      coordinates in the mesh's file to those of the box, regardless of the file's up axis and unit.

    The mesh of an item must be inside the box, must not cross that of another item, and must have
    no part inside a shell of another item, not even in a cavity. A shell is a part that is closed,
    after filling the holes that the importer would fill (`repair_mesh`): the inside of an open part
    is unknown. The tolerance of an item is the contact tolerance, with the box's longest extent as
    the unit, and at most `MAX_SHRINKAGE` of its own longest side; that of a pair is the smaller
    one. Meshes shrink by it as on the grid, along their file's axes. The volume is that of the
    closed body, or of the solid by voxels (see `Shape`).
    """
    file = Path(file)
    extents, items = _packing(file)
    unit = float(extents.max())
    loaded = cache(_loaded)
    problems: list[str] = []
    bodies: list[_MeshInBox] = []
    for n, (mesh, pose) in enumerate(items):
        what = named(n, mesh)
        fault = _pose_fault(pose)
        if fault:
            problems.append(f"{what}: its pose {fault}")
            continue
        try:
            body = _MeshInBox(what, loaded(file.parent / mesh), pose, unit)
        except MeshError as error:
            problems.append(f"{what} has no mesh: {error}")
            continue
        bodies.append(body)
        problems += _wall_problems(body, extents, unit)
    for one, other in combinations(bodies, 2):
        if (np.maximum(one.low, other.low) < np.minimum(one.high, other.high)).all():
            problems += _pair_problems(one, other)
    cube = unit * unit * unit
    volume = plain_sum(body.volume for body in bodies) * cube
    found = tuple(Problem(file, None, sentence) for sentence in problems)
    return Report(found, 1, 1, len(items), volume, float((extents / unit).prod()) * cube)


class _Loaded:
    """The mesh of a file, in the file's coordinates and unit.

    vertices: (n, 3). volume: in the unit cubed. middle, extents: (3,) of the bounding box. part:
    (m,) the number of each triangle's connected part.
    """

    def __init__(self, mesh: trimesh.Trimesh, name: str) -> None:
        Shape.from_mesh(mesh, name)  # refuses a mesh that is empty, not finite or flat
        vertices = np.asarray(mesh.vertices, dtype=float)
        faces = np.asarray(mesh.faces, dtype=np.int64)
        used = vertices[np.unique(faces)]
        middle = (used.min(axis=0) + used.max(axis=0)) / 2
        size = float(np.abs(used - middle).max())
        if not (size > 1 / MAX_LENGTH and np.abs(used).max() < MAX_LENGTH):
            raise MeshError(f"{name}: its lengths must be from {1 / MAX_LENGTH} to {MAX_LENGTH}")
        clean, _ = clean_mesh(trimesh.Trimesh((vertices - middle) / size, faces, process=False))
        solid = Shape.from_mesh(clean, name)
        self.vertices: Floats = np.asarray(clean.vertices) * size + middle
        self.faces: Ints = np.asarray(clean.faces, dtype=np.int64)
        self.extents: Floats = np.asarray(clean.extents) * size
        self.middle: Floats = clean.bounds.mean(axis=0) * size + middle
        self.volume = solid.volume * float(np.linalg.norm(self.extents)) ** 3
        self.part = part_numbers(self.faces, len(self.vertices))
        self._clean = clean
        self._frame = size, middle

    @cached_property
    def shells(self) -> tuple[Floats, list[Ints]]:
        """The vertices (n, 3), and the faces of each closed part."""
        whole, _ = repair_mesh(self._clean)
        size, middle = self._frame
        vertices = np.asarray(whole.vertices)
        return vertices * size + middle, Parts.of(vertices, np.asarray(whole.faces)).shells


def _loaded(path: Path) -> _Loaded:
    return _Loaded(read(path).mesh, path.name)


class _MeshInBox:
    """A mesh in its pose; the unit is the box's longest extent.

    low, high: (3,) the bounds. volume: of the solid. tolerance: how far it may reach beyond a wall.
    """

    def __init__(self, what: str, loaded: _Loaded, pose: Floats, unit: float) -> None:
        self.what = what
        self._loaded = loaded
        self._linear, self._shift = pose[:3, :3] / unit, pose[:3, 3] / unit
        scale = float(np.linalg.norm(self._linear)) / math.sqrt(3)
        self.volume = loaded.volume * scale**3
        self._extents = loaded.extents * scale
        self.tolerance = min(CONTACT_TOLERANCE, MAX_SHRINKAGE * float(self._extents.max()))
        self._shrunk: dict[float, _ShrunkMesh] = {}
        there = loaded.vertices @ self._linear.T + self._shift
        self.low, self.high = there.min(axis=0), there.max(axis=0)

    def shrunk(self, tolerance: float) -> _ShrunkMesh:
        """Return the mesh shrunk by a tolerance: its own, or a smaller one."""
        if tolerance not in self._shrunk:
            middle = self._loaded.middle
            factors = np.maximum(self._extents - tolerance, 0) / self._extents
            unit = tolerance / CONTACT_TOLERANCE

            def put(vertices: Floats) -> Floats:
                drawn_in = (vertices - middle) * factors + middle
                return (drawn_in @ self._linear.T + self._shift) / unit

            self._shrunk[tolerance] = _ShrunkMesh(self.what, self._loaded, put)
        return self._shrunk[tolerance]


class _ShrunkMesh:
    """A mesh that is shrunk by a tolerance, in a unit in which that is the contact tolerance."""

    def __init__(self, what: str, loaded: _Loaded, put: Callable[[Floats], Floats]) -> None:
        self.what = what
        self._loaded = loaded
        self._put = put

    @cached_property
    def surface(self) -> LooseMesh:
        return LooseMesh(self._put(self._loaded.vertices), self._loaded.faces)

    @cached_property
    def parts(self) -> list[Floats]:
        """The corners (m, 3, 3) of each connected part's triangles."""
        corners = self._put(self._loaded.vertices)[self._loaded.faces]
        order = np.argsort(self._loaded.part, kind="stable")
        starts = np.flatnonzero(np.diff(self._loaded.part[order])) + 1
        return np.split(corners[order], starts)

    @cached_property
    def shells(self) -> list[Floats]:
        """The corners (m, 3, 3) of each shell's triangles."""
        vertices, shells = self._loaded.shells
        corners = self._put(vertices)
        return [corners[faces] for faces in shells]

    def holds(self, other: _ShrunkMesh) -> bool:
        """Whether a part of another body is in a shell; their surfaces must not cross."""
        for shell in self.shells:
            low, high = shell.min(axis=(0, 1)), shell.max(axis=(0, 1))
            for part in other.parts:
                if (part < low).any() or (part > high).any():
                    continue
                centres = part.mean(axis=1)
                some = np.linspace(0, len(centres) - 1, min(SAMPLES, len(centres))).astype(int)
                if np.median([abs(winding_number(shell, p)) for p in centres[some]]) > 0.5:
                    return True
        return False


def _wall_problems(body: _MeshInBox, extents: Floats, unit: float) -> Iterator[str]:
    beyond = np.column_stack([-body.low, body.high - extents / unit])
    for walls, depths in zip(AXIS_WALLS, beyond.tolist(), strict=True):
        for wall, depth in zip(walls, depths, strict=True):
            if not depth <= body.tolerance:
                yield f"{body.what} reaches {depth * unit:.3g} beyond the box's {wall} wall"


def _pair_problems(first: _MeshInBox, second: _MeshInBox) -> Iterator[str]:
    tolerance = min(first.tolerance, second.tolerance)
    one, other = first.shrunk(tolerance), second.shrunk(tolerance)
    if one.surface.crosses(other.surface):
        yield f"{other.what} crosses {one.what}"
        return
    for inside, around in ((other, one), (one, other)):
        if around.holds(inside):
            yield f"{inside.what} lies, in part or whole, inside {around.what}"


class _PackingItem(Struct):
    mesh: str
    pose: tuple[Row, Row, Row, Row]


class _Packing(Struct):
    """The content of a packing's file; other fields are ignored."""

    box: tuple[Extent, Extent, Extent]
    items: Annotated[tuple[_PackingItem, ...], Meta(min_length=1)]
    unit: str = ""


def _packing(file: Path) -> tuple[Floats, list[tuple[str, Floats]]]:
    """Read the box's extents (3,), and the mesh's path and the pose (4, 4) of each item."""
    data = read_bytes(file)
    with located(file, PackFormatError):
        packing = typed_json.decode(data, _Packing, PackFormatError, "a packing")
        for n, item in enumerate(packing.items):
            if not _is_inside(item.mesh):
                raise PackFormatError(
                    f"field 'items[{n}].mesh' is {item.mesh!r}: "
                    "it must be a path inside the packing's folder"
                )
    return np.array(packing.box), [(item.mesh, np.array(item.pose)) for item in packing.items]


def _is_inside(path: str) -> bool:
    parts = PurePosixPath(path).parts
    outside = path.startswith("/") or PureWindowsPath(path).anchor or "\0" in path
    return bool(parts) and not outside and ".." not in parts


def _pose_fault(pose: Floats) -> str | None:
    """Return why a finite (4, 4) matrix is not a rotation with one scale and a translation."""
    if pose[3].tolist() != [0, 0, 0, 1]:
        return f"has the last row {pose[3].tolist()}: it must be 0, 0, 0, 1"
    linear = pose[:3, :3]
    largest = np.abs(linear).max()
    if largest < 1 / MAX_LENGTH:
        return "leaves nothing of the mesh: its scale is 0"
    linear = linear / largest
    square = linear.T @ linear
    scale = np.trace(square) / 3
    if np.abs(square / scale - np.eye(3)).max() > POSE_SLACK:
        return "shears the mesh, or scales its axes unlike"
    if np.linalg.det(linear) < 0:
        return "mirrors the mesh"
    return None
