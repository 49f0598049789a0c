"""Writing of 3MF files, exactly: lib3mf would write transforms with six digits."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from xml.sax.saxutils import escape
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.libraries.model_3mf import CONTENT_TYPES

_RELATIONS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="model"
 Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""

_MODEL = """<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en-US"
 xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">
"""

_NOT_XML = re.compile("[^\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML can't have, or lib3mf can't read."""


@dataclass(frozen=True, eq=False)
class PlacedMesh:
    """A mesh at a place.

    Attributes
    ----------
    name : str
        Its own name.
    mesh_name : str
        The name of its mesh; equal meshes have equal names, and are written once.
    vertices, triangles : numpy.ndarray
        The mesh in millimetres, (n, 3) each.
    matrix : numpy.ndarray
        Its place, (4, 4).
    """

    name: str
    mesh_name: str
    vertices: Floats
    triangles: Ints
    matrix: Floats


def encode_3mf(placed: Iterable[PlacedMesh]) -> bytes:
    """Return a 3MF file: an object for each mesh, and an item and an object for each place.

    Triangles with fewer than three corners are left out: the standard forbids them, and lib3mf
    would not read the file. An item shows the object that has its name, in which the mesh is the
    only component: slicers show the names of objects.
    """
    target = io.BytesIO()
    with ZipFile(target, "w", ZIP_DEFLATED) as archive:
        for name, text in (
            ("[Content_Types].xml", CONTENT_TYPES),
            ("_rels/.rels", _RELATIONS),
            ("3D/3dmodel.model", "".join(_model(placed))),
        ):
            archive.writestr(ZipInfo(name), text, ZIP_DEFLATED)
    return target.getvalue()


def _model(placed: Iterable[PlacedMesh]) -> Iterator[str]:
    yield f"{_MODEL}<resources>\n"
    numbers: dict[str, int] = {}
    items = []
    count = 0
    for each in placed:
        if each.mesh_name not in numbers:
            count += 1
            numbers[each.mesh_name] = count
            yield from _mesh(each, count)
        count += 1
        name = _quoted(each.name)
        yield f'<object id="{count}" type="model" name={name}><components>'
        yield f'<component objectid="{numbers[each.mesh_name]}"/></components></object>\n'
        transform = " ".join(f"{number:.12g}" for number in each.matrix[:3].T.ravel())
        items.append(f'<item objectid="{count}" partnumber={name} transform="{transform}"/>\n')
    yield "</resources>\n<build>\n"
    yield from items
    yield "</build>\n</model>\n"


def _mesh(own: PlacedMesh, number: int) -> Iterator[str]:
    yield f'<object id="{number}" type="model" name={_quoted(own.mesh_name)}><mesh>\n<vertices>\n'
    for x, y, z in own.vertices.tolist():
        yield f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>\n'
    yield "</vertices>\n<triangles>\n"
    for a, b, c in own.triangles.tolist():
        if a != b != c != a:
            yield f'<triangle v1="{a}" v2="{b}" v3="{c}"/>\n'
    yield "</triangles>\n</mesh></object>\n"


def _quoted(name: str) -> str:
    text = escape(_NOT_XML.sub("\N{REPLACEMENT CHARACTER}", name), {'"': "&quot;"})
    return f'"{text}"'
