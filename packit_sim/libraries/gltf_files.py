"""glTF files as trimesh reads them: instances become nodes, and what it would ignore is refused."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from packit_sim.core.errors import MeshError
from packit_sim.geometry.arrays import Floats

INSTANCING = "EXT_mesh_gpu_instancing"

_READ = (INSTANCING, "KHR_lights_punctual", "KHR_mesh_quantization", "KHR_xmp_json_ld")

_READ_KINDS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "EXT_lights_")
"""Beginnings of extensions that don't change any geometry."""

_WIDTHS = {"TRANSLATION": 3, "ROTATION": 4, "SCALE": 3}
"""Numbers of each attribute of an instance."""

_TYPES = {5120: ("<i1", 127.0), 5122: ("<i2", 32767.0), 5126: ("<f4", 1.0)}
"""The type of a component by its number, and what 1 is; only rotations may be integers."""

_TRIANGLES = (4, 5)
"""Modes of primitives: triangles and strips of them; 6 is a fan, the others points and lines."""


def expanded(content: bytes, suffix: str, load: Callable[[str], bytes]) -> tuple[bytes, list[str]]:
    """Return a file with a node for each instance of a mesh.

    Parameters
    ----------
    content : bytes
        A glTF or GLB file within the limits of `mesh_limits`.
    suffix : str
        ".gltf" or ".glb".
    load : callable
        Returns the content of another file by its URI.

    Returns
    -------
    tuple of bytes and list of str
        The file, and notes on what is left out.

    Raises
    ------
    MeshError
        If it needs an extension or has a feature that would be ignored.
    """
    header, binary = json_and_binary(content, suffix)
    for name in header.get("extensionsRequired", ()):
        if name not in _READ and not str(name).startswith(_READ_KINDS):
            raise MeshError(
                f"it requires the extension {name}, which is not read: export it without "
                f"(those that are read: {', '.join(_READ)}, and those of materials)"
            )
    nodes: list[dict[str, Any]] = header.get("nodes", [])
    notes = _notes(header, nodes)
    instanced = [(n, e) for n, e in enumerate(nodes) if INSTANCING in e.get("extensions", {})]
    if not instanced:
        return content, notes

    def buffer(number: int) -> bytes:
        uri = header["buffers"][number].get("uri")
        if uri is None:
            return binary
        return base64.b64decode(uri.partition(",")[2]) if uri[:5] == "data:" else load(uri)

    for number, node in instanced:
        attributes = node["extensions"].pop(INSTANCING)["attributes"]
        mesh = node.pop("mesh", None)
        if mesh is None:
            continue
        rows = {
            name: _rows(header, attributes[name], width, name == "ROTATION", buffer)
            for name, width in _WIDTHS.items()
            if name in attributes
        }
        counts = {len(values) for values in rows.values()}
        if len(counts) != 1:
            raise MeshError(f"the attributes of its instances have different counts: {counts}")
        name = node.get("name", str(number))
        node.setdefault("children", []).extend(range(len(nodes), len(nodes) + counts.pop()))
        for k, values in enumerate(zip(*rows.values(), strict=True)):
            motion = {key.lower(): value.tolist() for key, value in zip(rows, values, strict=True)}
            extras = {INSTANCING: k}
            nodes.append({"name": f"{name}[{k}]", "mesh": mesh, "extras": extras, **motion})
    text = json.dumps(header).encode()
    if suffix == ".gltf":
        return text, notes
    text += b" " * (-len(text) % 4)
    (length,) = struct.unpack_from("<I", content, 12)
    rest = content[20 + length :]
    start = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    return start + text + rest, notes


def json_and_binary(content: bytes, suffix: str) -> tuple[dict[str, Any], bytes]:
    """Return the JSON of a file, and the first binary chunk of a GLB."""
    binary = b""
    if suffix == ".glb":
        (length,) = struct.unpack_from("<I", content, 12)
        content, binary = content[20 : 20 + length], content[28 + length :]
    header = json.loads(content)
    if not isinstance(header, dict):
        raise MeshError("its JSON is not an object")
    return header, binary


def instance_counts(header: dict[str, Any]) -> tuple[dict[int, int], dict[int, list[int]]]:
    """Return how often each node shows its mesh, and its children."""
    own, children = {}, {}
    for n, node in enumerate(header.get("nodes", ())):
        attributes = node.get("extensions", {}).get(INSTANCING, {}).get("attributes", {})
        counts = [header["accessors"][each]["count"] for each in attributes.values()]
        own[n] = max(counts, default=1) if "mesh" in node else 0
        children[n] = list(node.get("children", ()))
    return own, children


def _notes(header: dict[str, Any], nodes: Sequence[dict[str, Any]]) -> list[str]:
    """Refuse what trimesh would ignore or read wrongly; return notes on what is left out."""
    notes, scenes = [], header.get("scenes", ())
    if len(scenes) > 1:
        shown = header.get("scene", 0)
        name = scenes[shown].get("name", shown)
        notes.append(f"its scene {name!r} is read, one of {len(scenes)}")
    others = 0
    seen: set[int] = set()
    for number in _shown(header, nodes):
        if number in seen:
            raise MeshError(f"its node {number} is in two places")
        seen.add(number)
        node = nodes[number]
        name = node.get("name", number)
        if "camera" in node and ("mesh" in node or node.get("children")):
            raise MeshError(f"its node {name!r} is a camera with meshes, which is not read")
        if "mesh" not in node:
            continue
        mesh = header["meshes"][node["mesh"]]
        if "skin" in node:
            notes.append(f"its node {name!r} is read without its skin: as modelled, not posed")
        if any(node.get("weights", mesh.get("weights", ()))):
            raise MeshError(f"its mesh {mesh.get('name', name)!r} is morphed, which is not read")
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", 4)
            if mode == 6:
                raise MeshError(f"its mesh {mesh.get('name', name)!r} has triangle fans")
            if mode not in _TRIANGLES:
                others += 1
                continue
            _check_accessors(header, primitive)
    if others:
        notes.append(f"{others} sets of points or lines in it are left out")
    return notes


def _shown(header: dict[str, Any], nodes: Sequence[dict[str, Any]]) -> Iterator[int]:
    """Yield the numbers of the nodes in the scene that is shown; none is a part of itself."""
    scenes = header.get("scenes", ())
    waiting = list(scenes[header.get("scene", 0)].get("nodes", ())) if scenes else []
    while waiting:
        number = waiting.pop()
        yield number
        waiting += nodes[number].get("children", ())


def _check_accessors(header: dict[str, Any], primitive: dict[str, Any]) -> None:
    """Refuse vertices and indices that trimesh would read as zeros or without their scale."""
    used = {"vertices": primitive["attributes"]["POSITION"], "indices": primitive.get("indices")}
    for what, number in used.items():
        if number is None:
            continue
        accessor = header["accessors"][number]
        if "sparse" in accessor:
            raise MeshError(f"its {what} are sparse, which is not read (accessor {number})")
        if accessor.get("normalized"):
            raise MeshError(
                f"its {what} are normalized integers, which are not read: export floats"
            )
        if "bufferView" not in accessor:
            raise MeshError(f"its {what} have no data that can be read (accessor {number})")


def _rows(
    header: dict[str, Any],
    number: int,
    width: int,
    may_be_integer: bool,
    buffer: Callable[[int], bytes],
) -> Floats:
    """Return the values (n, width) of an attribute of instances."""
    accessor = header["accessors"][number]
    kind, one = _TYPES.get(accessor["componentType"], ("", 0.0))
    if accessor["type"] != f"VEC{width}" or not kind or (one > 1 and not may_be_integer):
        raise MeshError(f"an attribute of its instances has another type (accessor {number})")
    if "sparse" in accessor or "bufferView" not in accessor:
        raise MeshError(f"an attribute of its instances is sparse (accessor {number})")
    view = header["bufferViews"][accessor["bufferView"]]
    start = view.get("byteOffset", 0)
    data = buffer(view["buffer"])[start : start + view["byteLength"]]
    dtype = np.dtype(kind)
    stride = view.get("byteStride", dtype.itemsize * width)
    shape = accessor["count"], width
    values = np.ndarray(shape, dtype, data, accessor.get("byteOffset", 0), (stride, dtype.itemsize))
    found = np.maximum(values / one, -1.0) if one > 1 else values.astype(float)
    if not np.isfinite(found).all():
        raise MeshError(f"an attribute of its instances is not finite (accessor {number})")
    return found
