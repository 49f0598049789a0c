"""The outline of a 3MF file, read before lib3mf reads its meshes.

lib3mf visits every instance of an object, of which a small file can have billions, and takes a
model without a unit, or with an unknown one, to be in millimetres.
"""

from __future__ import annotations

import io
from collections import Counter
from dataclasses import dataclass
from urllib.parse import unquote
from zipfile import BadZipFile, ZipFile

from lxml import etree

from packit_sim.core.errors import MeshError
from packit_sim.libraries import mesh_limits

UUID = "{http://schemas.microsoft.com/3dmanufacturing/production/2015/06}UUID"
_PATH = UUID.replace("UUID", "path")

_Key = tuple[str, int]
"""The model of an object, and its number there."""


@dataclass(frozen=True, eq=False)
class Outline:
    """The outline of a 3MF file.

    Attributes
    ----------
    archive : ZipFile
        The archive.
    unit : str, optional
        The unit that its root model names.
    printable : list of bool
        Whether each item of the build is to be printed: slicers write so, in an attribute that the
        standard does not have.
    """

    archive: ZipFile
    unit: str | None
    printable: list[bool]


def read_outline(content: bytes) -> Outline:
    """Read the outline of a 3MF file.

    Returns
    -------
    Outline
        Its outline, within the limits of `mesh_limits`.

    Raises
    ------
    MeshError
        If its archive is broken or unpacks to too much, it has no model, or too many triangles or
        instances of objects.
    """
    archive = _open(content)
    root = _root(archive)
    triangles: dict[_Key, int] = {}
    components: dict[_Key, list[_Key]] = {}
    items: list[etree._Element] = []
    unit = None
    for name in archive.namelist():
        if not name.lower().endswith(".model"):
            continue
        with archive.open(name) as model:
            tags = ("{*}model", "{*}object", "{*}item")
            for event, element in etree.iterparse(model, events=("start", "end"), tag=tags):
                kind = etree.QName(element).localname
                if event == "start":
                    unit = element.get("unit", unit) if (kind, name) == ("model", root) else unit
                elif kind == "object":
                    key = (_path(name), int(element.get("id", 0)))
                    triangles[key] = sum(1 for _ in element.iter("{*}triangle"))
                    parts = element.iter("{*}component")
                    components[key] = [_key(part, name) for part in parts]
                    element.clear()
                elif kind == "item" and name == root:
                    items.append(element)
    targets = [_key(item, root) for item in items]
    missing = {*targets, *(key for own in components.values() for key in own)} - triangles.keys()
    if missing:
        raise MeshError(f"it shows an object {min(missing)[1]} that it does not have")
    mesh_limits.check_expanded(triangles, components, targets)
    printable = [item.get("printable", "1").strip().lower() not in ("0", "false") for item in items]
    return Outline(archive, unit, printable)


def _open(content: bytes) -> ZipFile:
    """Open an archive of which every reader sees the same: sizes are true, and names differ."""
    try:
        archive = ZipFile(io.BytesIO(content))
        unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > mesh_limits.MAX_BYTES:
            raise MeshError(f"it unpacks to {unpacked:,} bytes: at most {mesh_limits.MAX_BYTES:,}")
        broken = archive.testzip()
    except BadZipFile as error:
        raise MeshError(f"it is no ZIP archive: {error}") from error
    if broken is not None:
        raise MeshError(f"{broken!r} in its archive is broken")
    for name, count in Counter(map(_path, archive.namelist())).items():
        if count > 1:
            raise MeshError(f"its archive has {count} files {name!r}")
    return archive


def _root(archive: ZipFile) -> str:
    """Return the name of the root model."""
    targets = []
    if "_rels/.rels" in archive.namelist():
        relations = etree.fromstring(archive.read("_rels/.rels")).iter("{*}Relationship")
        targets = [
            str(each.get("Target"))
            for each in relations
            if each.get("Type", "").endswith("/2013/01/3dmodel")
        ]
    if not targets:
        raise MeshError("it names no 3D model in _rels/.rels")
    for name in archive.namelist():
        if _path(name) == _path(targets[0]):
            return name
    raise MeshError(f"its archive holds no {targets[0]}")


def _key(reference: etree._Element, name: str) -> _Key:
    """Return the key of the object that an item or a component of a model shows."""
    return _path(reference.get(_PATH, name)), int(reference.get("objectid", 0))


def _path(name: str) -> str:
    """Return a name in an archive as it is compared."""
    return unquote(name).lstrip("/").lower()
