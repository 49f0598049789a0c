"""Projects in the layouts of slicers, written anew from their public formats: small boxes only."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
_MATERIAL = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
_MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_TEXTURE_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dtexture"
_THUMBNAIL_TYPE = "http://schemas.openxmlformats.org/package/2006/relationships/metadata/thumbnail"
_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
<Default Extension="png" ContentType="image/png"/>
<Default Extension="config" ContentType="text/xml"/>
<Default Extension="gcode" ContentType="text/x.gcode"/></Types>"""
_FACES = (
    *((0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4)),
    *((1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)),
)

Corners = tuple[Sequence[float], Sequence[float]]


def mesh(*boxes: Corners, triangle: str = "") -> str:
    """A mesh of boxes, each by its lowest and highest corner."""
    vertices, triangles = "", ""
    for n, ((x, y, z), (u, v, w)) in enumerate(boxes):
        for corner in ((x, y), (u, y), (u, v), (x, v)):
            vertices += f'<vertex x="{corner[0]}" y="{corner[1]}" z="{z}"/>'
        for corner in ((x, y), (u, y), (u, v), (x, v)):
            vertices += f'<vertex x="{corner[0]}" y="{corner[1]}" z="{w}"/>'
        for face in _FACES:
            a, b, c = (8 * n + corner for corner in face)
            triangles += f'<triangle v1="{a}" v2="{b}" v3="{c}"{triangle}/>'
    return f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>"


CUBE = mesh(((-10, -10, -10), (10, 10, 10)))
ROD = mesh(((-5, -5, -10), (5, 5, 10)))


def shift(x: float, y: float = 0, z: float = 0, linear: str = "1 0 0 0 1 0 0 0 1") -> str:
    return f'transform="{linear} {x} {y} {z}"'


def model(
    resources: str, build: str, *, root: str = "", unit: str = "millimeter", metadata: str = ""
) -> str:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="{unit}" xml:lang="en-US" '
        f'xmlns="{_CORE}" {root}>{metadata}<resources>{resources}</resources>{build}</model>'
    )


def relations(*targets: tuple[str, str]) -> str:
    rows = "".join(
        f'<Relationship Target="{target}" Id="rel-{n}" Type="{kind}"/>'
        for n, (target, kind) in enumerate(targets, 1)
    )
    namespace = "http://schemas.openxmlformats.org/package/2006/relationships"
    return f'<Relationships xmlns="{namespace}">{rows}</Relationships>'


def png() -> bytes:
    """A picture of one pixel."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        crc = zlib.crc32(kind + data).to_bytes(4, "big")
        return len(data).to_bytes(4, "big") + kind + data + crc

    header = (1).to_bytes(4, "big") * 2 + bytes((8, 2, 0, 0, 0))
    data = zlib.compress(b"\0\xff\xff\xff")
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    )


def write(file: Path, files: dict[str, str | bytes]) -> None:
    """Write an archive with what all slicers add: content types, a thumbnail, relations."""
    every: dict[str, str | bytes] = {
        "[Content_Types].xml": _TYPES,
        "_rels/.rels": relations(
            ("/3D/3dmodel.model", _MODEL_TYPE), ("/Metadata/thumbnail.png", _THUMBNAIL_TYPE)
        ),
        "Metadata/thumbnail.png": png(),
    }
    with ZipFile(file, "w", ZIP_DEFLATED) as archive:
        for name, content in {**every, **files}.items():
            archive.writestr(name, content)


def prusa(file: Path) -> None:
    """A bracket with a modifier and a support blocker in its mesh, three times, once hidden."""
    solid, modifier, blocker = (
        ((0, 0, 0), (20, 10, 5)),
        ((5, 2, 0), (8, 8, 30)),
        ((0, 0, 0), (1, 1, 1)),
    )
    resources = (
        f'<object id="1" type="model">{mesh(solid, modifier, blocker)}</object>'
        f'<object id="2" type="model">{mesh(((0, 0, 0), (4, 4, 4)))}</object>'
    )
    build = "".join(
        f'<item objectid="{n}" {shift(x, 50)} printable="{printable}"/>'
        for n, x, printable in ((1, 20, 1), (1, 60, 1), (1, 100, 0), (2, 150, 1))
    )
    volumes = "".join(
        f'<volume firstid="{12 * n}" lastid="{12 * n + 11}">'
        f'<metadata type="volume" key="name" value="{name}"/>'
        f'<metadata type="volume" key="volume_type" value="{kind}"/>'
        '<metadata type="volume" key="matrix" value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></volume>'
        for n, (name, kind) in enumerate(
            (("bracket", "ModelPart"), ("dense", "ParameterModifier"), ("no", "SupportBlocker"))
        )
    )
    config = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<config><object id="1" instances_count="3">'
        f'<metadata type="object" key="name" value="Träger.stl"/>{volumes}</object>'
        '<object id="2" instances_count="1"><metadata type="object" key="name" value="шайба"/>'
        '<volume firstid="0" lastid="11"><metadata type="volume" key="volume_type" '
        'value="ModelPart"/></volume></object></config>'
    )
    metadata = (
        '<metadata name="slic3rpe:Version3mf">1</metadata>'
        '<metadata name="Title">plate</metadata><metadata name="Application">P-2.9</metadata>'
    )
    root = 'xmlns:slic3rpe="http://schemas.slic3r.org/3mf/2017/06"'
    write(
        file,
        {
            "3D/3dmodel.model": model(
                resources, f"<build>{build}</build>", root=root, metadata=metadata
            ),
            "Metadata/Slic3r_PE_model.config": config,
            "Metadata/Slic3r_PE.config": "; layer_height = 0.2\n",
        },
    )


def production(
    file: Path,
    meshes: Sequence[Sequence[tuple[int, str, str]]],
    objects: Sequence[tuple[int, str, Sequence[tuple[int, int, str, str]]]],
    items: Sequence[tuple[int, str, int]],
) -> None:
    """A project whose meshes are in files of their own.

    `meshes` are the objects of each such file (id, mesh, type); `objects` those of the root model
    (id, name, components), with the file, object, transform and subtype of each component; `items`
    are objects, transforms and whether they are printed. Every file counts its UUIDs anew.
    """
    root = f'xmlns:p="{_PRODUCTION}" requiredextensions="p"'

    def uuid(number: int) -> str:
        return f'p:UUID="{number:08x}-61cb-4c03-9d28-80fed5dfa1dc"'

    files: dict[str, str | bytes] = {}
    for n, own in enumerate(meshes, 1):
        each = "".join(
            f'<object id="{id}" {uuid(id)} type="{kind}">{shape}</object>'
            for id, shape, kind in own
        )
        files[f"3D/Objects/object_{n}.model"] = model(each, "<build/>", root=root)
    resources, settings, number = "", "", 100
    for id, name, components in objects:
        rows, parts = "", ""
        for target, part, place, kind in components:
            number += 1
            rows += (
                f'<component p:path="/3D/Objects/object_{target}.model" objectid="{part}" '
                f"{uuid(number)} {place}/>"
            )
            parts += (
                f'<part id="{part}" subtype="{kind}"><metadata key="name" value="{kind}"/>'
                '<metadata key="matrix" value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></part>'
            )
        resources += f'<object id="{id}" {uuid(1000 + id)} type="model">'
        resources += f"<components>{rows}</components></object>"
        settings += f'<object id="{id}"><metadata key="name" value="{name}"/>{parts}</object>'
    build = "".join(
        f'<item objectid="{id}" {uuid(2000 + n)} {place} printable="{printable}"/>'
        for n, (id, place, printable) in enumerate(items)
    )
    plate = '<plate><metadata key="plater_id" value="1"/></plate>'
    metadata = '<metadata name="BambuStudio:3mfVersion">1</metadata>'
    files |= {
        "3D/3dmodel.model": model(
            resources,
            f"<build {uuid(3000)}>{build}</build>",
            root=f'{root} xmlns:BambuStudio="http://schemas.bambulab.com/package/2021"',
            metadata=metadata,
        ),
        "3D/_rels/3dmodel.model.rels": relations(
            *((f"/3D/Objects/object_{n}.model", _MODEL_TYPE) for n in range(1, len(meshes) + 1))
        ),
        "Metadata/model_settings.config": (
            f'<?xml version="1.0" encoding="UTF-8"?>\n<config>{settings}{plate}</config>'
        ),
        "Metadata/project_settings.config": "{}",
        "Metadata/plate_1.gcode": "G28\n",
    }
    write(file, files)


def orca(file: Path) -> None:
    """A cube, its clone and a third that is hidden; an angle of two with a modifier, turned."""
    normal, modifier = "normal_part", "modifier_part"
    turned = "0 1 0 -1 0 0 0 0 1"
    production(
        file,
        [
            [(1, CUBE, "model")],
            [(2, CUBE, "model"), (3, ROD, "model"), (4, CUBE, "other"), (5, CUBE, "model")],
        ],
        [
            (6, "cube", [(1, 1, shift(0), normal)]),
            (7, "cube copy", [(1, 1, shift(0), normal)]),
            (
                8,
                "Winkel groß",
                [
                    (2, 2, shift(0), normal),
                    (2, 3, shift(0, 0, 20), normal),
                    (2, 4, shift(0, 0, 90), "support_blocker"),
                    (2, 5, shift(0, 0, 50), modifier),
                ],
            ),
        ],
        [
            (6, shift(50, 60, 10), 1),
            (7, shift(110, 60, 10), 1),
            (7, shift(170, 60, 10), 0),
            (8, shift(60.5, 140.25, 10), 1),
            (8, shift(120, 140, 10), 1),
            (8, shift(180, 140, 10, turned), 1),
        ],
    )


def bambu(file: Path) -> None:
    """Two object files whose objects have the same number and the same identifier."""
    production(
        file,
        [[(1, CUBE, "model")], [(1, ROD, "model")]],
        [
            (2, "кубик", [(1, 1, shift(0), "normal_part")]),
            (3, "杆", [(2, 1, shift(0), "normal_part")]),
        ],
        [(2, shift(50, 60, 10), 1), (3, shift(110, 60, 10), 1), (3, shift(350, 60, 10), 1)],
    )


def cura(file: Path) -> None:
    """A group of two parts, a part that is scaled and mirrored, and a mesh that blocks supports."""

    def settings(**values: str) -> str:
        rows = "".join(
            f'<metadata name="cura:{name}" preserve="1" type="xs:string">{value}</metadata>'
            for name, value in values.items()
        )
        return f"<metadatagroup>{rows}</metadatagroup>"

    plain = settings(drop_to_buildplate="True", extruder_nr="0")
    resources = (
        f'<object id="1" name="a.stl" type="model">{plain}{CUBE}</object>'
        f'<object id="2" name="b.stl" type="model">{plain}{ROD}</object>'
        '<object id="3" name="Group #1" type="model"><components>'
        f'<component objectid="1"/><component objectid="2" {shift(0, 0, 20)}/></components>'
        '</object><object id="4" name="stop" type="model">'
        f"{settings(anti_overhang_mesh='True')}{CUBE}</object>"
    )
    build = (
        f'<item objectid="3" {shift(110, 110, 10)}/>'
        f'<item objectid="2" {shift(30, 30, 20, "-1 0 0 0 2 0 0 0 2")}/>'
        f'<item objectid="4" {shift(30, 30, 20)}/>'
    )
    root = 'xmlns:cura="http://software.ultimaker.com/xml/cura/3mf/2015/10"'
    metadata = '<metadata name="Application">U</metadata><metadata name="cura:x">y</metadata>'
    write(
        file,
        {
            "3D/3dmodel.model": model(
                resources, f"<build>{build}</build>", root=root, metadata=metadata
            ),
            "Cura/plugin.cfg": "[a]\nb=1\n",
            "Metadata/packages.json": "{}",
        },
    )


def builder(file: Path) -> None:
    """A coloured and a textured part in inches, components within components, a surface."""
    textured = mesh(((0, 0, 0), (1, 2, 3)), triangle=' pid="4" p1="0" p2="0" p3="0"')
    resources = (
        '<basematerials id="1"><base name="red" displaycolor="#FF0000FF"/></basematerials>'
        '<m:colorgroup id="2"><m:color color="#00FF00FF"/></m:colorgroup>'
        '<m:texture2d id="3" path="/3D/Textures/a.png" contenttype="image/png"/>'
        '<m:texture2dgroup id="4" texid="3"><m:tex2coord u="0" v="0"/></m:texture2dgroup>'
        f'<object id="5" type="model" pid="1" pindex="0">{mesh(((0, 0, 0), (1, 1, 1)))}</object>'
        f'<object id="6" type="model" name="b">{textured}</object>'
        f'<object id="7" type="model"><components><component objectid="5" {shift(0, 0, 3)}/>'
        "</components></object>"
        '<object id="8" type="model" name="Tower &amp; co"><components><component objectid="6"/>'
        '<component objectid="7"/></components></object>'
        f'<object id="9" type="surface">{mesh(((0, 0, 0), (9, 9, 9)))}</object>'
    )
    build = (
        f'<item objectid="8" {shift(1, 2, 3)}/><item objectid="9"/><item objectid="5" {shift(8)}/>'
    )
    write(
        file,
        {
            "3D/3dmodel.model": model(
                resources,
                f"<build>{build}</build>",
                root=f'xmlns:m="{_MATERIAL}" requiredextensions="m"',
                unit="inch",
            ),
            "3D/_rels/3dmodel.model.rels": relations(("/3D/Textures/a.png", _TEXTURE_TYPE)),
            "3D/Textures/a.png": png(),
        },
    )


Part = tuple[str, int, float, tuple[float, float, float]]

PROJECTS: dict[str, tuple[Callable[[Path], None], float, list[Part], list[str]]] = {
    "prusa": (
        prusa,
        0.1,
        [("Träger.stl", 2, 1000, (20, 10, 5)), ("шайба", 1, 64, (4, 4, 4))],
        ["not printable, left out: 'Träger.stl'", "without .* support volumes: 'Träger.stl'"],
    ),
    "orca": (
        orca,
        0.1,
        [
            ("cube", 2, 8000, (20, 20, 20)),
            ("Winkel groß", 2, 10_000, (20, 20, 40)),
            ("Winkel groß", 1, 10_000, (20, 20, 40)),
        ],
        ["not printable, left out: 'cube copy'", "without .* support volumes: 'Winkel groß'"],
    ),
    "bambu": (bambu, 0.1, [("кубик", 1, 8000, (20,) * 3), ("杆", 2, 2000, (10, 10, 20))], []),
    "cura": (
        cura,
        0.1,
        [("Group #1", 1, 10_000, (20, 20, 40)), ("b.stl", 1, 8000, (10, 20, 40))],
        ["no solid .*, left out: 'stop'"],
    ),
    "builder": (
        builder,
        2.54,
        [("Tower & co", 1, 7, (1, 2, 4)), ("3", 1, 1, (1, 1, 1))],
        ["no solid .*, left out: 'item 2'"],
    ),
}
"""Each project: its writer; its unit in cm; the name, count, volume and extents of each part; and
patterns of the notes."""
