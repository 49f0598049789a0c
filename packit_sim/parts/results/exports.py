"""Exports of packed parts: the record first, then 3MF, GLB, STL, pictures and the report page."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from trimesh.visual import TextureVisuals

from packit_sim.core.errors import ArgumentError, RenderError, reason
from packit_sim.core.files import digest_of
from packit_sim.core.length_units import Unit
from packit_sim.core.plain_text import plain_logger
from packit_sim.core.progress import Progress, unseen
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.packings.outlines import outline
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.reading.units import factor
from packit_sim.parts.results.check import check
from packit_sim.parts.results.film import film as write_film
from packit_sim.parts.results.instructions import write_instructions
from packit_sim.parts.results.own_files import replaceable, unchanged
from packit_sim.parts.results.page import write_page
from packit_sim.parts.results.pictures import draw, part_colors
from packit_sim.parts.results.record import (
    FILM,
    INSTRUCTIONS,
    RECORD,
    update_record,
    write_record,
)
from packit_sim.render.export import Y_UP, material
from packit_sim.render.export_3mf import PlacedMesh, encode_3mf
from packit_sim.render.image_files import output_file

SUFFIXES = ".3mf", ".glb", ".stl", ".png"
"""The files of each box."""

MOST_TRIANGLES = 20_000_000
"""Largest number of triangles of an STL file, which has each copy of a part: 1 GB."""

PAGE = "packing.html"

_STAGING = ".packing."

_log = plain_logger(__name__)


def export(
    packed: PackedParts,
    folder: Path | str,
    progress: Progress = unseen,
    *,
    force: bool = False,
    instructions: bool = False,
    film: bool = False,
) -> list[Path]:
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
    force : bool
        Whether files that `pack` did not write, or that were changed since, are replaced as well.
    instructions : bool
        Whether packing instructions are written, too.
    film : bool
        The same for a film of each box.

    Returns
    -------
    list of Path
        The files that were written, the record last.

    Raises
    ------
    ArgumentError
        If nothing is packed, or files of others are in the way.
    OSError
        If the disk takes no further file.
    """
    folder = Path(folder)
    earlier = replaceable(folder, packed.task, force, instructions, film)
    return write_result(packed, folder, earlier, progress, instructions, film)


def write_result(
    packed: PackedParts,
    folder: Path,
    earlier: Mapping[str, str],
    progress: Progress = unseen,
    instructions: bool = False,
    film: bool = False,
) -> list[Path]:
    """Write packed parts as `export` does, where it is known already which files are replaced.

    Parameters
    ----------
    earlier : mapping of str to str
        What `replaceable` has found. What has changed or appeared since is not replaced.
    progress : callable, optional
        As for `export`.
    instructions : bool
        The same.
    film : bool
        The same.

    Returns
    -------
    list of Path
        The files that were written, the record last.

    Raises
    ------
    ArgumentError
        If nothing is packed.
    OSError
        If the disk takes no further file.
    """
    if not packed.packings:
        why = "".join(f": {each.name}: {each.reason}" for each in packed.left_out[:1])
        raise ArgumentError(f"nothing is packed, so there is nothing to write{why}")
    folder.mkdir(parents=True, exist_ok=True)
    progress("writing the record", 0, 1)
    meshes = write_record(packed, None, folder, unchanged(folder, earlier))
    found = check(packed, progress)
    update_record(packed, found, folder, meshes)
    steps: dict[str, Callable[[Path], object]] = {
        f"{packed.stem(n)}{suffix}": partial(_write, packed, contents)
        for n, contents in enumerate(packed.contents)
        for suffix in SUFFIXES
    }
    steps[PAGE] = partial(write_page, packed, found)
    if film:
        steps |= {
            f"{packed.stem(n)}{FILM}": partial(write_film, packed, box=n)
            for n in range(len(packed.packings))
        }
    if instructions:
        steps[INSTRUCTIONS] = partial(write_instructions, packed, progress=progress)
    with staging(folder) as new:
        written = []
        for n, (name, write) in enumerate(steps.items()):
            progress(f"writing {name}", n, len(steps))
            if attempted(folder / name, partial(write, new / name)):
                written.append(name)
            progress(f"writing {name}", n + 1, len(steps))
        for name in [name for name in written if os.path.lexists(folder / name)]:
            _log.warning("%s is not written: another program wrote that name", folder / name)
            written.remove(name)
        update_record(packed, found, folder, meshes | {n: digest_of(new / n) for n in written})
        for name in written:
            (new / name).rename(folder / name)
    return [folder / name for name in (*written, *meshes, RECORD)]


def attempted(path: Path, write: Callable[[], object]) -> bool:
    """Write a file; if it can't be made, warn.

    Returns
    -------
    bool
        True if it is written.

    Raises
    ------
    OSError
        If the disk does not take the file: it would take no other one. The error has its path.
    """
    try:
        write()
    except Exception as error:
        disk = error if isinstance(error, OSError) else error.__cause__
        if isinstance(disk, OSError):
            raise OSError(disk.errno, disk.strerror or str(disk), str(path)) from error
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


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """Create a folder in which files are written, until all of them are moved to another one.

    Those that killed processes left are removed first.

    Parameters
    ----------
    folder : Path
        The other folder, in which the new one is.

    Yields
    ------
    Path
        The new folder; it is removed with what is still in it.
    """
    for left in folder.glob(f"{_STAGING}{'[a-z0-9_]' * 8}.tmp"):
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(".tmp", _STAGING, folder, ignore_cleanup_errors=True) as new:
        yield Path(new)


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
    """Return the files' meshes of a box in a unit, each once, at their poses.

    With colours and a frame, it is for viewers, and has the lines of a container.
    """
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
    if frame is not None and len(lines := outline(contents.container)):
        path = trimesh.load_path(lines * factor(packed.task.unit, unit))
        name = f"container {contents.container.name}"
        scene.add_geometry(path, name, name, parent_node_name=parent)
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
