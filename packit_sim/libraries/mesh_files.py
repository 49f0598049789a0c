"""Mesh files of eight formats, read whole or refused with the reason.

trimesh does the reading. What comes before it sees to it that a small file can't ask for much
memory or time, and that no file leads to others outside its folder.
"""

from __future__ import annotations

import io
import json
import re
import struct
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal
from zipfile import BadZipFile, ZipFile

import trimesh
from lxml import etree
from trimesh.resolvers import FilePathResolver

from packit_sim.core.errors import MeshError

SUFFIXES = (".3mf", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""Endings of the files that can be read, in lower case."""

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
"""Of a file, and of what it unpacks to."""

MAX_TRIANGLES = 20_000_000
"""In all the places that a file's scene puts its meshes."""

_MIN_BYTES = {"vertex": 3, "face": 4}
"""Least bytes of an element of a PLY file: three coordinates, or a count and three indices."""

_OFF_BYTES = 6
"""Least bytes of a vertex of an OFF file: three digits and what parts them."""

_STL_HEADER = 84
"""Bytes of a binary STL before its triangles: 80 of anything, and their number."""

_STL_TRIANGLE = 50
"""Bytes of a triangle of a binary STL."""

_3MF_UNITS: Mapping[str, Unit] = {
    "micron": "micron",
    "millimeter": "mm",
    "centimeter": "cm",
    "inch": "in",
    "foot": "ft",
    "meter": "m",
}


@dataclass(frozen=True, eq=False)
class RawMesh:
    """A mesh as its file has it: a scene's meshes are one, each moved by its nodes' transforms.

    up: the axis that points up, "x", "y" or "z". unit_cm: centimetres in the file's unit of length,
    None where neither the file nor its format tells.
    """

    mesh: trimesh.Trimesh
    up: str = "z"
    unit_cm: float | None = None


def read(file: Path) -> RawMesh:
    """The mesh of a file of one of the `SUFFIXES`.

    glTF is y up and in metres, 3MF z up, COLLADA says both itself; the others are taken as z up.
    Raises MeshError, which names the file and what is wrong with it.
    """
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise MeshError(f"{file}: not a mesh file: its name must end in {', '.join(SUFFIXES)}")
    try:
        size = file.stat().st_size
        if size > MAX_BYTES:
            raise MeshError(f"{size:,} bytes are too many: at most {MAX_BYTES:,}")
        return _read(file.read_bytes(), suffix, file.parent)
    except MeshError as error:
        raise MeshError(f"{file}: {error}") from error
    except Exception as error:  # trimesh's readers raise whatever a broken file makes them hit
        problem = str(error).strip() or type(error).__name__
        raise MeshError(f"{file}: can't be read as {suffix[1:].upper()}: {problem:.200}") from error


def _read(content: bytes, suffix: str, folder: Path) -> RawMesh:
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
    options: dict[str, Any] = {"ignore_broken": False} if suffix == ".dae" else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numpy and trimesh; what matters is checked below
        scene = trimesh.load_scene(
            io.BytesIO(content),
            file_type=suffix[1:],
            resolver=FilePathResolver(str(folder)) if suffix == ".gltf" else None,
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
    return RawMesh(scene.to_mesh(), up, unit_cm)


def _check_ply(content: bytes) -> int:
    """Refuses a header that declares more than the file can hold; returns how many faces it does.

    trimesh reads an ASCII file that ends too early as if it were whole.
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
    """Refuses what is neither ASCII nor as long as a binary file must be; returns the triangles.

    What trimesh does with it depends on which guessers of encodings happen to be installed.
    """
    if len(content) >= _STL_HEADER:
        (count,) = struct.unpack_from("<I", content, _STL_HEADER - 4)
        if len(content) == _STL_HEADER + count * _STL_TRIANGLE:
            return int(count)
    if content.lstrip()[:5].lower() == b"solid":
        return len(re.findall(rb"^\s*facet\b", content, re.MULTILINE | re.IGNORECASE))
    raise MeshError(
        f"it is neither ASCII nor has {len(content):,} bytes the length of a binary STL"
    )


def _check_off(content: bytes) -> int:
    """Refuses counts that the file can't hold; returns that of faces."""
    counts = re.search(rb"OFF\s+(?:#[^\n]*\s+)*(\d+)\s+(\d+)", content)
    if counts is None:
        raise MeshError("it has no line of counts after OFF")
    for name, count in zip(("vertices", "faces"), map(int, counts.groups()), strict=True):
        if count * _OFF_BYTES > len(content):
            raise MeshError(f"it declares {count:,} {name}, but has only {len(content):,} bytes")
    return int(counts[2])


def _check_obj(content: bytes) -> int:
    """Returns how many faces there are."""
    faces = len(re.findall(rb"^[ \t]*f[ \t]", content, re.MULTILINE))
    if faces == 0:
        raise MeshError("the file holds no faces")
    return faces


def _check_glb(content: bytes) -> int:
    if len(content) < 20 or content[:4] != b"glTF":
        raise MeshError("it does not begin as a GLB file does")
    (length,) = struct.unpack_from("<I", content, 12)
    if length > len(content) - 20:
        raise MeshError(f"its JSON has {length:,} bytes, the file only {len(content):,}")
    return _check_gltf(content[20 : 20 + length], len(content))


def _check_gltf(content: bytes, size: int | None = None) -> int:
    """Refuses accessors without data that ask for more memory than the file has bytes."""
    header = json.loads(content)
    if not isinstance(header, dict):
        raise MeshError("its JSON is no object")
    for number, accessor in enumerate(header.get("accessors", ())):
        if "bufferView" not in accessor and accessor["count"] > (size or len(content)):
            raise MeshError(f"accessor {number} has {accessor['count']:,} elements without data")
    return 0


def _check_3mf(content: bytes) -> int:
    """Refuses archives that unpack to too much, and objects that stand in too many places.

    Returns how many triangles there are: trimesh leaves some out where parts of parts of parts
    are many.
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

    @cache
    def total(object_id: str, depth: int = 0) -> int:
        if depth > len(components):
            raise MeshError(f"its object {object_id!r} is a part of itself")
        parts = components.get(object_id, ())
        return triangles.get(object_id, 0) + sum(total(part, depth + 1) for part in parts)

    count = sum(map(total, items))
    if count > MAX_TRIANGLES:
        raise MeshError(f"{count:,} triangles are too many: at most {MAX_TRIANGLES:,}")
    return count


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
    return UNITS_CM[_3MF_UNITS[unit]]


def _dae_asset(content: bytes) -> tuple[str, float]:
    """The up axis and the unit in cm that a COLLADA file tells, or the format's defaults."""
    axis = re.search(rb"<up_axis>\s*([XYZ])_UP\s*</up_axis>", content)
    meter = re.search(rb"<unit[^>]*\bmeter\s*=\s*[\"']([^\"']+)[\"']", content)
    up = axis[1].decode().lower() if axis else "y"
    return up, UNITS_CM["m"] * (float(meter[1]) if meter else 1.0)


_CHECKS: Mapping[str, Callable[[bytes], int]] = {
    ".3mf": _check_3mf,
    ".glb": _check_glb,
    ".gltf": _check_gltf,
    ".obj": _check_obj,
    ".off": _check_off,
    ".ply": _check_ply,
    ".stl": _check_stl,
}
"""What looks at a file before trimesh does, and tells how many triangles must come of it."""
