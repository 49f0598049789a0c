"""Reading of mesh files in eight formats.

lib3mf reads 3MF and trimesh the others, after the checks of `mesh_limits`. A file is read
completely or not at all, and may not refer to others outside its folder.
"""

from __future__ import annotations

import io
import re
import stat
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import trimesh
from trimesh.resolvers import FilePathResolver

from packit_sim.core.errors import MeshError
from packit_sim.core.length_units import UNITS_CM
from packit_sim.geometry.motions import split
from packit_sim.libraries import mesh_limits
from packit_sim.libraries.mesh_3mf import Plate, read_plate
from packit_sim.libraries.obj_faces import simple_faces

SUFFIXES = (".3mf", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
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
    """

    mesh: trimesh.Trimesh
    up: str = "z"
    unit_cm: float | None = None
    parts: int = 1
    notes: tuple[str, ...] = ()


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
        What finds it again in the file, if the file has other parts.
    """

    name: str
    raw: RawMesh
    count: int = 1
    node: str | None = None


def read(file: Path) -> RawMesh:
    """Read a mesh file.

    Parameters
    ----------
    file : Path
        The file, with one of the `SUFFIXES`.

    Returns
    -------
    RawMesh
        The mesh. glTF is y up and in metres, 3MF is z up, COLLADA defines both, and the others are
        assumed to be z up.

    Raises
    ------
    MeshError
        If the file can't be read; the message names the file and the reason.
    """
    return _taken(file, lambda scene: scene.joined())


def read_parts(file: Path) -> list[RawPart]:
    """Read each part of a mesh file's scene.

    Parameters
    ----------
    file : Path
        The file, with one of the `SUFFIXES`.

    Returns
    -------
    list of RawPart
        The scene's parts: its uppermost nodes with meshes below them, or the items of a 3MF file. A
        file without a scene has one part.

    Raises
    ------
    MeshError
        If the file can't be read; the message names the file and the reason.
    """
    return _taken(file, lambda scene: scene.separate())


def _taken(file: Path, taken: Callable[[_Scene | _Plate], _T]) -> _T:
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
            return taken(_read(content, suffix, file.parent))
    except MeshError as error:
        raise MeshError(f"{file}: {error}") from error
    except Exception as error:  # trimesh's readers raise any error for a broken file
        text = (error.strerror if isinstance(error, OSError) else None) or str(error)
        problem = text.strip() or type(error).__name__
        raise MeshError(f"{file}: can't be read as {suffix[1:].upper()}: {problem:.200}") from error


def _read(content: bytes, suffix: str, folder: Path) -> _Scene | _Plate:
    if not content.strip():
        raise MeshError("the file is empty")
    expected = mesh_limits.CHECKS[suffix](content) if suffix in mesh_limits.CHECKS else 0
    if suffix == ".3mf":
        return _Plate(read_plate(content))
    up, unit_cm = "z", None
    if suffix in (".glb", ".gltf"):
        up, unit_cm = "y", UNITS_CM["m"]
    elif suffix == ".dae":
        up, unit_cm = _dae_asset(content)
    elif suffix == ".obj":
        content = simple_faces(content)
    options: dict[str, Any] = {"ignore_broken": False} if suffix == ".dae" else {}
    scene = trimesh.load_scene(
        io.BytesIO(content),
        file_type=suffix[1:],
        resolver=_FolderResolver(str(folder)) if suffix == ".gltf" else None,
        process=False,
        skip_materials=True,
        **options,
    )
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
    return _Scene(scene, up, unit_cm)


@dataclass(frozen=True, eq=False)
class _Scene:
    """A file's scene, its up axis and its unit."""

    scene: trimesh.Scene
    up: str
    unit_cm: float | None

    def joined(self) -> RawMesh:
        """Join all meshes."""
        placed = [self.scene.graph[node][1] for node in self.scene.graph.nodes_geometry]
        meshes = sum(self._is_mesh(name) for name in placed)
        return self._raw(self.scene.to_mesh(), meshes)

    def separate(self) -> list[RawPart]:
        """Join the meshes below each of the uppermost nodes; count equal ones."""
        graph = self.scene.graph
        found: dict[object, RawPart] = {}
        groups = self._groups()
        for name, nodes in groups.items():
            meshes = []
            for node in nodes:
                matrix, geometry = graph[node]
                mesh = self.scene.geometry[geometry].copy()
                meshes.append(mesh.apply_transform(matrix))
            key: object = name
            if len(nodes) == 1:
                matrix, geometry = graph[nodes[0]]
                own = self.scene.geometry[geometry]
                linear = np.round(split(matrix)[0], 9) + 0.0
                key = own.vertices.tobytes(), own.faces.tobytes(), linear.tobytes()
            if key in found:
                found[key] = replace(found[key], count=found[key].count + 1)
            else:
                mesh = meshes[0] if len(meshes) == 1 else trimesh.util.concatenate(meshes)
                node = name if len(groups) > 1 else None
                found[key] = RawPart(name, self._raw(mesh, len(meshes)), node=node)
        return list(found.values())

    def _groups(self) -> dict[str, list[str]]:
        """Group the nodes with meshes by the uppermost node above them."""
        graph = self.scene.graph
        parents = graph.transforms.parents
        nodes = [node for node in graph.nodes_geometry if self._is_mesh(graph[node][1])]
        paths = []
        for node in nodes:
            path = [node]
            while path[-1] in parents:
                path.append(parents[path[-1]])
            paths.append(path[::-1])
        level = 0
        shortest = min(map(len, paths))
        while level < shortest - 1 and len({path[level] for path in paths}) == 1:
            level += 1
        groups: dict[str, list[str]] = {}
        for node, path in zip(nodes, paths, strict=True):
            groups.setdefault(str(path[level]), []).append(node)
        return groups

    def _is_mesh(self, name: object) -> bool:
        return isinstance(self.scene.geometry[str(name)], trimesh.Trimesh)

    def _raw(self, mesh: Any, parts: int) -> RawMesh:
        for name, array in (("vertices", mesh.vertices), ("triangles", mesh.faces)):
            if array.ndim != 2 or array.shape[1] != 3:
                raise MeshError(
                    f"its {name} must have three numbers each, not the shape {array.shape}"
                )
        return RawMesh(mesh, self.up, self.unit_cm, parts)


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


def _dae_asset(content: bytes) -> tuple[str, float]:
    """Return the up axis and the unit in cm of a COLLADA file, or the format's defaults."""
    axis = re.search(rb"<up_axis>\s*([XYZ])_UP\s*</up_axis>", content)
    meter = re.search(rb"<unit[^>]*\bmeter\s*=\s*[\"']([^\"']+)[\"']", content)
    up = axis[1].decode().lower() if axis else "y"
    return up, UNITS_CM["m"] * (float(meter[1]) if meter else 1.0)
