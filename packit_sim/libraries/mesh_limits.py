"""Checks of mesh files before they are read: a small file must not take much memory or time."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from lxml import etree

from packit_sim.core.errors import MeshError
from packit_sim.libraries.gltf_files import instance_counts, json_and_binary

_T = TypeVar("_T")

MAX_BYTES = 2**30
"""Maximum size of a file, and of its unpacked content."""

MAX_TRIANGLES = 20_000_000
"""Maximum number of triangles in a file's scene, counting every instance of a mesh."""

MAX_INSTANCES = 2000
"""Maximum number of instances of objects in a file's scene: the time grows with its square."""

MAX_COMPONENTS = 20_000
"""Maximum number of components and items of a 3MF file's build, counting every instance."""

MAX_DEPTH = 200
"""Maximum depth of objects in objects."""

_MIN_BYTES = {"vertex": 3, "face": 4}
"""Minimum bytes of an element of a PLY file: three coordinates, or a count and three indices."""

_MAX_DIGITS = 20
"""Maximum digits of a number of elements in a text."""

_COMMENT = re.compile(rb"#[^\n]*")
"""A comment of an OFF file."""

_OFF_BYTES = 6
"""Minimum bytes of a vertex of an OFF file: three digits and their separators."""

_STL_HEADER = 84
"""Bytes of a binary STL before its triangles: 80 arbitrary ones, and their number."""

_STL_TRIANGLE = 50
"""Bytes of a triangle of a binary STL."""


def _count(digits: bytes) -> int:
    """Read a number of elements; Python reads none of more than 4,300 digits."""
    if len(digits) > _MAX_DIGITS:
        raise MeshError(f"it declares a number of {len(digits):,} digits: at most {_MAX_DIGITS}")
    return int(digits)


def _lines_of(word: bytes, content: bytes) -> int:
    """Count the lines that begin with a word."""
    return len(re.findall(rb"^[^\S\n]*%s\b" % word, content, re.MULTILINE | re.IGNORECASE))


def _check_ply(content: bytes) -> int:
    """Refuse a header that declares more than the file contains; return the number of faces.

    trimesh would read an ASCII file that ends too early as if it were whole.
    """
    header, found, body = content.partition(b"end_header")
    if not found:
        raise MeshError("its header has no end_header")
    lines = [line.split() for line in header.splitlines()]
    counts = {
        line[1].decode("ascii", "replace"): _count(line[2])
        for line in lines
        if len(line) == 3 and line[0] == b"element" and line[2].isdigit()
    }
    for name, count in counts.items():
        if count * _MIN_BYTES.get(name, 1) > len(body):
            raise MeshError(
                f"it declares {count:,} elements {name!r}, but only {len(body):,} bytes follow"
            )
    if any(line[:1] == [b"format"] and line[1][:5] == b"ascii" for line in lines if line[1:]):
        found_lines = sum(1 for line in body.splitlines() if line.strip())
        if found_lines < sum(counts.values()):
            raise MeshError(
                f"it declares {sum(counts.values()):,} elements, but only {found_lines:,} lines "
                "follow"
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
        solids = _lines_of(b"solid", content)
        check_instances(solids, "solids")
        return _lines_of(b"facet", content)
    raise MeshError(
        f"it is not ASCII, and {len(content):,} bytes are not the length of a binary STL"
    )


def _check_off(content: bytes) -> int:
    """Refuse counts that are too large for the file; return the number of faces."""
    _, _, behind = _COMMENT.sub(b"", content).partition(b"OFF")
    first = next((line.split() for line in behind.splitlines() if line.strip()), [])
    if len(first) < 2 or not (first[0].isdigit() and first[1].isdigit()):
        raise MeshError("it has no line of counts after OFF")
    vertices, faces = map(_count, first[:2])
    for name, count in (("vertices", vertices), ("faces", faces)):
        if count * _OFF_BYTES > len(content):
            raise MeshError(f"it declares {count:,} {name}, but has only {len(content):,} bytes")
    return faces


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
    check_instances(max(map(len, materials.values())), "materials of one object")
    return faces


def _check_glb(content: bytes) -> int:
    """Refuse a wrong header; then check as `_check_gltf` does."""
    if len(content) < 20 or content[:4] != b"glTF":
        raise MeshError("it does not begin as a GLB file does")
    (length,) = struct.unpack_from("<I", content, 12)
    if length > len(content) - 20:
        raise MeshError(f"its JSON has {length:,} bytes, the file only {len(content):,}")
    return _check_gltf(content, ".glb")


def _check_gltf(content: bytes, suffix: str = ".gltf") -> int:
    """Refuse too many instances, and accessors without data that need more memory than the file."""
    header, _ = json_and_binary(content, suffix)
    for number, accessor in enumerate(header.get("accessors", ())):
        if "bufferView" not in accessor and accessor["count"] > len(content):
            raise MeshError(f"accessor {number} has {accessor['count']:,} elements without data")
    own, children = instance_counts(header)
    for scene in header.get("scenes", ()):
        check_instances(_total(own, children, scene.get("nodes", ())))
    return 0


def check_expanded(
    triangles: Mapping[_T, int], components: Mapping[_T, Sequence[_T]], items: Sequence[_T]
) -> dict[_T, int]:
    """Refuse a build of too many triangles or meshes, counting every instance.

    Parameters
    ----------
    triangles : mapping
        The number of triangles of each object.
    components : mapping
        The objects in each object.
    items : sequence
        The object of each item of the build.

    Returns
    -------
    dict
        The number of triangles of each object that is shown, with its components.

    Raises
    ------
    MeshError
        If there are too many, or an object is a part of itself.
    """
    totals = _totals(triangles, components, items)
    count = sum(totals[item] for item in items)
    if count > MAX_TRIANGLES:
        raise MeshError(f"{count:,} triangles are too many: at most {MAX_TRIANGLES:,}")
    meshes = {key: min(number, 1) for key, number in triangles.items()}
    check_instances(_total(meshes, components, items))
    shown = _total(dict.fromkeys(triangles, 1), components, items)
    if shown > MAX_COMPONENTS:
        raise MeshError(f"{shown:,} components are too many: at most {MAX_COMPONENTS:,}")
    return totals


def parsed(content: bytes) -> etree._Element:
    """Return the root of an XML file, without entities and other files."""
    return etree.fromstring(content, etree.XMLParser(resolve_entities=False, no_network=True))


def _check_dae(content: bytes) -> int:
    """Refuse scenes of too many nodes, counting every instance of a node."""
    root = parsed(content)
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
    check_instances(_total(own, inside, scenes))
    return 0


def _total(own: Mapping[_T, int], parts: Mapping[_T, Sequence[_T]], roots: Sequence[_T]) -> int:
    """Sum a number over all instances in a scene, given each object's own number and its parts."""
    totals = _totals(own, parts, roots)
    return sum(totals[root] for root in roots)


def _totals(
    own: Mapping[_T, int], parts: Mapping[_T, Sequence[_T]], roots: Sequence[_T]
) -> dict[_T, int]:
    """Sum a number over all instances in each object of a scene."""
    known: dict[_T, int] = {}

    def total(one: _T, above: frozenset[_T]) -> int:
        if one in above:
            raise MeshError(f"its object {one!r} is a part of itself")
        if len(above) > MAX_DEPTH:
            raise MeshError(f"its objects are nested more than {MAX_DEPTH} deep")
        if one not in known:
            below = (total(part, above | {one}) for part in parts.get(one, ()))
            known[one] = own.get(one, 0) + sum(below)
        return known[one]

    for root in roots:
        total(root, frozenset())
    return known


def check_instances(count: int, what: str = "instances of objects") -> None:
    """Raise MeshError if there are more than `MAX_INSTANCES`."""
    if count > MAX_INSTANCES:
        raise MeshError(f"{count:,} {what} are too many: at most {MAX_INSTANCES:,}")


CHECKS: Mapping[str, Callable[[bytes], int]] = {
    ".dae": _check_dae,
    ".glb": _check_glb,
    ".gltf": _check_gltf,
    ".obj": _check_obj,
    ".off": _check_off,
    ".ply": _check_ply,
    ".stl": _check_stl,
}
"""The check of a file by its suffix, before trimesh reads it: it raises MeshError, or returns the
minimum number of triangles that the file declares."""
