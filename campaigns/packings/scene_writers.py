"""Writers of files with scenes: GLB, glTF and COLLADA, by their specifications alone."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from campaigns.packings.mesh_writers import SINGLE, TEXT, text_of, triangles_of
from campaigns.packings.scenes import Scene, quaternion
from campaigns.packings.shapes import Floats

_FLOAT, _INDEX = 5126, 5125


class _Buffer:
    """The binary part of a glTF file, with its views and accessors."""

    def __init__(self) -> None:
        self.data = b""
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: Floats | list[Any], component: int, kind: str) -> int:
        """Add an accessor, and return its number."""
        numbers = np.asarray(values, "<f4" if component == _FLOAT else "<u4")
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": numbers.nbytes}
        self.data += numbers.tobytes()
        self.views.append(view)
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": component,
            "count": len(numbers),
            "type": kind,
        }
        if kind == "VEC3":
            accessor |= {"min": numbers.min(axis=0).tolist(), "max": numbers.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _gltf(scene: Scene, is_instanced: bool) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the binary part of a glTF file."""
    buffer, meshes = _Buffer(), []
    for number, name in enumerate(scene.names):
        corners = buffer.add(scene.local(number), _FLOAT, "VEC3")
        faces = np.array(triangles_of(scene.shapes[number])).ravel()
        indices = buffer.add(list(faces), _INDEX, "SCALAR")
        meshes.append(
            {
                "name": name,
                "primitives": [{"attributes": {"POSITION": corners}, "indices": indices}],
            }
        )
    matrices = [scene.matrix(node) for node in scene.nodes]
    document: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "meshes": meshes}
    if is_instanced:
        size = float(np.cbrt(np.linalg.det(matrices[0][:3, :3])))
        attributes = {
            "TRANSLATION": buffer.add([m[:3, 3] for m in matrices], _FLOAT, "VEC3"),
            "ROTATION": buffer.add(
                [quaternion(m[:3, :3] / size) for m in matrices], _FLOAT, "VEC4"
            ),
            "SCALE": buffer.add([[size] * 3 for _ in matrices], _FLOAT, "VEC3"),
        }
        extension = "EXT_mesh_gpu_instancing"
        nodes = [
            {
                "name": scene.names[0],
                "mesh": 0,
                "extensions": {extension: {"attributes": attributes}},
            }
        ]
        document |= {"extensionsUsed": [extension], "extensionsRequired": [extension]}
        document |= {"nodes": nodes, "scenes": [{"nodes": [0]}]}
    else:
        nodes = [
            {
                "name": f"{scene.names[node.mesh]}_{n}",
                "mesh": node.mesh,
                "matrix": matrix.T.ravel().tolist(),
            }
            for n, (node, matrix) in enumerate(zip(scene.nodes, matrices, strict=True))
        ]
        children = list(range(len(nodes)))
        root: dict[str, Any] = {"name": "root", "children": children}
        document |= {"nodes": [*nodes, root], "scenes": [{"nodes": [len(nodes)]}]}
    document |= {"accessors": buffer.accessors, "bufferViews": buffer.views}
    document["buffers"] = [{"byteLength": len(buffer.data)}]
    return document, buffer.data


def glb(path: Path, scene: Scene, is_instanced: bool = False) -> float:
    """Write GLB."""
    document, data = _gltf(scene, is_instanced)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data))
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    path.write_bytes(head + chunks + struct.pack("<I4s", len(data), b"BIN\0") + data)
    return SINGLE


def gltf(path: Path, scene: Scene) -> float:
    """Write glTF, with its numbers in a file next to it."""
    document, data = _gltf(scene, is_instanced=False)
    document["buffers"][0]["uri"] = f"{path.stem}.bin"
    path.with_suffix(".bin").write_bytes(data)
    path.write_text(json.dumps(document))
    return SINGLE


def collada(path: Path, scene: Scene) -> float:
    """Write COLLADA."""
    geometries, nodes = [], []
    for number, name in enumerate(scene.names):
        vertices, faces = scene.local(number), np.array(triangles_of(scene.shapes[number]))
        own = f"{name[:2]}-mesh"
        geometries.append(
            f'<geometry id="{own}" name={quoteattr(name)}><mesh><source id="{own}-p">'
            f'<float_array id="{own}-a" count="{vertices.size}">{text_of(vertices.ravel())}'
            f'</float_array><technique_common><accessor source="#{own}-a" stride="3" '
            f'count="{len(vertices)}"><param name="X" type="float"/><param name="Y" type="float"/>'
            '<param name="Z" type="float"/></accessor></technique_common></source>'
            f'<vertices id="{own}-v"><input semantic="POSITION" source="#{own}-p"/>'
            f'</vertices><triangles count="{len(faces)}"><input semantic="VERTEX" offset="0" '
            f'source="#{own}-v"/><p>{" ".join(map(str, faces.ravel()))}</p></triangles>'
            "</mesh></geometry>"
        )
    for n, node in enumerate(scene.nodes):
        own, name = scene.names[node.mesh][:2], quoteattr(f"{scene.names[node.mesh]}_{n}")
        matrix = text_of(scene.matrix(node).ravel())
        nodes.append(
            f'<node id="{own}-{n}" name={name}><matrix>{matrix}</matrix>'
            f'<instance_geometry url="#{own}-mesh"/></node>'
        )
    axis = "XYZ"[int(np.argmax(scene.up[2]))]
    path.write_text(
        '<?xml version="1.0" encoding="utf-8"?>\n<COLLADA version="1.4.1" '
        'xmlns="http://www.collada.org/2005/11/COLLADASchema"><asset><created>2026-01-01T00:00:00'
        "</created><modified>2026-01-01T00:00:00</modified>"
        f'<unit name="own" meter="{scene.unit / 1000:.10g}"/><up_axis>{axis}_UP</up_axis></asset>'
        f"<library_geometries>{''.join(geometries)}</library_geometries><library_visual_scenes>"
        f'<visual_scene id="s">{"".join(nodes)}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>\n'
    )
    return TEXT
