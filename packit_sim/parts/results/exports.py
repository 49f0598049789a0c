"""Exports of packed parts: 3MF, GLB, STL, pictures, the report page, and the record."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh
from trimesh.visual import TextureVisuals

from packit_sim.core.errors import ArgumentError
from packit_sim.core.length_units import Unit
from packit_sim.core.plain_text import plain_logger
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.units import factor
from packit_sim.parts.results.check import check
from packit_sim.parts.results.page import write_page
from packit_sim.parts.results.pictures import draw, shown
from packit_sim.parts.results.record import write_record
from packit_sim.render.coloring import by_item
from packit_sim.render.export import Y_UP, material
from packit_sim.render.export_3mf import PlacedMesh, encode_3mf
from packit_sim.render.image_files import output_file

MOST_TRIANGLES = 20_000_000
"""Largest number of triangles of an STL file, which has each copy of a part: 1 GB."""

_log = plain_logger(__name__)


def export(packed: PackedParts, folder: Path | str) -> list[Path]:
    """Check packed parts, and write them as 3MF, GLB, STL, JSON, a picture and a report page.

    Parameters
    ----------
    folder : Path or str
        The folder; its files of an earlier packing are replaced, each in one step.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ArgumentError
        If nothing is packed.
    RenderError
        If a picture or a model can't be written.
    OSError
        If the page or the record can't be written.
    """
    if not packed.packings:
        why = "".join(f": {each.name}: {each.reason}" for each in packed.left_out[:1])
        raise ArgumentError(f"nothing is packed, so there is nothing to write{why}")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for number, contents in enumerate(packed.contents):
        stem = packed.stem(number)
        for suffix in ("3mf", "glb", "stl"):
            path = folder / f"{stem}.{suffix}"
            data = _encoded(packed, contents, suffix)
            if data is None:
                _log.warning("%s is not written: it would have too many triangles", path)
                continue
            with output_file(path) as file:
                file.write(data)
            files.append(path)
        path = folder / f"{stem}.png"
        draw(contents, path, [each.item_type for each in packed.task.keep_out])
        files.append(path)
    found = check(packed)
    files.append(write_page(packed, found, folder / "packing.html"))
    return files + write_record(packed, found, folder, files)


def names(packed: PackedParts, contents: Packing) -> list[str]:
    """Return a unique name for each part in a box, such as "03 bracket"."""
    placements, fixed = contents.placements, len(packed.task.fixed)
    digits = max(2, len(str(len(placements))))
    numbers = [f"fixed {n:0{digits}d}" for n in range(1, fixed + 1)]
    numbers += [f"{n:0{digits}d}" for n in range(1, len(placements) - fixed + 1)]
    own = [packed.part(one).part.name for one in placements]
    return [f"{number} {name}" for number, name in zip(numbers, own, strict=True)]


def _encoded(packed: PackedParts, contents: Packing, suffix: str) -> bytes | None:
    """Return a box in a format; None if there are too many triangles for it."""
    if suffix == "glb":
        return _glb(packed, contents)
    if suffix == "3mf":
        return encode_3mf(_placed(packed, contents, "mm"))
    triangles = sum(len(packed.part(one).part.mesh.faces) for one in contents.placements)
    if triangles > MOST_TRIANGLES:
        return None
    return bytes(_scene(packed, contents, "mm").to_mesh().export(file_type="stl"))


def _glb(packed: PackedParts, contents: Packing) -> bytes:
    colors = by_item([one.item for one in shown(contents).placed]).of
    scene = _scene(packed, contents, "m", colors, Y_UP)
    return bytes(scene.export(file_type="glb"))


def _scene(
    packed: PackedParts,
    contents: Packing,
    unit: Unit,
    colors: tuple[tuple[float, float, float], ...] | None = None,
    frame: Floats | None = None,
) -> trimesh.Scene:
    """Return the files' meshes of a box in a unit, each once, at their poses."""
    scene = trimesh.Scene()
    parent = scene.graph.base_frame
    if frame is not None:
        scene.graph.update(frame_from=parent, frame_to="box", matrix=frame)
        parent = "box"
    for n, each in enumerate(_placed(packed, contents, unit)):
        own = each.mesh_name
        if own in scene.geometry:
            scene.graph.update(
                frame_from=parent, frame_to=each.name, matrix=each.matrix, geometry=own
            )
            continue
        mesh = trimesh.Trimesh(each.vertices, each.triangles, process=False)
        if colors is not None:
            mesh.visual = TextureVisuals(material=material(colors[n]))
        scene.add_geometry(mesh, each.name, own, parent_node_name=parent, transform=each.matrix)
    return scene


def _placed(packed: PackedParts, contents: Packing, unit: Unit) -> Iterator[PlacedMesh]:
    """Yield the file's mesh of each part in a unit, about its middle, at its pose.

    Formats with single precision have few digits far from 0.
    """
    meshes: dict[int, tuple[str, Floats, Ints]] = {}
    length = factor(packed.task.unit, unit)
    for name, one in zip(names(packed, contents), contents.placements, strict=True):
        part, middle = packed.part(one).part, packed.task.types[one.type].middle * length
        if one.type not in meshes:
            vertices = part.user_from_file.direction(part.mesh.vertices * part.scale(unit))
            mesh = trimesh.Trimesh(vertices - middle, part.mesh.faces, process=False)
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
            faces = np.asarray(mesh.faces, dtype=np.int64)
            own_name, taken = part.name, {known for known, _, _ in meshes.values()}
            if own_name in taken:  # of a fixed part
                own_name = f"{own_name} ({one.type + 1})"
            meshes[one.type] = own_name, np.asarray(mesh.vertices), faces
        pose = one.pose.at(one.pose.translation * length)
        matrix = pose.shifted(pose.direction(middle)).matrix
        yield PlacedMesh(name, *meshes[one.type], matrix)
