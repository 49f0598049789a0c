"""Packings that other tools made, off any grid, checked by the meshes themselves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from itertools import combinations
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated

import numpy as np
import numpy.typing as npt
import trimesh
from msgspec import Meta, Struct
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from packit_sim.core import typed_json
from packit_sim.core.caches import cached_property
from packit_sim.core.errors import MeshError, PackFormatError
from packit_sim.datasets.pack_checks import named
from packit_sim.datasets.verification import Problem, Report
from packit_sim.engine.collision import LooseMesh
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.repair import clean_mesh, repair_mesh
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.mesh_files import read

POSE_SLACK = 1e-6
"""How far a pose may be from a turn and one scale, relatively: what single precision leaves."""

MAX_LENGTH = 1e30
"""Of boxes, meshes and poses of other tools, in any unit; none may be below its inverse."""

SAMPLES = 9
"""Points of a part that vote on whether another shell holds it."""

WALLS = (("left", "right"), ("back", "front"), ("bottom", "top"))
"""The walls of a box by axis, that at 0 first."""

Length = Annotated[float, Meta(gt=-MAX_LENGTH, lt=MAX_LENGTH)]
Extent = Annotated[float, Meta(gt=1 / MAX_LENGTH, lt=MAX_LENGTH)]
Row = tuple[Length, Length, Length, Length]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


def verify_packing(file: Path | str) -> Report:
    """Checks a packing that another tool made, off any grid, by its meshes themselves.

    The file is a JSON object; fields that are not named here are the tool's own:

        {"box": [600, 400, 300], "unit": "mm",
         "items": [{"mesh": "parts/mug.stl",
                    "pose": [[1, 0, 0, 50], [0, 1, 0, 50], [0, 0, 1, 60], [0, 0, 0, 1]]}]}

    box: its extents, from (0, 0, 0). unit: the name of the unit of length, which nothing depends
    on. mesh: a file of one of `mesh_files.SUFFIXES`, by its path from the packing's folder, with
    "/" between folders, and inside that folder. pose: (4, 4) by rows, takes the coordinates in the
    mesh's file as they are, with no axis turned up and no unit converted, to those of the box; a
    turn, one scale for all axes and a shift.

    An item holds where its mesh is inside the box, crosses no other's, and has no part that lies in
    a shell of another, be it in a cavity. A shell is a part that is closed, once holes that the
    importer would fill are (`repair.repair_mesh`): what an open one holds is unknown. Tolerance is
    the contact tolerance, with the box's longest extent as the unit; in that measure meshes are
    drawn in as on the grid, along their file's axes. The volume is the closed body's, or the
    solid's by voxels (see `Shape`).

    Raises PackFormatError that names the file and the field where it is not of this form; a mesh
    that can't be used, and a pose that shears or mirrors, is a problem in the report.
    """
    file = Path(file)
    extents, items = _packing(file)
    unit = float(extents.max())
    loaded = cache(_loaded)
    problems: list[str] = []
    bodies: list[_Body] = []
    for n, (mesh, pose) in enumerate(items):
        what = named(n, mesh)
        fault = _pose_fault(pose)
        if fault:
            problems.append(f"{what}: its pose {fault}")
            continue
        try:
            body = _Body(what, loaded(file.parent / mesh), pose, unit)
        except MeshError as error:
            problems.append(f"{what} has no mesh: {error}")
            continue
        bodies.append(body)
        problems += _wall_problems(body, extents, unit)
    for one, other in combinations(bodies, 2):
        if (np.maximum(one.low, other.low) < np.minimum(one.high, other.high)).all():
            problems += _pair_problems(one, other)
    cube = unit * unit * unit
    volume = sum(body.volume for body in bodies) * cube
    found = tuple(Problem(file, None, sentence) for sentence in problems)
    return Report(found, 1, 1, len(items), volume, float((extents / unit).prod()) * cube)


class _Loaded:
    """A mesh file's mesh. vertices: (n, 3) in the file's coordinates. volume: in its unit cubed.

    middle, extents: (3,) of its bounding box.
    part: (m,) which connected part a triangle is of. shells: vertices and faces of each closed one.
    """

    def __init__(self, mesh: trimesh.Trimesh, name: str) -> None:
        Shape.from_mesh(mesh, name)  # refuses what is empty, not finite or flat
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
        self.part = _parts(self.faces, len(self.vertices))
        self._clean = clean
        self._frame = size, middle

    @cached_property
    def shells(self) -> tuple[Floats, tuple[Ints, ...]]:
        """Vertices (n, 3), and the faces of each closed part."""
        whole, _ = repair_mesh(self._clean)
        size, middle = self._frame
        faces: Ints = np.asarray(whole.faces, dtype=np.int64)
        part = _parts(faces, len(whole.vertices))
        groups = [faces[part == n] for n in range(part.max() + 1)]
        return np.asarray(whole.vertices) * size + middle, tuple(g for g in groups if _is_closed(g))


def _loaded(path: Path) -> _Loaded:
    return _Loaded(read(path).mesh, path.name)


class _Body:
    """A mesh in its pose, drawn in; lengths are in units of the box's longest extent.

    low, high: (3,) its bounds before that. volume: of the solid.
    """

    def __init__(self, what: str, loaded: _Loaded, pose: Floats, unit: float) -> None:
        self.what = what
        self._loaded = loaded
        self._linear, self._shift = pose[:3, :3] / unit, pose[:3, 3] / unit
        scale = float(np.linalg.norm(self._linear)) / math.sqrt(3)
        self.volume = loaded.volume * scale**3
        extents = loaded.extents * scale
        self._drawn_in = np.maximum(extents - CONTACT_TOLERANCE, 0) / extents
        there = loaded.vertices @ self._linear.T + self._shift
        self.low, self.high = there.min(axis=0), there.max(axis=0)

    def _put(self, vertices: Floats) -> Floats:
        middle = self._loaded.middle
        drawn_in = (vertices - middle) * self._drawn_in + middle
        return drawn_in @ self._linear.T + self._shift

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

    def holds(self, other: _Body) -> bool:
        """Whether a part of another, whose surface crosses none of this one's, is in a shell."""
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


def winding_number(triangles: Floats, point: Floats) -> float:
    """How often a surface goes around a point: a share of the full solid angle, signed.

    triangles: (m, 3, 3) corners. point: (3,). About 0 outside a closed surface, 1 or -1 inside.
    """
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    rest = (
        la * lb * lc
        + np.einsum("ij,ij->i", a, b) * lc
        + np.einsum("ij,ij->i", b, c) * la
        + np.einsum("ij,ij->i", c, a) * lb
    )
    return float(np.arctan2(volume, rest).sum() / (2 * np.pi))


def _wall_problems(body: _Body, extents: Floats, unit: float) -> Iterator[str]:
    beyond = np.column_stack([-body.low, body.high - extents / unit])
    for walls, depths in zip(WALLS, beyond.tolist(), strict=True):
        for wall, depth in zip(walls, depths, strict=True):
            if not depth <= CONTACT_TOLERANCE:
                yield f"{body.what} reaches {depth * unit:.3g} beyond the box's {wall} wall"


def _pair_problems(one: _Body, other: _Body) -> Iterator[str]:
    if one.surface.crosses(other.surface):
        yield f"{other.what} crosses {one.what}"
        return
    for inside, around in ((other, one), (one, other)):
        if around.holds(inside):
            yield f"{inside.what} lies, in part or whole, inside {around.what}"


def _parts(faces: Ints, vertices: int) -> Ints:
    """(m,) the number of the connected part that each triangle is of."""
    ends = np.concatenate([faces[:, :2], faces[:, 1:]]).T
    graph = coo_array((np.ones(len(ends[0])), tuple(ends)), shape=(vertices, vertices))
    labels = connected_components(graph, directed=False)[1][faces[:, 0]]
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


def _is_closed(faces: Ints) -> bool:
    """Whether each edge is run through once in either direction, or as often in both."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, forward = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    signs = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    return not np.bincount(forward.ravel(), signs).any()


class _PackingItem(Struct):
    mesh: str
    pose: tuple[Row, Row, Row, Row]


class _Packing(Struct):
    """The content of a packing's file; other fields are the tool's own."""

    box: tuple[Extent, Extent, Extent]
    items: Annotated[tuple[_PackingItem, ...], Meta(min_length=1)]
    unit: str = ""


def _packing(file: Path) -> tuple[Floats, list[tuple[str, Floats]]]:
    """The box's extents (3,), and of each item the mesh's path and its pose (4, 4)."""
    try:
        packing = typed_json.decode(file.read_bytes(), _Packing, PackFormatError, "a packing")
    except OSError as error:
        raise PackFormatError(f"{file}: can't be read: {error.strerror}") from None
    except PackFormatError as error:
        raise PackFormatError(f"{file}: {error}") from None
    for n, item in enumerate(packing.items):
        if not _is_inside(item.mesh):
            raise PackFormatError(
                f"{file}: field 'items[{n}].mesh' is {item.mesh!r}: "
                "it must be a path inside the packing's folder"
            )
    return np.array(packing.box), [(item.mesh, np.array(item.pose)) for item in packing.items]


def _is_inside(path: str) -> bool:
    parts = PurePosixPath(path).parts
    outside = path.startswith("/") or PureWindowsPath(path).anchor or "\0" in path
    return bool(parts) and not outside and ".." not in parts


def _pose_fault(pose: Floats) -> str | None:
    """Why a finite (4, 4) matrix is no turn with one scale and a shift; None where it is one."""
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
