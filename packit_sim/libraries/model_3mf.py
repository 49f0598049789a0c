"""The contents of 3MF files, read by lib3mf: a build of items, and the objects that they show."""

from __future__ import annotations

import ctypes
import io
from dataclasses import dataclass, field
from typing import Any
from zipfile import ZIP_STORED, ZipFile

import numpy as np
from lxml import etree

from packit_sim.core.errors import MeshError
from packit_sim.core.length_units import UNITS_CM
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.libraries.outline_3mf import UUID, Outline

_UNITS = ("micron", "millimeter", "centimeter", "inch", "foot", "meter")
"""The units of 3MF, in the order of `UNITS_CM`."""

_NO_GEOMETRY = (32798, 32860, 32935, 32942, 32944, 32957)
"""lib3mf's warnings of what is checked here, or changes no shape: the unit, repeated metadata,
unknown attributes and metadata (slicers write both), a missing UUID, items of the type "other"."""

_UNSUPPORTED = 32914
"""lib3mf's warning of a required extension that it does not know."""

_NO_SOLID = ("anti_overhang_mesh", "cutting_mesh", "infill_mesh", "support_mesh")
"""Cura's settings of objects that are no solids."""

_TYPES = "[Content_Types].xml"

CONTENT_TYPES = (
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" '
    'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" '
    'ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
"""The list of types in every 3MF archive."""


@dataclass(frozen=True, eq=False)
class Object3MF:
    """An object of a model: a mesh, or other objects as its components.

    Attributes
    ----------
    name : str
        Its name, or "".
    kind : str
        Its type, or why it is no solid; only a "model" is one.
    id : int, optional
        Its number in the root model; None for objects of other models in the archive.
    file_id : int
        Its number in its own model.
    vertices, triangles : numpy.ndarray
        Its mesh, (n, 3) each; empty for an object of components.
    components : tuple
        The key of each component's object, and the matrix (4, 4) of its place.
    """

    name: str
    kind: str
    id: int | None
    file_id: int
    vertices: Floats = field(default_factory=lambda: np.empty((0, 3)))
    triangles: Ints = field(default_factory=lambda: np.empty((0, 3), dtype=np.int64))
    components: tuple[tuple[int, Floats], ...] = ()


@dataclass(frozen=True, eq=False)
class Item3MF:
    """An item of a build: an object's key, the matrix (4, 4) of its place, whether to print it."""

    key: int
    matrix: Floats
    is_printable: bool


@dataclass(frozen=True, eq=False)
class Model3MF:
    """A 3MF file's objects by their keys, its build, its unit in cm, and notes for the user.

    Attributes
    ----------
    degenerate : int
        The number of triangles with fewer than three corners, which were left out.
    """

    objects: dict[int, Object3MF]
    items: tuple[Item3MF, ...]
    unit_cm: float
    notes: tuple[str, ...]
    degenerate: int


def read_model(outline: Outline, content: bytes) -> Model3MF:
    """Read a 3MF file.

    Parameters
    ----------
    content : bytes
        Its bytes.

    Returns
    -------
    Model3MF
        What it holds.

    Raises
    ------
    MeshError
        If it can't be read, or if a part of its geometry can't.
    """
    unit = outline.unit or "millimeter"
    if unit not in _UNITS:
        raise MeshError(f"its unit {unit!r} is none of {', '.join(_UNITS)}")
    model, notes, degenerate = _open(outline.archive, content)
    if outline.unit is None:
        notes.append("it names no unit: millimetres, as the standard says")
    objects = {}
    found, root = model.GetObjects(), model.RootModelPart().GetPath()
    while found.MoveNext():
        each = found.GetCurrentObject()
        objects[each.GetUniqueResourceID()] = _object(each, root)
    items = []
    build, flags = model.GetBuildItems(), outline.printable
    if build.Count() != len(flags):
        raise MeshError(f"only {build.Count():,} of its {len(flags):,} items could be read")
    for flag in flags:
        build.MoveNext()
        item = build.GetCurrent()
        key, place = item.GetObjectResource().GetUniqueResourceID(), item.GetObjectTransform()
        items.append(Item3MF(key, _matrix(place), flag))
    unit_cm = tuple(UNITS_CM.values())[_UNITS.index(unit)]
    return Model3MF(objects, tuple(items), unit_cm, tuple(dict.fromkeys(notes)), degenerate)


def _open(archive: ZipFile, content: bytes) -> tuple[Any, list[str], int]:
    """Return lib3mf's model of a file, notes, and the number of degenerate triangles."""
    try:
        import lib3mf  # a shared library: not to be loaded with packit_sim
    except ImportError:  # it has no wheel for Linux on ARM
        raise MeshError("3MF can't be read here, without lib3mf: convert it to STL") from None
    degenerate, notes = 0, []
    try:
        model, reader = _load(lib3mf, content)
    except lib3mf.ELib3MFException as error:
        repaired, degenerate = _repaired(archive)
        try:
            model, reader = _load(lib3mf, repaired)
        except lib3mf.ELib3MFException:
            raise MeshError(f"lib3mf can't read it: {_reason(error)}") from error
    for number in range(reader.GetWarningCount()):
        code, text = (reader.GetWarning(number)[i] for i in (0, -1))
        if code == _UNSUPPORTED:
            raise MeshError("it requires an extension of 3MF that lib3mf does not read")
        if code not in _NO_GEOMETRY:
            notes.append(f"lib3mf: {text}")
    if degenerate:
        notes.append(f"{degenerate:,} triangles with fewer than three corners are left out")
    return model, notes, degenerate


def _load(lib3mf: Any, content: bytes) -> tuple[Any, Any]:
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    data = ctypes.cast(ctypes.c_char_p(content), ctypes.POINTER(ctypes.c_uint8))
    _call(reader, "reader_readfrombuffer", len(content), data)
    return model, reader


def _reason(error: Exception) -> str:
    return str(error).partition(": ")[2] or str(error)


def _repaired(archive: ZipFile) -> tuple[bytes, int]:
    """Return a copy that lib3mf may read, and the number of triangles that it lacks.

    lib3mf refuses a whole file for a triangle without three corners, an identifier that occurs
    twice, a character as a number, or a list of types that is missing. Slicers read such files,
    some write them, and nothing of that changes a shape.
    """
    target = io.BytesIO()
    removed = 0
    with ZipFile(target, "w", ZIP_STORED) as copy:
        if _TYPES not in archive.namelist():
            copy.writestr(_TYPES, CONTENT_TYPES)
        for name in archive.namelist():
            data = archive.read(name)
            if name.lower().endswith(".model"):
                root = etree.fromstring(data)
                for triangle in list(root.iter("{*}triangle")):
                    if len({triangle.get(v, "").strip() for v in ("v1", "v2", "v3")}) < 3:
                        triangle.getparent().remove(triangle)
                        removed += 1
                for element in root.iter("*"):
                    element.attrib.pop(UUID, None)
                    for key, value in element.attrib.items():
                        element.set(key, " ".join(value.split()))
                data = etree.tostring(root, encoding="UTF-8", xml_declaration=True)
            copy.writestr(name, data)
    return target.getvalue(), removed


def _object(found: Any, root: str) -> Object3MF:
    """Return one of lib3mf's objects as plain values."""
    file_id = found.GetModelResourceID()
    id = file_id if found.PackagePart().GetPath() == root else None
    named = found.GetName(), _kind(found), id, file_id
    if found.IsComponentsObject():
        each = [found.GetComponent(n) for n in range(found.GetComponentCount())]
        keys = [one.GetObjectResource().GetUniqueResourceID() for one in each]
        places = [_matrix(one.GetTransform()) for one in each]
        return Object3MF(*named, components=tuple(zip(keys, places, strict=True)))
    if not found.IsMeshObject():
        raise MeshError(f"its object {file_id} is neither a mesh nor made of others")
    if found.BeamLattice().GetBeamCount():
        raise MeshError(f"its object {file_id} has a beam lattice, which is not read")
    vertices = _array(found, "vertices", found.GetVertexCount(), np.dtype("<f4"))
    triangles = _array(found, "triangleindices", found.GetTriangleCount(), np.dtype("<u4"))
    return Object3MF(*named, vertices.astype(float), triangles.astype(np.int64))


def _kind(found: Any) -> str:
    """Return the type of an object in lower case, or Cura's setting that makes it no solid."""
    metadata = found.GetMetaDataGroup()
    for number in range(metadata.GetMetaDataCount()):
        each = metadata.GetMetaData(number)
        if each.GetName() in _NO_SOLID and each.GetValue().lower() == "true":
            return str(each.GetName())
    return str(found.GetType().name).lower()


def _array(mesh: Any, name: str, count: int, dtype: np.dtype[Any]) -> Any:
    """Return vertices or triangles; lib3mf's own methods make an object of each."""
    found = np.empty((count, 3), dtype)
    function = f"meshobject_get{name}"
    row = getattr(mesh._wrapper.lib, f"lib3mf_{function}").argtypes[-1]
    _call(mesh, function, count, ctypes.c_uint64(), found.ctypes.data_as(row))
    return found


def _call(owner: Any, function: str, *values: Any) -> None:
    """Call a function of lib3mf's C interface for one of its objects."""
    wrapper = owner._wrapper
    found = getattr(wrapper.lib, f"lib3mf_{function}")
    wrapper.checkError(owner, found(owner._handle, *values))


def _matrix(transform: Any) -> Floats:
    """Return the matrix (4, 4) of a transform."""
    matrix = np.eye(4)
    matrix[:3] = np.array([list(row) for row in transform.Fields]).T
    return matrix
