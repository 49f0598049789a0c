"""Parts of glTF and STEP scenes, found again by their node for the check.

It shares nothing with the readers that decided what a part is: trimesh loads the scene as it is,
instances are read here, and STEP is tessellated four times as finely.
"""

from __future__ import annotations

import base64
import io
import json
import struct
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import trimesh
from trimesh import transformations
from trimesh.resolvers import Resolver

from packit_sim.geometry.arrays import Floats
from packit_sim.libraries.step_files import tessellated
from packit_sim.parts.reading.file_copies import FileCopy
from packit_sim.parts.reading.part import Part

SUFFIXES = (".glb", ".gltf", ".step", ".stp")

_INSTANCING = "EXT_mesh_gpu_instancing"

_FORMATS = {5120: "b", 5122: "h", 5126: "f"}
"""Format characters of `struct`, by the number of a component type."""

_TOLERANCE = 1.25e-4
"""Tolerance of the tessellation, relative to edges and faces."""


def read_scene(part: Part, file: FileCopy, suffix: str) -> trimesh.Trimesh:
    """Read the mesh of a part of a scene again.

    Parameters
    ----------
    file : FileCopy
        The content of its file.
    suffix : str
        The suffix of the file, one of `SUFFIXES`.

    Returns
    -------
    trimesh.Trimesh
        Its mesh, in the coordinates of `part.mesh`.
    """
    content = file.content
    if suffix in (".step", ".stp"):
        return _read_step(part, content)
    resolver = _Copies(file)
    scene = trimesh.load_scene(
        io.BytesIO(content), file_type=suffix[1:], resolver=resolver, skip_materials=True
    )
    header, binary = _chunks(content) if suffix == ".glb" else (json.loads(content), b"")

    def data(uri: str | None) -> bytes:
        if uri is None:
            return binary
        return base64.b64decode(uri.split(",")[1]) if uri.startswith("data:") else resolver.get(uri)

    meshes = [
        scene.geometry[name].copy().apply_transform(pose)
        for path, name, pose in _shown(scene, header, data)
        if part.node is None or part.node in path
    ]
    joined: Any = trimesh.util.concatenate(meshes)
    return trimesh.Trimesh(joined.vertices, joined.faces, process=False)


class _Copies(Resolver):
    """Finds the files that a glTF refers to."""

    def __init__(self, file: FileCopy) -> None:
        self._others = file.others

    def get(self, key: str) -> bytes:
        return self._others[key].content

    def keys(self) -> Iterable[str]:
        return self._others

    def namespaced(self, namespace: str) -> Resolver:
        raise NotImplementedError

    def write(self, name: str, data: Any) -> None:
        raise NotImplementedError


def _chunks(content: bytes) -> tuple[Any, bytes]:
    """Return the JSON and the binary chunk of a GLB file."""
    found: dict[bytes, bytes] = {}
    start = 12
    while start + 8 <= len(content):
        length, kind = struct.unpack_from("<I4s", content, start)
        found.setdefault(kind, content[start + 8 : start + 8 + length])
        start += 8 + length
    return json.loads(found[b"JSON"]), found.get(b"BIN\0", b"")


def _shown(scene: Any, header: Any, data: Any) -> Iterator[tuple[list[str], str, Floats]]:
    """Yield the nodes above each mesh, itself among them, the mesh's name, and its pose."""
    graph = scene.graph
    for node in graph.nodes_geometry:
        pose, name = graph[node]
        if not isinstance(scene.geometry[name], trimesh.Trimesh):
            continue
        path = [node]
        while path[-1] in graph.transforms.parents:
            path.append(graph.transforms.parents[path[-1]])
        edge = graph.transforms.edge_data[(path[1], node)] if len(path) > 1 else {}
        extensions = (edge.get("metadata") or {}).get("gltf_extensions", {})
        if _INSTANCING not in extensions:
            yield path, name, pose
            continue
        owner = path[1] if scene.geometry[name].metadata.get("from_gltf_primitive") else node
        for k, own in enumerate(_poses(header, extensions[_INSTANCING]["attributes"], data)):
            yield [*path, f"{owner}[{k}]"], name, pose @ own


def _poses(header: Any, attributes: dict[str, int], data: Any) -> Iterator[Floats]:
    """Yield the matrix of each instance: scaled, then rotated, then translated."""
    tables = {}
    for name in ("TRANSLATION", "ROTATION", "SCALE"):
        if name not in attributes:
            continue
        accessor = header["accessors"][attributes[name]]
        view = header["bufferViews"][accessor["bufferView"]]
        numbers = struct.Struct(
            f"<{int(accessor['type'][3:])}{_FORMATS[accessor['componentType']]}"
        )
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        step = view.get("byteStride", numbers.size)
        buffer = data(header["buffers"][view["buffer"]].get("uri"))
        tables[name] = [
            numbers.unpack_from(buffer, start + k * step) for k in range(accessor["count"])
        ]
    for k in range(len(next(iter(tables.values()), ()))):
        matrix = np.eye(4)
        if "ROTATION" in tables:  # the length of a quaternion is of no importance
            x, y, z, w = tables["ROTATION"][k]
            matrix = transformations.quaternion_matrix((w, x, y, z))
        matrix[:3, :3] *= tables["SCALE"][k] if "SCALE" in tables else 1.0
        matrix[:3, 3] = tables["TRANSLATION"][k] if "TRANSLATION" in tables else 0.0
        yield matrix


def _read_step(part: Part, content: bytes) -> trimesh.Trimesh:
    """Tessellate the solid of a part, or all, again."""
    (glb,) = tessellated(content, [(_TOLERANCE, 0.1, True)])
    scene = trimesh.load_scene(io.BytesIO(glb), file_type="glb", skip_materials=True)
    if part.node is None:
        every = scene.to_mesh()
        return trimesh.Trimesh(every.vertices * 1000.0, every.faces)
    solids = []  # those of a product have its name and a number: the one with the part's box is it
    for product in map(str, scene.graph.nodes_geometry):
        if f"{part.node}#".startswith(f"{product}#"):
            pose, name = scene.graph[product]
            mesh = scene.geometry[name].copy().apply_transform(pose)
            whole = trimesh.Trimesh(mesh.vertices * 1000.0, mesh.faces)
            solids += [whole, *whole.split(only_watertight=False)]
    return min(solids, key=lambda each: float(np.abs(each.bounds - part.mesh.bounds).max()))
