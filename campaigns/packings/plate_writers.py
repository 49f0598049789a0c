"""Writers of 3MF files, by the specifications of its core and of the production extension."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from campaigns.packings.mesh_writers import TEXT, triangles_of
from campaigns.packings.scenes import Scene
from campaigns.packings.shapes import Floats, Shape

UNITS = {
    "micron": 1e-3,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1000.0,
}
"""Millimetres in the units of 3MF."""

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'

_TYPES = (
    f'{_HEAD}<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" '
    'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" '
    'ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)


def _relationships(targets: Sequence[str]) -> str:
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    entries = "".join(
        f'<Relationship Target="{target}" Id="rel-{n}" Type="{kind}"/>'
        for n, target in enumerate(targets)
    )
    space = "http://schemas.openxmlformats.org/package/2006/relationships"
    return f'{_HEAD}<Relationships xmlns="{space}">{entries}</Relationships>'


def _mesh(shape: Shape, vertices: Floats) -> str:
    corners = "".join(f'<vertex x="{x:.10g}" y="{y:.10g}" z="{z:.10g}"/>' for x, y, z in vertices)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles_of(shape))
    return f"<mesh><vertices>{corners}</vertices><triangles>{faces}</triangles></mesh>"


def _transform(matrix: Floats) -> str:
    rows = matrix[:3].T  # points are rows
    return " ".join(f"{each:.10g}" for each in rows.ravel())


def _uuid(number: int) -> str:
    return f'p:UUID="{number:08d}-0000-4000-8000-000000000000"'


def _model(unit: str | None, resources: str, build: str, is_production: bool) -> str:
    own = f' unit="{unit}"' if unit else ""
    more = f' xmlns:p="{_PRODUCTION}" requiredextensions="p"' if is_production else ""
    return (
        f'{_HEAD}<model{own} xml:lang="en-US" xmlns="{_CORE}"{more}>'
        f"<resources>{resources}</resources>{build}</model>"
    )


def _write(path: Path, files: Mapping[str, str]) -> None:
    root = {"[Content_Types].xml": _TYPES, "_rels/.rels": _relationships(["/3D/3dmodel.model"])}
    with ZipFile(path, "w", ZIP_DEFLATED) as archive:
        for name, text in (root | dict(files)).items():
            archive.writestr(name, text)


def _items(scene: Scene, ids: Sequence[int], is_production: bool) -> str:
    items = []
    for n, node in enumerate(scene.nodes):
        more = f" {_uuid(900 + n)}" if is_production else ""
        if is_production or not node.is_printed:
            more += f' printable="{int(node.is_printed)}"'
        matrix = _transform(scene.matrix(node))
        items.append(f'<item objectid="{ids[node.mesh]}" transform="{matrix}"{more}/>')
    more = f" {_uuid(800)}" if is_production else ""
    return f"<build{more}>{''.join(items)}</build>"


def core_3mf(
    path: Path, scene: Scene, unit: str | None, assembled: Mapping[int, Sequence[Shape]]
) -> float:
    """Write 3MF as its core specification.

    Parameters
    ----------
    unit : str, optional
        The name of the unit; None leaves it out.
    assembled : mapping of int to sequence of Shape
        The bodies of the meshes that are written as components, by the number of the mesh.

    Returns
    -------
    float
        The relative rounding of coordinates.
    """
    resources, ids, following = "", [], 1
    for number, name in enumerate(scene.names):
        shapes = assembled.get(number, [scene.shapes[number]])
        parts = []
        for shape in shapes:
            low = shape.vertices.min(axis=0) if number in assembled else np.zeros(3)
            place = np.eye(4)
            place[:3, 3] = low * scene.inner
            own = f" name={quoteattr(name)}" if number not in assembled else ""
            mesh = _mesh(shape, (shape.vertices - low) * scene.inner)
            resources += f'<object id="{following}" type="model"{own}>{mesh}</object>'
            parts.append((following, place))
            following += 1
        if number in assembled:
            components = "".join(
                f'<component objectid="{own_id}" transform="{_transform(place)}"/>'
                for own_id, place in parts
            )
            resources += (
                f'<object id="{following}" type="model" name={quoteattr(name)}>'
                f"<components>{components}</components></object>"
            )
            following += 1
        ids.append(following - 1)
    spare = _mesh(scene.shapes[0], scene.local(0) * 3)  # in no build item, so that it is no part
    resources += f'<object id="{following}" type="model" name="spare">{spare}</object>'
    _write(path, {"3D/3dmodel.model": _model(unit, resources, _items(scene, ids, False), False)})
    return TEXT


def production_3mf(
    path: Path, scene: Scene, unit: str, assembled: Mapping[int, Sequence[Shape]]
) -> float:
    """Write 3MF as slicers do for projects: each object's meshes in a file of their own.

    The arguments are those of `core_3mf`.
    """
    files, resources, ids, targets = {}, "", [], []
    for number, name in enumerate(scene.names):
        target = f"/3D/Objects/object_{number + 1}.model"
        targets.append(target)
        inner, components = "", ""
        for own_id, shape in enumerate(assembled.get(number, [scene.shapes[number]]), start=1):
            middle = shape.vertices.mean(axis=0)
            place = np.eye(4)
            place[:3, 3] = middle * scene.inner
            mesh = _mesh(shape, (shape.vertices - middle) * scene.inner)
            own = _uuid(100 * number + own_id)
            inner += f'<object id="{own_id}" {own} type="model">{mesh}</object>'
            components += (
                f'<component p:path="{target}" objectid="{own_id}" '
                f'{_uuid(400 + 100 * number + own_id)} transform="{_transform(place)}"/>'
            )
        if number == 0:  # a mesh that no component asks for
            mesh = _mesh(scene.shapes[0], scene.local(0) * 2)
            inner += f'<object id="77" {_uuid(77)} type="model">{mesh}</object>'
        files[target[1:]] = _model(unit, inner, "<build/>", True)
        ids.append(50 + number)
        resources += (
            f'<object id="{50 + number}" {_uuid(700 + number)} type="model" '
            f"name={quoteattr(name)}><components>{components}</components></object>"
        )
    files["3D/3dmodel.model"] = _model(unit, resources, _items(scene, ids, True), True)
    files["3D/_rels/3dmodel.model.rels"] = _relationships(targets)
    _write(path, files)
    return TEXT
