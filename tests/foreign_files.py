"""Writers of small files as other programs write them: 3MF, STL and GLB."""

from __future__ import annotations

import json
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
TYPES = (
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" '
    'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" '
    'ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
RELATIONS = '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">{}</Relationships>'
RELATION = (
    '<Relationship Id="r{}" Target="/{}" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
)
ROOT = "3D/3dmodel.model"


def mesh_xml(mesh: trimesh.Trimesh, extra: str = "") -> str:
    points = "".join('<vertex x="{}" y="{}" z="{}"/>'.format(*p) for p in mesh.vertices.tolist())
    faces = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*f) for f in mesh.faces.tolist())
    return f"<mesh><vertices>{points}</vertices><triangles>{faces}{extra}</triangles></mesh>"


def thing(number: int, content: str, more: str = "") -> str:
    """An object; `content` is a mesh, or components."""
    return f'<object id="{number}" type="model" {more}>{content}</object>'


def at(x: float = 0, y: float = 0, z: float = 0, linear: str = "1 0 0 0 1 0 0 0 1") -> str:
    return f'transform="{linear} {x} {y} {z}"'


def items(*targets: tuple[int, str]) -> str:
    return "".join(f'<item objectid="{number}" {more}/>' for number, more in targets)


def components(*targets: tuple[int, str]) -> str:
    inside = "".join(f'<component objectid="{number}" {more}/>' for number, more in targets)
    return f"<components>{inside}</components>"


def model(resources: str, build: str, unit: str = "millimeter") -> str:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><model unit="{unit}" xmlns="{CORE}" xmlns:p='
        f'"{PRODUCTION}"><resources>{resources}</resources><build>{build}</build></model>'
    )


def package(file: Path, root: str, **models: str) -> Path:
    """Write a 3MF file; other models are in 3D/Objects."""
    own = {f"3D/Objects/{name}.model": text for name, text in models.items()}
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", TYPES)
        archive.writestr("_rels/.rels", RELATIONS.format(RELATION.format(0, ROOT)))
        archive.writestr(ROOT, root)
        if own:
            to = "".join(RELATION.format(n, name) for n, name in enumerate(own))
            archive.writestr("3D/_rels/3dmodel.model.rels", RELATIONS.format(to))
        for name, text in own.items():
            archive.writestr(name, text)
    return file


def binary_stl(file: Path, triangles: Any, count: int | None = None, header: bytes = b"") -> Path:
    corners = np.asarray(triangles, dtype="<f4").reshape(-1, 3, 3)
    records = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    records["v"] = corners
    number = struct.pack("<I", len(corners) if count is None else count)
    file.write_bytes(header.ljust(80, b"\0") + number + records.tobytes())
    return file


def ascii_stl(name: str, mesh: trimesh.Trimesh) -> str:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join("vertex {:.6f} {:.6f} {:.6f}\n".format(*p) for p in triangle)
        + "endloop\nendfacet\n"
        for triangle in mesh.triangles.tolist()
    )
    return f"solid {name}\n{facets}endsolid {name}\n"


def block_glb() -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary data of a GLB of a block of 30 x 20 x 10 mm."""
    content = trimesh.creation.box((0.03, 0.02, 0.01)).export(file_type="glb")
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def write_glb(file: Path, header: dict[str, Any], binary: bytes) -> Path:
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    file.write_bytes(
        struct.pack("<4sII", b"glTF", 2, size)
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(binary), b"BIN\0")
        + binary
    )
    return file
