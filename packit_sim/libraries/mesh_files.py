"""Reading of mesh files in nine formats.

lib3mf reads 3MF, `step_files` tessellates STEP, and trimesh reads the others, after the checks of
`mesh_limits`. A file is read completely or not at all, and may not refer to others outside its
folder.
"""

from __future__ import annotations

import io
import re
import stat
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import trimesh
from trimesh.resolvers import FilePathResolver

from packit_sim.core.errors import MeshError
from packit_sim.core.extras import MissingPackageError
from packit_sim.core.length_units import UNITS_CM
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import split
from packit_sim.libraries import gltf_files, mesh_limits, step_files
from packit_sim.libraries.mesh_3mf import Plate, read_plate
from packit_sim.libraries.obj_faces import simple_faces

SUFFIXES = (".3mf", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".step", ".stl", ".stp")
"""Suffixes of the files that can be read, in lower case."""

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class RawMesh:
    """A mesh as in its file; the meshes of a scene are joined, with their nodes' transforms.

    Attributes
    ----------
    mesh : trimesh.Trimesh
        The mesh, in the file's coordinates.
    up : str
        The axis that points up, "x", "y" or "z".
    unit_cm : float, optional
        Centimetres in the file's unit of length, if the file or its format defines it.
    parts : int
        The number of meshes in the file's scene, counting every instance.
    notes : tuple of str
        What the user should know about how the file was understood.
    deviation : float
        No point of the file's surface is farther from the mesh: that of a tessellation.
    """

    mesh: trimesh.Trimesh
    up: str = "z"
    unit_cm: float | None = None
    parts: int = 1
    notes: tuple[str, ...] = ()
    deviation: float = 0.0


@dataclass(frozen=True, eq=False)
class RawPart:
    """A part of a scene, as in its file, with the transform of its first instance.

    Attributes
    ----------
    name : str
        The name of its node.
    raw : RawMesh
        Its mesh, in the scene's coordinates.
    count : int
        The number of its instances in the same orientation.
    node : str, optional
        What finds it again in the file: a node, if the file has other parts, or the number of the
        first item in the build of a 3MF file.
    """

    name: str
    raw: RawMesh
    count: int = 1
    node: str | None = None


def read(file: Path, accuracy: float | None = None) -> RawMesh:
    """Read a mesh file.

    Parameters
    ----------
    file : Path
        The file, with one of the `SUFFIXES`.
    accuracy : float, optional
        Largest deviation of the tessellation of STEP, in mm; by default `step_files.ACCURACY`.

    Returns
    -------
    RawMesh
        The mesh. glTF is y up and in metres, 3MF is z up, COLLADA defines both, and the others are
        assumed to be z up.

    Raises
    ------
    MeshError
        If the file can't be read; the message names the file and the reason.
    MissingPackageError
        If it is STEP, and cascadio is not installed.
    """
    return _taken(file, accuracy, lambda scene: scene.joined())


def read_parts(file: Path, accuracy: float | None = None) -> list[RawPart]:
    """Read each part of a mesh file's scene.

    Parameters
    ----------
    file : Path
        The file, with one of the `SUFFIXES`.
    accuracy : float, optional
        Largest deviation of the tessellation of STEP, in mm; by default `step_files.ACCURACY`.

    Returns
    -------
    list of RawPart
        The scene's parts: its uppermost nodes with meshes below them, or the items of a 3MF file. A
        file without a scene has one part.

    Raises
    ------
    MeshError
        If the file can't be read; the message names the file and the reason.
    MissingPackageError
        If it is STEP, and cascadio is not installed.
    """
    return _taken(file, accuracy, lambda scene: scene.separate())


def _taken(file: Path, accuracy: float | None, taken: Callable[[_Scene | _Plate], _T]) -> _T:
    """Open a file's scene and apply a function to it; every error is a MeshError."""
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise MeshError(f"{file}: not a mesh file: its name must end in {', '.join(SUFFIXES)}")
    try:
        status = file.stat()
        if not stat.S_ISREG(status.st_mode):
            raise MeshError("it is not a regular file")
        if status.st_size > mesh_limits.MAX_BYTES:
            raise MeshError(
                f"{status.st_size:,} bytes are too many: at most {mesh_limits.MAX_BYTES:,}"
            )
        content = file.read_bytes()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numpy and trimesh; the result is checked
            return taken(_read(content, suffix, file.parent, accuracy))
    except MissingPackageError:
        raise
    except MeshError as error:
        raise MeshError(f"{file}: {error}") from error
    except Exception as error:  # trimesh's readers raise any error for a broken file
        text = (error.strerror if isinstance(error, OSError) else None) or str(error)
        problem = text.strip() or type(error).__name__
        raise MeshError(f"{file}: can't be read as {suffix[1:].upper()}: {problem:.200}") from error


def _read(content: bytes, suffix: str, folder: Path, accuracy: float | None) -> _Scene | _Plate:
    if not content.strip():
        raise MeshError("the file is empty")
    if suffix in step_files.SUFFIXES:
        found = step_files.solids(content, accuracy)
        tessellation = _Scene(
            found.scene, "z", UNITS_CM["mm"], tuple(found.notes), found.deviations
        )
        return _checked(tessellation, 0)
    expected = mesh_limits.CHECKS[suffix](content) if suffix in mesh_limits.CHECKS else 0
    if suffix == ".3mf":
        return _Plate(read_plate(content))
    up, unit_cm = "z", None
    resolver = _FolderResolver(str(folder))
    notes: list[str] = []
    if suffix in (".glb", ".gltf"):
        up, unit_cm = "y", UNITS_CM["m"]
        content, notes = gltf_files.expanded(content, suffix, resolver.get)
    elif suffix == ".dae":
        up, unit_cm = _dae_asset(content)
    elif suffix == ".obj":
        content = simple_faces(content)
    options: dict[str, Any] = {"ignore_broken": False} if suffix == ".dae" else {}
    scene = trimesh.load_scene(
        io.BytesIO(content),
        file_type=suffix[1:],
        resolver=resolver if suffix == ".gltf" else None,
        process=False,
        skip_materials=True,
        **options,
    )
    return _checked(_Scene(scene, up, unit_cm, tuple(notes)), expected)


def _checked(found: _Scene, expected: int) -> _Scene:
    """Refuse a scene with too many or too few triangles, or too many meshes."""
    scene = found.scene
    meshes = {n: m for n, m in scene.geometry.items() if isinstance(m, trimesh.Trimesh)}
    placed = [scene.graph[node][1] for node in scene.graph.nodes_geometry]
    triangles = sum(len(meshes[name].faces) for name in placed if name in meshes)
    if triangles == 0:
        raise MeshError("the file holds no triangles")
    if triangles > mesh_limits.MAX_TRIANGLES:
        raise MeshError(
            f"{triangles:,} triangles are too many: at most {mesh_limits.MAX_TRIANGLES:,}"
        )
    if triangles < expected:
        raise MeshError(f"only {triangles:,} of its {expected:,} triangles could be read")
    mesh_limits.check_instances(len(placed))
    return found


@dataclass(frozen=True, eq=False)
class _Scene:
    """A file's scene, its up axis, its unit, notes, and its meshes' deviations by name."""

    scene: trimesh.Scene
    up: str
    unit_cm: float | None
    notes: tuple[str, ...] = ()
    deviations: Mapping[str, float] = field(default_factory=dict)

    def joined(self) -> RawMesh:
        """Join all meshes."""
        placed = [self.scene.graph[node][1] for node in self.scene.graph.nodes_geometry]
        meshes = sum(self._is_mesh(name) for name in placed)
        return self._raw(self.scene.to_mesh(), meshes, list(map(str, placed)))

    def separate(self) -> list[RawPart]:
        """Join the meshes below each of the uppermost nodes; count equal ones."""
        graph = self.scene.graph
        found: dict[object, RawPart] = {}
        groups = self._groups()
        digests = {name: _digest(mesh) for name, mesh in self.scene.geometry.items()}
        for name, nodes in groups.items():
            inside = [graph.get(node, name) for node in nodes]
            own = [(digests[each], _rounded(matrix)) for matrix, each in inside]
            key = (tuple(own), _rounded(split(graph.get(name)[0])[0]))
            if key in found:
                found[key] = replace(found[key], count=found[key].count + 1)
                continue
            placed = [
                (self.scene.geometry[geometry].copy(), matrix)
                for matrix, geometry in map(graph.get, nodes)
            ]
            meshes = [mesh.apply_transform(matrix) for mesh, matrix in placed]
            mesh = meshes[0] if len(meshes) == 1 else trimesh.util.concatenate(meshes)
            address = self._address(name) if len(groups) > 1 else None
            names = [str(geometry) for _, geometry in inside]
            found[key] = RawPart(name, self._raw(mesh, len(meshes), names), node=address)
        return list(found.values())

    def _groups(self) -> dict[str, list[str]]:
        """Group the nodes with meshes by the uppermost node above them."""
        graph = self.scene.graph
        parents = graph.transforms.parents
        nodes = [node for node in graph.nodes_geometry if self._is_mesh(graph[node][1])]
        paths = []
        for node in nodes:
            metadata = self.scene.geometry[graph[node][1]].metadata
            path = [parents[node] if metadata.get("from_gltf_primitive") else node]
            while path[-1] in parents:
                path.append(parents[path[-1]])
            paths.append(path[::-1])
        level = 0
        shortest = min(map(len, paths))
        while level < shortest - 1 and len({path[level] for path in paths}) == 1:
            level += 1
        groups: dict[str, list[str]] = {}
        for node, path in zip(nodes, paths, strict=True):
            below = level + 1
            is_instance = below < len(path) and self._instance(path[below]) is not None
            groups.setdefault(str(path[below if is_instance else level]), []).append(node)
        return groups

    def _instance(self, node: str) -> int | None:
        """Return the number of an instance of a mesh that its parent shows several times."""
        transforms = self.scene.graph.transforms
        edge = transforms.edge_data.get((transforms.parents.get(node), node), {})
        number: int | None = (edge.get("metadata") or {}).get(gltf_files.INSTANCING)
        return number

    def _address(self, node: str) -> str:
        """Return what finds a node in the file: an instance by its parent and number."""
        number = self._instance(node)
        return node if number is None else f"{self.scene.graph.transforms.parents[node]}[{number}]"

    def _is_mesh(self, name: object) -> bool:
        return isinstance(self.scene.geometry[str(name)], trimesh.Trimesh)

    def _raw(self, mesh: Any, parts: int, names: Sequence[str]) -> RawMesh:
        for name, array in (("vertices", mesh.vertices), ("triangles", mesh.faces)):
            if array.ndim != 2 or array.shape[1] != 3:
                raise MeshError(
                    f"its {name} must have three numbers each, not the shape {array.shape}"
                )
        deviation = max((self.deviations.get(name, 0.0) for name in names), default=0.0)
        return RawMesh(mesh, self.up, self.unit_cm, parts, self.notes, deviation)


@dataclass(frozen=True)
class _Plate:
    """The parts of a 3MF file."""

    plate: Plate

    def joined(self) -> RawMesh:
        """Join all items."""
        items = [(part, shift) for part in self.plate.parts for shift in part.shifts]
        meshes = [
            trimesh.Trimesh(each.vertices + shift, each.triangles, process=False)
            for each, shift in items
        ]
        joined: Any = trimesh.util.concatenate(meshes)
        return self._raw(joined, len(meshes))

    def separate(self) -> list[RawPart]:
        """Return each part; several without a name are numbered as in the file."""
        is_only = len(self.plate.parts) == 1
        return [
            RawPart(
                part.name or ("" if is_only else str(part.item)),
                self._raw(trimesh.Trimesh(part.vertices, part.triangles, process=False)),
                len(part.shifts),
                str(part.item),
            )
            for part in self.plate.parts
        ]

    def _raw(self, mesh: trimesh.Trimesh, parts: int = 1) -> RawMesh:
        return RawMesh(mesh, "z", self.plate.unit_cm, parts, self.plate.notes)


class _FolderResolver(FilePathResolver):
    """Reads the files that a glTF refers to, if they are in its folder; trimesh 4 reads any."""

    def get(self, name: str) -> bytes:
        folder = Path(self.parent).resolve()
        for path in (folder / name.strip(), folder / Path(name).name):
            if not path.resolve().is_relative_to(folder):
                raise MeshError(f"it refers to {name!r}, which is not in its folder")
        content: bytes = super().get(name)
        return content


def _digest(mesh: Any) -> bytes:
    digest = sha256(np.ascontiguousarray(mesh.vertices).tobytes())
    digest.update(np.ascontiguousarray(getattr(mesh, "faces", ())).tobytes())
    return digest.digest()


def _rounded(matrix: Floats) -> bytes:
    """Return a matrix without rounding errors, for comparisons."""
    return (np.round(matrix, 9) + 0.0).tobytes()


def _dae_asset(content: bytes) -> tuple[str, float]:
    """Return the up axis and the unit in cm of a COLLADA file, or the format's defaults."""
    axis = re.search(rb"<up_axis>\s*([XYZ])_UP\s*</up_axis>", content)
    meter = re.search(rb"<unit[^>]*\bmeter\s*=\s*[\"']([^\"']+)[\"']", content)
    up = axis[1].decode().lower() if axis else "y"
    return up, UNITS_CM["m"] * (float(meter[1]) if meter else 1.0)
