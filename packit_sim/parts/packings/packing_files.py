"""Files of packings off the grid: JSON with meshes and poses, written and verified."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct, field

from packit_sim.core import typed_json
from packit_sim.core.check_reports import FileProblem, Report, named
from packit_sim.core.errors import ArgumentError, MeshError, PackFormatError, located
from packit_sim.core.files import replace_text, require_same
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.motions import IDENTITY, matrix_fault
from packit_sim.libraries.data_files import read_bytes
from packit_sim.parts.packings import validity
from packit_sim.parts.packings.bounds import MAX_LENGTH, Extent, PoseRows
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.container_files import (
    RecordedForm,
    form_of,
    recorded_container,
)
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.distances import stretch
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.mesh_containers import MeshContainer
from packit_sim.parts.packings.mesh_paths import file_inside, is_inside
from packit_sim.parts.packings.placements import Placement


def verify_packing(file: Path | str) -> Report:
    """Check a packing off the grid, ours or another tool's, by its meshes themselves.

    Parameters
    ----------
    file : Path or str
        The JSON file (see Notes).

    Returns
    -------
    Report
        The problems. They include meshes that can't be used, and poses that shear or mirror.

    Raises
    ------
    PackFormatError
        If the file is not of this form; the message names the file and the field.
    MeshError
        If the mesh of a container can't be used.

    Notes
    -----
    The file is a JSON object, which may have other fields as well:

        {"box": [600, 400, 300], "unit": "mm", "clearance": 0,
         "items": [{"mesh": "parts/mug.stl", "box": 0,
                    "pose": [[1, 0, 0, 50], [0, 1, 0, 50], [0, 0, 1, 60], [0, 0, 0, 1]]}]}

    - `box`: its extents, from (0, 0, 0); the last is null for a strip, which has no top.
    - `boxes`: the extents of each box, where there are boxes of several sizes; `box` is ignored.
    - `container`: `{"form": "cylinder"}` for an upright cylinder with the bounding box `box`, or
      `{"form": "mesh", "mesh": ..., "pose": ...}` for the space inside a closed mesh with that
      bounding box; null or missing for a box. `containers` are those of `boxes`, in their order.
    - `unit`: the name of the unit of length; it has no influence.
    - `clearance`: the smallest distance between the surfaces of two items; by default 0.
    - `clearance z`: the same along z, if it is another one (see `distances.stretch`).
    - `clearance` of an item or obstacle: its own smallest distance to others, if it is larger.
    - `mesh`: a file of one of `mesh_files.SUFFIXES`, by its path from the packing's folder, with
      "/" between folders, and inside that folder.
    - `obstacles`: meshes that are in every box, each with its `mesh` and `pose`; by default none.
      Items keep clear of them; they themselves may be anywhere, and do not count.
    - `box` of an item: which of several boxes of this size it is in, from 0; by default 0.
    - `pose`: (4, 4) by rows, a rotation, one scale for all axes and a translation. It maps the
      coordinates in the mesh's file to those of the box, regardless of the file's up axis and unit.

    `validity.outside` and `validity.pair_problems` define what is valid. The density is that of the
    used boxes, or of the strip up to its highest item; the volume of an item is that of the closed
    body, or of the solid by voxels (see `Shape`).
    """
    file = Path(file)
    packing = _read(file)
    container, several = _containers(packing, file.parent)
    containers = dict(enumerate(several))
    factor = stretch(packing.clearance, packing.clearance_z)
    load = cache(lambda *own: _item_type(file.parent, *own))
    found: list[str] = []
    items: list[CheckedItem] = []
    obstacles: list[CheckedItem] = []
    every: list[tuple[str, _Obstacle, list[CheckedItem]]]
    every = [(named(n, item.mesh), item, items) for n, item in enumerate(packing.items)]
    for n, obstacle in enumerate(packing.obstacles):
        every.append((f"obstacle {n} ({obstacle.mesh!r})", obstacle, obstacles))
    for name, posed, kind in every:
        pose = np.array(posed.pose)
        fault = matrix_fault(pose)
        if fault:
            found.append(f"{name}: its pose {fault}")
            continue
        try:
            box = posed.box if isinstance(posed, _PackingItem) else 0
            longest = containers.get(box, container).longest
            placement = Placement.from_matrix(0, pose, box)
            own = load(posed.mesh, posed.clearance)
            kind.append(CheckedItem(name, own, placement, longest))
        except MeshError as error:
            found.append(f"{name} has no mesh: {error}")
    used = sorted({item.box for item in packing.items})
    if containers:
        for box in used:
            inside = [item for item in items if item.box == box]
            known = inside, containers[box], packing.clearance, obstacles, factor
            found += validity.problems(*known)
        space = plain_sum(containers[box].volume for box in used)
    else:
        found += validity.problems(items, container, packing.clearance, obstacles, factor)
        space = container.volume * len(used)
    if container.is_strip and not containers:
        x, y, _ = container.size
        space = x * y * max((float(item.high[2]) for item in items), default=0.0)
    volume = plain_sum(item.volume for item in items)
    sentences = tuple(FileProblem(file, None, sentence) for sentence in found)
    return Report(sentences, 1, 1, len(packing.items), volume, space)


_Placed = tuple[
    tuple[ItemType, ...],
    Container,
    tuple[Placement, ...],
    float,
    tuple[Container, ...],
    float | None,
]


def read_packing(file: Path | str) -> _Placed:
    """Read what `write_packing` writes.

    Parameters
    ----------
    file : Path or str
        The JSON file, see `verify_packing`.

    Returns
    -------
    tuple
        The arguments of `write_packing`, in its order.

    Raises
    ------
    PackFormatError
        If the file is not of this form.
    MeshError
        If a mesh can't be used.
    ArgumentError
        If a pose shears or mirrors.
    """
    file = Path(file)
    packing = _read(file)
    load = cache(lambda *own: _item_type(file.parent, *own))
    kinds = list(dict.fromkeys((item.mesh, item.clearance) for item in packing.items))
    types = tuple(load(*kind) for kind in kinds)
    numbers = {kind: n for n, kind in enumerate(kinds)}
    placements = tuple(
        Placement.from_matrix(numbers[item.mesh, item.clearance], np.array(item.pose), item.box)
        for item in packing.items
    )
    obstacles = tuple(_in_place(load(each.mesh, None), each) for each in packing.obstacles)
    container, containers = _containers(packing, file.parent, obstacles)
    return types, container, placements, packing.clearance, containers, packing.clearance_z


def _item_type(folder: Path, mesh: str, clearance: float | None) -> ItemType:
    return ItemType.from_file(file_inside(folder, mesh)).changed(clearance=clearance)


def _containers(
    packing: _Packing, folder: Path, obstacles: tuple[ItemType, ...] = ()
) -> tuple[Container, tuple[Container, ...]]:
    """Return the container of a packing, and those of each box if there are several sizes."""
    forms = packing.containers or (None,) * len(packing.boxes)
    one = packing.box, packing.container, folder, "container", obstacles
    several = zip(packing.boxes, forms, strict=True)
    return recorded_container(*one), tuple(
        recorded_container(sides, form, folder, f"containers[{n}]")
        for n, (sides, form) in enumerate(several)
    )


def write_packing(
    path: Path | str,
    types: Sequence[ItemType],
    container: Container,
    placements: Sequence[Placement],
    clearance: float,
    containers: Sequence[Container] = (),
    clearance_z: float | None = None,
) -> None:
    """Write a packing as `verify_packing` reads it.

    Parameters
    ----------
    path : Path or str
        The JSON file; it is written last, whole or not at all.
    types : sequence of ItemType
        The types of items. The meshes without a file below the folder of `path` are written to
        NAME-meshes next to it, as OBJ, without rounding.
    placements : sequence of Placement
        The items.
    clearance : float
        The smallest distance between the surfaces of two items.
    containers : sequence of Container
        That of each box, if there are several sizes.
    clearance_z : float, optional
        The smallest distance along z, if it is another one.

    Raises
    ------
    ArgumentError
        If a mesh would replace a file with another content.
    OSError
        If a file can't be written.
    """
    path = Path(path)
    require_free_meshes(types, path)
    used = {placement.type for placement in placements}
    meshes = {number: _mesh_path(types[number], path) for number in sorted(used)}
    items = [
        {
            "name": types[placement.type].name,
            "mesh": meshes[placement.type],
            "box": placement.box,
            "pose": placement.matrix.tolist(),
            **own_clearance(types[placement.type]),
        }
        for placement in placements
    ]
    x, y, z = container.size
    packing = {
        "box": [x, y, None if container.is_strip else z],
        "clearance": clearance,
        "items": items,
    }
    if clearance_z is not None:
        packing["clearance z"] = clearance_z
    if form_of(container) != "box":
        packing["container"] = _form(container, path)
    if containers:
        packing["boxes"] = [each.size for each in containers]
        if any(form_of(each) != "box" for each in containers):
            packing["containers"] = [_form(each, path) for each in containers]
    if container.obstacles:
        identity = IDENTITY.matrix.tolist()
        packing["obstacles"] = [
            {
                "name": each.name,
                "mesh": _mesh_path(each, path),
                "pose": identity,
                **own_clearance(each),
            }
            for each in container.obstacles
        ]
    replace_text(path, json.dumps(packing, indent=1, ensure_ascii=False) + "\n")


def own_clearance(item_type: ItemType) -> dict[str, float]:
    """Return the field of an item that has a clearance of its own."""
    return {} if item_type.clearance is None else {"clearance": item_type.clearance}


def _form(container: Container, path: Path) -> dict[str, Any] | None:
    """Return what a container is, but for a box, and write its mesh."""
    if isinstance(container, MeshContainer):
        pose = container.container_from_mesh.matrix.tolist()
        return {"form": "mesh", "mesh": _mesh_path(container.mesh, path), "pose": pose}
    return {"form": form_of(container)} if form_of(container) != "box" else None


def _mesh_path(item_type: ItemType, path: Path) -> str:
    """Return a mesh file's path from the packing's folder; write the file if there is none."""
    folder = path.parent.resolve()
    if item_type.file is not None:
        file = item_type.file.resolve()
        if file.is_relative_to(folder) and file.is_file():
            relative = file.relative_to(folder).as_posix()
            if is_inside(relative):
                return relative
    file = _own_mesh(item_type, path)
    meshes = file.parent
    meshes.mkdir(exist_ok=True)
    replace_text(file, obj_text(item_type.vertices, item_type.faces))
    return f"{meshes.name}/{file.name}"


def _own_mesh(item_type: ItemType, path: Path) -> Path:
    """Return the file of a mesh that is written next to a packing."""
    return path.with_name(f"{path.stem}-meshes") / f"{item_type.digest[:16]}.obj"


def require_free_meshes(types: Sequence[ItemType], path: Path) -> None:
    """Refuse a packing's file if one of its meshes would replace a file with another content.

    Raises
    ------
    ArgumentError
        If there is such a file.
    """
    for each in types:
        file = _own_mesh(each, path)
        if os.path.lexists(file):
            require_same(file, obj_text(each.vertices, each.faces).encode())


def obj_text(vertices: Floats, faces: Ints) -> str:
    """Write a mesh as OBJ text, without rounding.

    Parameters
    ----------
    vertices : ndarray of float64, shape (n, 3)
        The vertices.
    faces : ndarray of int64, shape (m, 3)
        The triangles, as indices of vertices.

    Returns
    -------
    str
        The text.
    """
    corners = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices.tolist())
    return corners + "".join(f"f {a} {b} {c}\n" for a, b, c in (faces + 1).tolist())


class _Obstacle(Struct):
    mesh: str
    pose: PoseRows
    clearance: Annotated[float, Meta(ge=0, lt=MAX_LENGTH)] | None = None


class _PackingItem(_Obstacle):
    box: Annotated[int, Meta(ge=0, le=10**9)] = 0


class _Packing(Struct):
    """The content of a packing's file; other fields are ignored."""

    box: tuple[Extent, Extent, Extent | None]
    items: Annotated[tuple[_PackingItem, ...], Meta(min_length=1)]
    boxes: Annotated[tuple[tuple[Extent, Extent, Extent], ...], Meta(max_length=10_000)] = ()
    container: RecordedForm | None = None
    containers: Annotated[tuple[RecordedForm | None, ...], Meta(max_length=10_000)] = ()
    obstacles: tuple[_Obstacle, ...] = ()
    unit: str = ""
    clearance: Annotated[float, Meta(ge=0, lt=MAX_LENGTH)] = 0.0
    clearance_z: float | None = field(default=None, name="clearance z")


def _read(file: Path) -> _Packing:
    data = read_bytes(file)
    with located(file, PackFormatError):
        packing = typed_json.decode(data, _Packing, PackFormatError, "a packing")
        for n, item in enumerate(packing.items):
            if packing.boxes and item.box >= len(packing.boxes):
                raise PackFormatError(
                    f"field 'items[{n}].box' is {item.box}: there are {len(packing.boxes)} boxes"
                )
            _check_path(f"items[{n}].mesh", item.mesh)
        try:
            stretch(packing.clearance, packing.clearance_z)
        except ArgumentError as error:
            raise PackFormatError(f"field 'clearance z': {error}") from None
        for n, obstacle in enumerate(packing.obstacles):
            _check_path(f"obstacles[{n}].mesh", obstacle.mesh)
        if packing.containers and len(packing.containers) != len(packing.boxes):
            raise PackFormatError(
                f"field 'containers' has {len(packing.containers)} entries for "
                f"{len(packing.boxes)} boxes"
            )
        for n, form in enumerate((packing.container, *packing.containers)):
            if form is not None and form.mesh is not None:
                _check_path(f"containers[{n - 1}].mesh" if n else "container.mesh", form.mesh)
    return packing


def _in_place(own: ItemType, obstacle: _Obstacle) -> ItemType:
    """Return an obstacle of a packing, in the container's coordinates."""
    vertices = Placement.from_matrix(0, np.array(obstacle.pose)).apply(own.vertices)
    return ItemType(own.name, vertices, own.faces, clearance=obstacle.clearance)


def _check_path(field: str, mesh: str) -> None:
    if not is_inside(mesh):
        raise PackFormatError(
            f"field {field!r} is {mesh!r}: it must be a path inside the packing's folder"
        )
