"""Reading of mesh files in eight formats, whole or not at all.

trimesh reads them. The checks before it make sure that a small file can't take much memory or time,
and that no file refers to others outside its folder.
"""

from __future__ import annotations

import io
import json
import re
import stat
import struct
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar
from zipfile import BadZipFile, ZipFile

import numpy as np
import trimesh
from lxml import etree
from trimesh.resolvers import FilePathResolver

from packit_sim.core.errors import MeshError
from packit_sim.libraries.obj_faces import simple_faces

SUFFIXES = (".3mf", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""Suffixes of the files that can be read, in lower case."""

_T = TypeVar("_T")

Unit = Literal["micron", "mm", "cm", "in", "ft", "m"]

UNITS_CM: Mapping[Unit, float] = {
    "micron": 1e-4,
    "mm": 0.1,
    "cm": 1.0,
    "in": 2.54,
    "ft": 30.48,
    "m": 100.0,
}
"""Centimetres in a unit of length."""

MAX_BYTES = 2**30
"""Maximum size of a file, and of its unpacked content."""

MAX_TRIANGLES = 20_000_000
"""Maximum number of triangles in a file's scene, counting every instance of a mesh."""

MAX_INSTANCES = 2000
"""Maximum number of instances of objects in a file's scene: the time grows with its square."""

_MIN_BYTES = {"vertex": 3, "face": 4}
"""Minimum bytes of an element of a PLY file: three coordinates, or a count and three indices."""

_OFF_BYTES = 6
"""Minimum bytes of a vertex of an OFF file: three digits and their separators."""

_STL_HEADER = 84
"""Bytes of a binary STL before its triangles: 80 arbitrary ones, and their number."""

_STL_TRIANGLE = 50
"""Bytes of a triangle of a binary STL."""

_3MF_UNITS = ("micron", "millimeter", "centimeter", "inch", "foot", "meter")
"""The units of 3MF, in the order of `UNITS_CM`."""


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
    """

    mesh: trimesh.Trimesh
    up: str = "z"
    unit_cm: float | None = None
    parts: int = 1


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
        How many instances of it there are, in the same orientation.
    """

    name: str
    raw: RawMesh
    count: int = 1


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
    return _taken(file, _Scene.joined)


def read_parts(file: Path) -> list[RawPart]:
    """Read each part of a mesh file's scene.

    Parameters
    ----------
    file : Path
        The file, with one of the `SUFFIXES`.

    Returns
    -------
    list of RawPart
        The scene's parts: its uppermost nodes with meshes below them. A file without a scene has
        one part.

    Raises
    ------
    MeshError
        If the file can't be read; the message names the file and the reason.
    """
    return _taken(file, _Scene.separate)


def _taken(file: Path, taken: Callable[[_Scene], _T]) -> _T:
    """Open a file's scene and take something from it; every error is a MeshError."""
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise MeshError(f"{file}: not a mesh file: its name must end in {', '.join(SUFFIXES)}")
    try:
        status = file.stat()
        if not stat.S_ISREG(status.st_mode):
            raise MeshError("it is not a regular file")
        if status.st_size > MAX_BYTES:
            raise MeshError(f"{status.st_size:,} bytes are too many: at most {MAX_BYTES:,}")
        content = file.read_bytes()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numpy and trimesh; the result is checked
            return taken(_read(content, suffix, file.parent))
    except MeshError as error:
        raise MeshError(f"{file}: {error}") from error
    except Exception as error:  # trimesh's readers raise any error for a broken file
        problem = str(error).strip() or type(error).__name__
        raise MeshError(f"{file}: can't be read as {suffix[1:].upper()}: {problem:.200}") from error


def _read(content: bytes, suffix: str, folder: Path) -> _Scene:
    if not content.strip():
        raise MeshError("the file is empty")
    expected = _CHECKS[suffix](content) if suffix in _CHECKS else 0
    up, unit_cm = "z", None
    if suffix in (".glb", ".gltf"):
        up, unit_cm = "y", UNITS_CM["m"]
    elif suffix == ".dae":
        up, unit_cm = _dae_asset(content)
    elif suffix == ".3mf":
        unit_cm = _3mf_unit(content)
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
    if triangles > MAX_TRIANGLES:
        raise MeshError(f"{triangles:,} triangles are too many: at most {MAX_TRIANGLES:,}")
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
        for name, nodes in self._groups().items():
            meshes = []
            for node in nodes:
                matrix, geometry = graph[node]
                mesh = self.scene.geometry[geometry].copy()
                meshes.append(mesh.apply_transform(matrix))
            key: object = name
            if len(nodes) == 1:
                matrix, geometry = graph[nodes[0]]
                own = self.scene.geometry[geometry]
                linear = np.round(matrix[:3, :3], 9) + 0.0
                key = own.vertices.tobytes(), own.faces.tobytes(), linear.tobytes()
            if key in found:
                found[key] = replace(found[key], count=found[key].count + 1)
            else:
                mesh = meshes[0] if len(meshes) == 1 else trimesh.util.concatenate(meshes)
                found[key] = RawPart(name, self._raw(mesh, len(meshes)))
        return list(found.values())

    def _groups(self) -> dict[str, list[str]]:
        """Return the nodes with meshes by the uppermost node that they are below of."""
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
                    f"its {name} have not three numbers each, but the shape {array.shape}"
                )
        return RawMesh(mesh, self.up, self.unit_cm, parts)


class _FolderResolver(FilePathResolver):
    """Reads the files that a glTF refers to, if they are in its folder; trimesh 4 reads any."""

    def get(self, name: str) -> bytes:
        folder = Path(self.parent).resolve()
        for path in (folder / name.strip(), folder / Path(name).name):
            if not path.resolve().is_relative_to(folder):
                raise MeshError(f"it refers to {name!r}, which is not in its folder")
        content: bytes = super().get(name)
        return content


def _check_ply(content: bytes) -> int:
    """Refuse a header that declares more than the file contains; return the number of faces.

    trimesh would read an ASCII file that ends too early as if it were whole.
    """
    header, found, body = content.partition(b"end_header")
    if not found:
        raise MeshError("its header has no end_header")
    counts = {
        name.decode("ascii", "replace"): int(count)
        for name, count in re.findall(rb"^\s*element\s+(\S+)\s+(\d+)\s*$", header, re.MULTILINE)
    }
    for name, count in counts.items():
        if count * _MIN_BYTES.get(name, 1) > len(body):
            raise MeshError(
                f"it declares {count:,} elements {name!r}, but only {len(body):,} bytes follow"
            )
    if re.search(rb"^\s*format\s+ascii", header, re.MULTILINE):
        lines = sum(1 for line in body.splitlines() if line.strip())
        if lines < sum(counts.values()):
            raise MeshError(
                f"it declares {sum(counts.values()):,} elements, but only {lines:,} lines follow"
            )
    return counts.get("face", 0)


def _check_stl(content: bytes) -> int:
    """Refuse a file that is neither ASCII nor a binary one of the right length; count triangles.

    trimesh's result for it would depend on the installed libraries that guess encodings.
    """
    if len(content) >= _STL_HEADER:
        (count,) = struct.unpack_from("<I", content, _STL_HEADER - 4)
        if len(content) == _STL_HEADER + count * _STL_TRIANGLE:
            return int(count)
    if content.lstrip()[:5].lower() == b"solid":
        solids = len(re.findall(rb"^\s*solid\b", content, re.MULTILINE | re.IGNORECASE))
        _check_instances(solids, "solids")
        return len(re.findall(rb"^\s*facet\b", content, re.MULTILINE | re.IGNORECASE))
    raise MeshError(
        f"it is not ASCII, and {len(content):,} bytes are not the length of a binary STL"
    )


def _check_off(content: bytes) -> int:
    """Refuse counts that are too large for the file; return the number of faces."""
    counts = re.search(rb"OFF\s+(?:#[^\n]*\s+)*(\d+)\s+(\d+)", content)
    if counts is None:
        raise MeshError("it has no line of counts after OFF")
    for name, count in zip(("vertices", "faces"), map(int, counts.groups()), strict=True):
        if count * _OFF_BYTES > len(content):
            raise MeshError(f"it declares {count:,} {name}, but has only {len(content):,} bytes")
    return int(counts[2])


def _check_obj(content: bytes) -> int:
    """Refuse too many materials, each of which becomes a mesh; return the number of faces."""
    faces = len(re.findall(rb"^[ \t]*f[ \t]", content, re.MULTILINE))
    if faces == 0:
        raise MeshError("the file holds no faces")
    materials: dict[bytes, set[bytes]] = {b"": set()}
    current = materials[b""]
    for kind, name in re.findall(rb"^[ \t]*(o|usemtl)[ \t]+(.*)$", content, re.MULTILINE):
        if kind == b"o":
            current = materials.setdefault(name, set())
        else:
            current.add(name)
    _check_instances(max(map(len, materials.values())), "materials of one object")
    return faces


def _check_glb(content: bytes) -> int:
    """Refuse a wrong header; the rest is as of `_check_gltf`."""
    if len(content) < 20 or content[:4] != b"glTF":
        raise MeshError("it does not begin as a GLB file does")
    (length,) = struct.unpack_from("<I", content, 12)
    if length > len(content) - 20:
        raise MeshError(f"its JSON has {length:,} bytes, the file only {len(content):,}")
    return _check_gltf(content[20 : 20 + length], len(content))


def _check_gltf(content: bytes, size: int | None = None) -> int:
    """Refuse accessors without data that need more memory than the file has bytes."""
    header = json.loads(content)
    if not isinstance(header, dict):
        raise MeshError("its JSON is not an object")
    for number, accessor in enumerate(header.get("accessors", ())):
        if "bufferView" not in accessor and accessor["count"] > (size or len(content)):
            raise MeshError(f"accessor {number} has {accessor['count']:,} elements without data")
    return 0


def _check_3mf(content: bytes) -> int:
    """Refuse archives that unpack to too much, and objects with too many instances.

    Returns the number of triangles: trimesh omits some of deeply nested components.
    """
    try:
        archive = ZipFile(io.BytesIO(content))
        unpacked = sum(entry.file_size for entry in archive.infolist())
    except BadZipFile as error:
        raise MeshError(f"it is no ZIP archive: {error}") from error
    if unpacked > MAX_BYTES:
        raise MeshError(f"it unpacks to {unpacked:,} bytes: at most {MAX_BYTES:,}")
    with archive.open(_3mf_model(archive)) as model:
        triangles: dict[str, int] = {}
        components: dict[str, list[str]] = {}
        items = []
        for _, element in etree.iterparse(model, tag=("{*}object", "{*}item"), events=("end",)):
            target = str(element.get("id") or element.get("objectid"))
            if etree.QName(element).localname == "item":
                items.append(target)
            else:
                triangles[target] = sum(1 for _ in element.iter("{*}triangle"))
                parts = element.iter("{*}component")
                components[target] = [str(part.get("objectid")) for part in parts]
            element.clear()

    count = _total(triangles, components, items)
    if count > MAX_TRIANGLES:
        raise MeshError(f"{count:,} triangles are too many: at most {MAX_TRIANGLES:,}")
    _check_instances(_total(dict.fromkeys(components, 1), components, items))
    return count


def _check_dae(content: bytes) -> int:
    """Refuse scenes of too many nodes, counting every instance of a node."""
    parser = etree.XMLParser(resolve_entities=False, no_network=True)
    root = etree.fromstring(content, parser)
    nodes = {node: number for number, node in enumerate(root.iter("{*}node"))}
    numbers = {node.get("id"): number for node, number in nodes.items()}
    inside: dict[int, list[int]] = {}
    own: dict[int, int] = {}
    for node, number in nodes.items():
        own[number] = 1 + sum(1 for _ in node.iterchildren("{*}instance_geometry"))
        instances = (
            one.get("url", "").lstrip("#") for one in node.iterchildren("{*}instance_node")
        )
        inside[number] = [nodes[child] for child in node.iterchildren("{*}node")]
        inside[number] += [numbers[target] for target in instances if target in numbers]
    scenes = [nodes[node] for node in root.iterfind(".//{*}visual_scene/{*}node")]
    _check_instances(_total(own, inside, scenes))
    return 0


def _total(own: Mapping[_T, int], parts: Mapping[_T, Sequence[_T]], roots: Sequence[_T]) -> int:
    """Sum a number over all instances in a scene, given each object's own number and its parts."""
    known: dict[_T, int] = {}

    def total(one: _T, above: frozenset[_T]) -> int:
        if one in above:
            raise MeshError(f"its object {one!r} is a part of itself")
        if one not in known:
            below = (total(part, above | {one}) for part in parts.get(one, ()))
            known[one] = own.get(one, 0) + sum(below)
        return known[one]

    return sum(total(root, frozenset()) for root in roots)


def _check_instances(count: int, what: str = "instances of objects") -> None:
    if count > MAX_INSTANCES:
        raise MeshError(f"{count:,} {what} are too many: at most {MAX_INSTANCES:,}")


def _3mf_model(archive: ZipFile) -> str:
    names = [name for name in archive.namelist() if "3d/3dmodel.model" in name.lower()]
    if not names:
        raise MeshError("the archive holds no 3D/3dmodel.model")
    return names[0]


def _3mf_unit(content: bytes) -> float:
    archive = ZipFile(io.BytesIO(content))
    with archive.open(_3mf_model(archive)) as model:
        _, root = next(etree.iterparse(model, events=("start",)))
        unit = root.get("unit", "millimeter")
    if unit not in _3MF_UNITS:
        raise MeshError(f"its unit {unit!r} is none of {', '.join(_3MF_UNITS)}")
    return tuple(UNITS_CM.values())[_3MF_UNITS.index(unit)]


def _dae_asset(content: bytes) -> tuple[str, float]:
    """Return the up axis and the unit in cm of a COLLADA file, or the format's defaults."""
    axis = re.search(rb"<up_axis>\s*([XYZ])_UP\s*</up_axis>", content)
    meter = re.search(rb"<unit[^>]*\bmeter\s*=\s*[\"']([^\"']+)[\"']", content)
    up = axis[1].decode().lower() if axis else "y"
    return up, UNITS_CM["m"] * (float(meter[1]) if meter else 1.0)


_CHECKS: Mapping[str, Callable[[bytes], int]] = {
    ".3mf": _check_3mf,
    ".dae": _check_dae,
    ".glb": _check_glb,
    ".gltf": _check_gltf,
    ".obj": _check_obj,
    ".off": _check_off,
    ".ply": _check_ply,
    ".stl": _check_stl,
}
"""The check of a file before trimesh reads it; returns the minimum number of triangles."""
