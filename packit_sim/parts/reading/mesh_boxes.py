"""Boxes that are closed meshes: their files are read and prepared like those of parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import trimesh

from packit_sim.core.errors import ArgumentError, MeshError
from packit_sim.core.files import exists
from packit_sim.core.length_units import Unit
from packit_sim.parts.packings.mesh_containers import MeshContainer
from packit_sim.parts.packings.rotation_sets import FIXED
from packit_sim.parts.packings.turning import ANY_TURN
from packit_sim.parts.reading.boxes import Boxes, BoxType, MeshBox, OneBox
from packit_sim.parts.reading.files import ReadSettings, find_parts
from packit_sim.parts.reading.limits import Limits
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.prepared import PreparedPart, prepare


def with_meshes(
    boxes: Boxes, unit: Unit, reading: ReadSettings, count: int | None
) -> tuple[Boxes, Mapping[str, PreparedPart]]:
    """Read and prepare the meshes of boxes that are meshes.

    Parameters
    ----------
    boxes : str, BoxType, Container, or sequence of float, str, BoxType or Container
        The boxes.
    unit : str
        The unit of the result.
    reading : ReadSettings
        How files are read.
    count : int, optional
        How many there are of a box that does not say so.

    Returns
    -------
    boxes : Boxes
        The same, with a `BoxType` for each mesh.
    meshes : mapping of str to PreparedPart
        The meshes by the names of their boxes.

    Raises
    ------
    ArgumentError
        If a mesh can't be read, or is not closed.
    """
    found: list[Any] = []
    outlines: dict[str, PreparedPart] = {}
    several: Any = [boxes] if isinstance(boxes, OneBox) else boxes
    for each in several:
        box = _mesh_box(each, unit, count)
        if box is None:
            found.append(each)
            continue
        part, own = box.mesh, box.count
        if not isinstance(part, Part):
            part, own = _read(part, reading), box.count or count
        try:
            prepared = prepare(part, unit, 0.0)  # not simplified
        except MeshError as error:
            raise ArgumentError(f"container {part.name!r}: {error}") from None
        container = MeshContainer(prepared.item_type, name=box.name)
        outlines[box.name] = prepared
        limits = each.limits if isinstance(each, (BoxType, MeshBox)) else Limits()
        found.append(replace(BoxType.of(container, own), limits=limits))
    return found, outlines


def _mesh_box(box: object, unit: Unit, count: int | None) -> MeshBox | None:
    """Return a box that is a mesh; None for another one."""
    if isinstance(box, str):
        return MeshBox.parse(box)
    container = box.form if isinstance(box, BoxType) else box
    if not isinstance(container, MeshContainer):
        return box if isinstance(box, MeshBox) else None
    mesh = trimesh.Trimesh(container.mesh.vertices, container.mesh.faces, process=False)
    part = Part(container.mesh.name, mesh, rotations=FIXED, unit=unit)
    return MeshBox(part, container.name, box.count if isinstance(box, BoxType) else count)


def _read(file: Path, reading: ReadSettings) -> Part:
    """Read the one part of a file."""
    if not exists(file):
        raise ArgumentError(f"container {str(file)!r}: there is no such file")
    found = find_parts([file], replace(reading, split=False, rotations=FIXED, turning=ANY_TURN))
    if found.unread:
        raise ArgumentError(f"container {str(file)!r}: {found.unread[0].reason}")
    return found.parts[0]
