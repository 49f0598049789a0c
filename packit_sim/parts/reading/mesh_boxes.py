"""Boxes that are closed meshes: their files are read and prepared like those of parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import trimesh

from packit_sim.core.errors import ArgumentError, MeshError
from packit_sim.core.length_units import Unit
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.mesh_containers import MeshContainer
from packit_sim.parts.packings.rotation_sets import FIXED
from packit_sim.parts.reading.boxes import Boxes, BoxType, MeshFile
from packit_sim.parts.reading.files import ReadSettings, find_parts
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.prepared import PreparedPart, prepare


@dataclass(frozen=True, eq=False)
class MeshBox:
    """A container that is a mesh, before it is prepared."""

    part: Part
    name: str
    count: int | None


def with_meshes(
    boxes: Boxes | Sequence[BoxType | MeshBox], unit: Unit, reading: ReadSettings, count: int | None
) -> tuple[Boxes, Mapping[str, PreparedPart]]:
    """Read the meshes of boxes that are meshes.

    Parameters
    ----------
    boxes : str, BoxType, container, or sequence of float, str, BoxType, container or MeshBox
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
    is_one = isinstance(boxes, (str, BoxType, Container))
    found: list[object] = []
    outlines: dict[str, PreparedPart] = {}
    for each in [boxes] if is_one else boxes:
        box = _mesh_box(each, unit, reading, count)
        if box is None:
            found.append(each)
            continue
        try:
            prepared = prepare(box.part, unit, 0.0)  # not simplified
        except MeshError as error:
            raise ArgumentError(f"container {box.part.name!r}: {error}") from None
        outlines[box.name] = prepared
        found.append(BoxType.of(MeshContainer(prepared.item_type, name=box.name), box.count))
    return (found[0] if is_one else found), outlines  # type: ignore[return-value]


def _mesh_box(
    box: object, unit: Unit, reading: ReadSettings, count: int | None
) -> MeshBox | None:
    """Return a box that is a mesh; None for another one."""
    if isinstance(box, MeshBox):
        return box
    file = MeshFile.parse(box) if isinstance(box, str) else None
    if file is not None:
        return MeshBox(_read(file, reading), file.name, file.count or count)
    own = box.count if isinstance(box, BoxType) else count
    container = box.form if isinstance(box, BoxType) else box
    if not isinstance(container, MeshContainer):
        return None
    mesh = trimesh.Trimesh(container.mesh.vertices, container.mesh.faces, process=False)
    part = Part(container.mesh.name, mesh, rotations=FIXED, unit=unit)
    return MeshBox(part, container.name, own)


def _read(file: MeshFile, reading: ReadSettings) -> Part:
    """Read the one part of a file."""
    if not file.file.exists():
        raise ArgumentError(f"container {str(file.file)!r}: there is no such file")
    found = find_parts([file.file], replace(reading, split=False, rotations=FIXED))
    if found.unread:
        raise ArgumentError(f"container {str(file.file)!r}: {found.unread[0].reason}")
    return found.parts[0]
