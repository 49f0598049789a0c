"""Exports of packed parts: the record first, then 3MF, GLB, STL, pictures and the report page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from trimesh.visual import TextureVisuals

from packit_sim.core.errors import ArgumentError, RenderError, reason
from packit_sim.core.length_units import Unit
from packit_sim.core.plain_text import plain_logger
from packit_sim.core.progress import Progress, unseen
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.units import factor
from packit_sim.parts.results.check import check
from packit_sim.parts.results.page import write_page
from packit_sim.parts.results.pictures import draw, part_colors
from packit_sim.parts.results.record import update_record, write_record
from packit_sim.render.export import Y_UP, material
from packit_sim.render.export_3mf import PlacedMesh, encode_3mf
from packit_sim.render.image_files import output_file

SUFFIXES = ".3mf", ".glb", ".stl", ".png"
"""The files of each box."""

MOST_TRIANGLES = 20_000_000
"""Largest number of triangles of an STL file, which has each copy of a part: 1 GB."""

_log = plain_logger(__name__)


def export(packed: PackedParts, folder: Path | str, progress: Progress = unseen) -> list[Path]:
    """Write packed parts: the record and its meshes, and then all other files.

    The record comes first, so that nothing that happens later loses the packing. Then follow the
    check, whose result is added to the record, 3MF, GLB, STL and a picture of each box, and the
    report page. One of these that can't be made, such as a picture of too many triangles, is a
    warning, and the others are still written.

    Parameters
    ----------
    folder : Path or str
        The folder; files of an earlier packing are removed when the record is replaced.
    progress : callable, optional
        Called with each step, and how much of it is done.

    Returns
    -------
    list of Path
        The files that were written, the record last.

    Raises
    ------
    ArgumentError
        If nothing is packed.
    RenderError
        If the disk takes no picture or model.
    OSError
        If the page or the record can't be written.
    """
    if not packed.packings:
        why = "".join(f": {each.name}: {each.reason}" for each in packed.left_out[:1])
        raise ArgumentError(f"nothing is packed, so there is nothing to write{why}")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    page = folder / "packing.html"
    boxes = {
        folder / f"{packed.stem(n)}{suffix}": contents
        for n, contents in enumerate(packed.contents)
        for suffix in SUFFIXES
    }
    progress("writing the record", 0, 1)
    *meshes, record = write_record(packed, None, folder, [*boxes, page])
    found = check(packed, progress)
    update_record(packed, found, folder, [*boxes, page])
    steps: dict[Path, Callable[[], object]] = {
        path: partial(_write, packed, contents, path) for path, contents in boxes.items()
    }
    steps[page] = partial(write_page, packed, found, page)
    files = []
    for n, (path, write) in enumerate(steps.items()):
        progress(f"writing {path.name}", n, len(steps))
        if attempted(path, write):
            files.append(path)
        progress(f"writing {path.name}", n + 1, len(steps))
    if len(files) < len(steps):
        update_record(packed, found, folder, files)
    return [*files, *meshes, record]


def attempted(path: Path, write: Callable[[], object]) -> bool:
    """Write a file; if it can't be made, warn.

    Returns
    -------
    bool
        True if it is written.

    Raises
    ------
    RenderError
        If the disk does not take the file: it would take no other one.
    OSError
        The same.
    """
    try:
        write()
    except Exception as error:
        if isinstance(error, OSError) or isinstance(error.__cause__, OSError):
            raise
        _log.warning("%s is not written: %s", path, reason(error))
        return False
    return True


def names(packed: PackedParts, contents: Packing) -> list[str]:
    """Return a unique name for each part in a box, such as "03 bracket"."""
    placements, fixed = contents.placements, len(packed.task.fixed)
    digits = max(2, len(str(len(placements))))
    numbers = [f"fixed {n:0{digits}d}" for n in range(1, fixed + 1)]
    numbers += [f"{n:0{digits}d}" for n in range(1, len(placements) - fixed + 1)]
    own = [packed.part(one).part.name for one in placements]
    return [f"{number} {name}" for number, name in zip(numbers, own, strict=True)]


def _write(packed: PackedParts, contents: Packing, path: Path) -> None:
    """Write a box in the format of a path's suffix."""
    if path.suffix == ".png":
        draw(contents, path, [each.item_type for each in packed.task.keep_out])
        return
    data = _encoded(packed, contents, path.suffix[1:])
    if data is None:
        raise RenderError("it would have too many triangles")
    with output_file(path) as file:
        file.write(data)


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
    colors = part_colors(contents)
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
