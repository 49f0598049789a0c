"""Readers of the results: 3MF by lib3mf, and binary STL."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lib3mf import get_wrapper
from lib3mf.Lib3MF import ELib3MFException

from campaigns.packings.shapes import Floats, Ints


@dataclass(frozen=True, eq=False)
class Body:
    """A mesh at its place, in millimetres."""

    name: str
    vertices: Floats
    triangles: Ints


def read_3mf(path: Path) -> tuple[list[Body], list[str]]:
    """Read the build items of a 3MF file; what lib3mf has against it in strict mode comes along."""
    model, warnings = _read(path, is_strict=True)
    if model is None:
        model, more = _read(path, is_strict=False)
        warnings += more
    if model is None:
        return [], warnings
    units = {0: 1e-3, 1: 1.0, 2: 10.0, 3: 25.4, 4: 304.8, 5: 1000.0}
    scale = units[int(getattr(model.GetUnit(), "value", model.GetUnit()))]
    bodies, items = [], model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        whole = item.GetObjectResource()
        found = _meshes(whole, _matrix(item.GetObjectTransform()))
        starts = np.cumsum([0, *(len(vertices) for vertices, _ in found)])
        triangles = [faces + start for (_, faces), start in zip(found, starts, strict=False)]
        vertices = np.vstack([vertices for vertices, _ in found]) * scale
        name = whole.GetName() or item.GetPartNumber()
        bodies.append(Body(name, vertices, np.vstack(triangles)))
    return bodies, warnings


def _read(path: Path, is_strict: bool) -> tuple[Any, list[str]]:
    """Read a model, which is None if that is not possible, and the warnings."""
    model = get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(is_strict)
    try:
        reader.ReadFromFile(str(path))
    except ELib3MFException as error:
        return None, [str(error)]
    return model, [str(reader.GetWarning(n)[0]) for n in range(reader.GetWarningCount())]


def _meshes(whole: Any, place: Floats) -> list[tuple[Floats, Ints]]:
    """Return the meshes below an object."""
    if whole.IsMeshObject():
        corners = np.array([list(each.Coordinates) for each in whole.GetVertices()], dtype=float)
        faces = [list(each.Indices) for each in whole.GetTriangleIndices()]
        return [(corners @ place[:3, :3].T + place[:3, 3], np.array(faces, dtype=np.int64))]
    found = []
    for n in range(whole.GetComponentCount()):
        component = whole.GetComponent(n)
        below = place @ _matrix(component.GetTransform())
        found += _meshes(component.GetObjectResource(), below)
    return found


def _matrix(transform: Any) -> Floats:
    """Return a matrix (4, 4) that is applied to columns."""
    found = np.eye(4)
    found[:3] = np.array([list(row) for row in transform.Fields], dtype=float).T
    return found


def read_stl(path: Path) -> Floats:
    """Read the triangles (n, 3, 3) of a binary STL file."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    assert len(data) == 84 + 50 * count, f"{path.name}: {len(data)} bytes, {count} triangles"
    kind = np.dtype([("numbers", "<f4", 12), ("more", "<u2")])
    rows = np.frombuffer(data, kind, count, 84)["numbers"]
    return rows[:, 3:].reshape(-1, 3, 3).astype(float)
