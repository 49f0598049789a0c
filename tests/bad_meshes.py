"""Mesh files that are broken or malicious, and the expected message for each."""

from __future__ import annotations

import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from trimesh import creation

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
MODEL = """<?xml version="1.0"?>
<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">
<resources>{}</resources><build>{}</build></model>"""
TETRAHEDRON = (
    '<mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/>'
    '<vertex x="0" y="1" z="0"/><vertex x="0" y="0" z="1"/></vertices><triangles>'
    '<triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/>'
    '<triangle v1="0" v2="3" v3="2"/><triangle v1="1" v2="2" v3="3"/></triangles></mesh>'
)


PACKAGE = {
    "[Content_Types].xml": '<Types xmlns="http://schemas.openxmlformats.org/package/2006/'
    'content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-package.'
    'relationships+xml"/><Default Extension="model" ContentType="application/vnd.ms-package.'
    '3dmanufacturing-3dmodel+xml"/></Types>',
    "_rels/.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/'
    'relationships"><Relationship Target="/3D/3dmodel.model" Id="r" Type="http://schemas.microsoft.'
    'com/3dmanufacturing/2013/01/3dmodel"/></Relationships>',
}
"""Files of every 3MF archive."""


def package(files: dict[str, str | bytes]) -> Callable[[Path], None]:
    """A 3MF archive with these files, and what every one has."""

    def write(file: Path) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in {**PACKAGE, **files}.items():
                archive.writestr(name, content)

    return write


def archive(resources: str, build: str) -> Callable[[Path], None]:
    return package({"3D/3dmodel.model": MODEL.format(resources, build)})


def zip_bomb(file: Path) -> None:
    with (
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("3D/3dmodel.model", "w") as model,
    ):
        for _ in range(1200):
            model.write(b" " * 2**20)


def laughs(depth: int) -> Callable[[Path], None]:
    """Objects of ten of the object before, so many deep."""
    objects = [f'<object id="1">{TETRAHEDRON}</object>']
    for n in range(2, depth + 2):
        parts = f'<component objectid="{n - 1}"/>' * 10
        objects.append(f'<object id="{n}"><components>{parts}</components></object>')
    return archive("".join(objects), f'<item objectid="{depth + 1}"/>')


DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/>
<library_nodes>{}</library_nodes><library_visual_scenes><visual_scene id="s"><node id="root">
<instance_node url="#n{}"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def laughing_nodes(depth: int) -> Callable[[Path], None]:
    """Nodes of ten of the node before, so many deep."""
    nodes = "".join(
        f'<node id="n{n}">{f"""<instance_node url="#n{n - 1}"/>""" * 10}</node>'
        for n in range(1, depth + 1)
    )
    return text(DAE.format(f'<node id="n0"/>{nodes}', depth))


def stl(vertices: object) -> Callable[[Path], None]:
    """A binary STL with these corners of triangles, three of them each."""
    corners = np.asarray(vertices, dtype="<f4").reshape(-1, 3, 3)
    rows = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows["v"] = corners
    return data(b"\0" * 80 + struct.pack("<I", len(rows)) + rows.tobytes())


def gltf(accessors: list[dict[str, object]], uri: str) -> Callable[[Path], None]:
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": 36, "uri": uri}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": accessors,
    }
    return text(json.dumps(content))


def text(content: str) -> Callable[[Path], None]:
    return data(content.encode())


def data(content: bytes) -> Callable[[Path], None]:
    def write(file: Path) -> None:
        file.write_bytes(content)

    return write


BOX = creation.box((1, 2, 3)).triangles
POSITIONS = {"componentType": 5126, "type": "VEC3"}
PLY = (
    "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
    "property float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n"
)

FACET = (
    "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
)

BAD: dict[str, tuple[Callable[[Path], None], str]] = {
    **{f"empty{s}": (text(""), "the file is empty") for s in (".stl", ".obj", ".glb", ".3mf")},
    "blank.off": (text(" \n\n"), "the file is empty"),
    "noise.stl": (data(bytes(range(256)) * 9), "not ASCII, and 2,304 bytes"),
    "noise.3mf": (data(bytes(range(256)) * 9), "no ZIP archive"),
    "noise.glb": (data(bytes(range(256)) * 9), "does not begin as a GLB"),
    "noise.dae": (data(bytes(range(256)) * 9), "can't be read as DAE"),
    "words.ply": (text("once upon a time"), "no end_header"),
    "words.off": (text("OFF\nonce upon a time"), "no line of counts"),
    "words.gltf": (text("once upon a time"), "can't be read as GLTF"),
    "list.gltf": (text("[]"), "its JSON is not an object"),
    "points.obj": (text("v 0 0 0\nv 1 2 3\n"), "no faces"),
    "nan.stl": (stl(np.where(np.arange(108) == 50, np.nan, BOX.ravel())), "not finite"),
    "infinite.obj": (text(OBJ.replace("v 1 0 0", "v inf 0 0")), "not finite"),
    "degenerate.stl": (stl(np.repeat(BOX[:, :1], 3, axis=1)), "none of its 12 triangles|no extent"),
    "point.stl": (stl(np.zeros((12, 9))), "no extent along x and y and z"),
    "one-triangle.stl": (stl([0, 0, 0, 1, 0, 0, 0, 1, 0]), "no extent along z"),
    "beyond.obj": (text(OBJ + "f 1 2 99\n"), "beyond.obj"),
    "before.obj": (text(OBJ + "f 1 2 -5\n"), "vertex -5, after 4 vertices"),
    "zero.obj": (text(OBJ + "f 0//1 2 3\n"), "vertex 0, after 4 vertices"),
    "beyond.off": (text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"), "face index"),
    "many.ply": (
        text(PLY.format("ascii", 10_000_000, 4) + "0 0 0\n" * 50),
        "declares 10,000,000 elements 'vertex'",
    ),
    "many-binary.ply": (
        text(PLY.format("binary_little_endian", 10_000_000, 4) + " " * 700),
        "declares 10,000,000 elements 'vertex'",
    ),
    "short.ply": (
        text(PLY.format("ascii", 4, 4) + "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n"),
        "only 5 lines",
    ),
    "many.off": (
        text("OFF\n10000000 10000000 0\n" + "0 0 0\n" * 50),
        "declares 10,000,000 vertices",
    ),
    "cut.stl": (
        text("solid s\n" + FACET + FACET + FACET[: len(FACET) // 2]),
        "holds no triangles",
    ),
    "many.stl": (
        data(b"\0" * 80 + struct.pack("<I", 10_000_000) + b"\0" * 900),
        "not ASCII, and 984 bytes",
    ),
    "many.gltf": (
        gltf([POSITIONS | {"count": 10_000_000}], "data:;base64," + "A" * 48),
        "10,000,000 elements without data",
    ),
    "elsewhere.gltf": (
        gltf([POSITIONS | {"count": 3, "bufferView": 0}], "../../../../etc/passwd"),
        "which is not in its folder",
    ),
    "bomb.3mf": (zip_bomb, "unpacks to 1,258,2"),
    "laughs.3mf": (laughs(9), "triangles are too many"),
    "circle.3mf": (
        archive(
            '<object id="1"><components><component objectid="1"/></components></object>',
            '<item objectid="1"/>',
        ),
        "a part of itself",
    ),
    "deep.3mf": (
        archive(
            f'<object id="1">{TETRAHEDRON}</object>'
            + "".join(
                f'<object id="{n}"><components><component objectid="{n - 1}"/></components>'
                "</object>"
                for n in range(2, 5000)
            ),
            '<item objectid="4999"/>',
        ),
        "nested more than 200 deep",
    ),
    "crowd.3mf": (
        archive(f'<object id="1">{TETRAHEDRON}</object>', '<item objectid="1"/>' * 20_000),
        "20,000 instances of objects are too many",
    ),
    "laughs-of-nothing.3mf": (
        archive(
            '<object id="1"><mesh><vertices/><triangles/></mesh></object>'
            + "".join(
                f'<object id="{n}"><components>{f"""<component objectid="{n - 1}"/>""" * 10}'
                "</components></object>"
                for n in range(2, 11)
            ),
            '<item objectid="10"/>',
        ),
        "111,111,111 components are too many: at most 20,000",
    ),
    "bare.3mf": (package({"_rels/.rels": "<a/>"}), "names no 3D model in _rels/.rels"),
    "twins.3mf": (
        package({"3D/3dmodel.model": "<a/>", "3d/3DModel.model": "<a/>"}),
        "its archive has 2 files '3d/3dmodel.model'",
    ),
    "gone.3mf": (package({}), "its archive holds no /3D/3dmodel.model"),
    "flat.3mf": (
        archive(
            f'<object id="1">{TETRAHEDRON}</object>',
            '<item objectid="1" transform="1 0 0 0 1 0 0 0 0 0 0 0"/>',
        ),
        "flattens its object",
    ),
    "furlongs.3mf": (
        package(
            {
                "3D/3dmodel.model": MODEL.format("", "").replace(
                    'unit="millimeter"', 'unit="furlong"'
                )
            }
        ),
        "its unit 'furlong' is none of micron, millimeter,",
    ),
    "extended.3mf": (
        package(
            {
                "3D/3dmodel.model": MODEL.format(
                    f'<object id="1">{TETRAHEDRON}</object>', '<item objectid="1"/>'
                ).replace("<model", '<model xmlns:q="http://q.example" requiredextensions="q"')
            }
        ),
        "requires an extension of 3MF that lib3mf does not read",
    ),
    "laughs.dae": (laughing_nodes(9), "1,111,111,112 instances of objects are too many"),
    "circle.dae": (
        text(DAE.format('<node id="n0"><instance_node url="#n0"/></node>', 0)),
        "a part of itself",
    ),
    "materials.obj": (
        text(OBJ + "".join(f"usemtl m{n}\nf 1 2 3\n" for n in range(20_000))),
        "20,000 materials of one object are too many",
    ),
    "solids.stl": (text(f"solid s\n{FACET}endsolid s\n" * 5000), "5,000 solids are too many"),
    "hollow.3mf": (archive("", ""), "it has no part to print"),
    "entities.dae": (
        text(
            '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaaaaaaaaaaaaaaaaaa">'
            + "".join(
                f'<!ENTITY {b} "{f"&{a};" * 30}">'
                for a, b in zip("abcdefg", "bcdefgh", strict=True)
            )
            + "]><COLLADA>&h;</COLLADA>"
        ),
        "can't be read as DAE",
    ),
}
"""What writes each file, and a pattern that its error must match."""

GOOD: dict[str, Callable[[Path], None]] = {
    "flipped.stl": stl(np.where(np.arange(12)[:, None, None] % 3 == 0, BOX[:, ::-1], BOX)),
    "path.obj": text("mtllib ../../../../../../etc/passwd\nmtllib /dev/zero\n" + OBJ),
    "tasse-bol-杯.obj": text(OBJ),
    "two words.3mf": laughs(1),
    "giggles.3mf": laughs(2),
}
"""Files that look worse than they are."""


def write(folder: Path, names: list[str]) -> None:
    for name in names:
        (BAD[name][0] if name in BAD else GOOD[name])(folder / name)
