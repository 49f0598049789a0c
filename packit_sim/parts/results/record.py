"""The record of packed parts in JSON, from which `pack` resumes the search."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import to_builtins

from packit_sim.core.errors import ArgumentError
from packit_sim.core.files import claimed, replace_text, replacing
from packit_sim.core.plain_text import plain
from packit_sim.core.version import __version__
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.packing_files import obj_text
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.prepared import PreparedPart
from packit_sim.parts.results.check import Check
from packit_sim.parts.results.request import request
from packit_sim.parts.results.summary import summary

RECORD = "packing.json"
"""The name of the file."""

MESHES = "meshes"
"""The folder of the meshes, next to it."""

INSTRUCTIONS = "instructions.html"

FILM = ".gif"
"""Suffix of the film of a box."""

_DIGITS = 12
"""Digits of a digest in the names of meshes."""

_WHOLE = (".3mf", ".dae", ".glb", ".obj", ".off", ".ply", ".stl")
"""Suffixes of mesh files that need no others."""


def write_record(
    packed: PackedParts, found: Check | None, folder: Path, earlier: Mapping[str, str]
) -> dict[str, str]:
    """Write a packing and its meshes so that `packit verify` can check them.

    An earlier packing in the folder holds until the record is replaced, the last step.

    Parameters
    ----------
    packed : PackedParts
        The packing.
    found : Check, optional
        The result of its check; without it the summary says that it is not done.
    earlier : mapping of str to str
        SHA-256 of the folder's files that may be replaced. Those that are no meshes of this packing
        are recorded as earlier files, and then removed.

    Returns
    -------
    dict of str to str
        SHA-256 of the meshes, by their names in the folder.

    Raises
    ------
    OSError
        If a file can't be written.
    """
    (folder / MESHES).mkdir(parents=True, exist_ok=True)
    task = packed.task
    meshes: dict[int, str] = {}
    files: dict[str, str] = {}
    items = []
    for number, packing in enumerate(packed.packings):
        for one in packing.placements:
            part = packed.part(one).part
            if one.type not in meshes:
                meshes[one.type] = mesh_name(part)
                files[meshes[one.type]] = _write_mesh(part, folder, earlier)
            items.append(
                {
                    "name": part.name,
                    "mesh": meshes[one.type],
                    "box": number,
                    "pose": packed.pose(one).tolist(),
                    **_clearance(packed.part(one)),
                }
            )
    obstacles: list[dict[str, Any]] = []
    for each in task.obstacles:
        mesh = mesh_name(each.part)
        files[mesh] = _write_mesh(each.part, folder, earlier)
        what: dict[str, Any] = {"name": each.part.name, "is part": each in task.fixed}
        what |= _clearance(each)
        obstacles.append({**what, "mesh": mesh, "pose": each.part.matrix(each.unit).tolist()})
    boxes = [packing.container for packing in packed.packings]
    outlines = {name: mesh_name(each.part) for name, each in task.outlines.items()}
    for name, mesh in outlines.items():
        files[mesh] = _write_mesh(task.outlines[name].part, folder, earlier)
    stale = {name: digest for name, digest in earlier.items() if name not in files}
    record: dict[str, Any] = {
        "created by": f"PackIt-Sim {__version__}, packit pack",
        "box": list(boxes[0].size),
        "boxes": [list(box.size) for box in boxes],
        "containers": [_form(task, box, outlines) for box in boxes],
        "box names": [box.name for box in boxes],
        "unit": task.unit,
        "clearance": task.settings.clearance,
        "clearance z": task.settings.clearance_z,
        "wall clearance": to_builtins(task.settings.wall_clearance),
        "objective": task.objective,
        "items": items,
        "obstacles": obstacles,
        "left out": [vars(each) for each in packed.left_out],
        "files not read": [vars(each) for each in packed.unread],
        "summary": summary(packed, found),
        "notes": list(packed.notes),
        "parts": [
            {
                "name": each.part.name,
                "file": None if each.part.file is None else plain(str(each.part.file)),
                "count": each.part.count,
                "deviation": each.deviation,
                "volume": each.volume,
                "mass": each.mass,
            }
            for each in task.parts
        ],
        "files": files,
        "earlier files": stale,
        "task": task.digest,
        "searches": packed.searches,
    }
    record["request"] = request(task, record, outlines)
    _replace(folder, record)
    for name in sorted(stale):
        (folder / name).unlink(missing_ok=True)
    return files


def _clearance(part: PreparedPart) -> dict[str, float]:
    """Return the field of an item that has a clearance of its own."""
    return {} if part.clearance is None else {"clearance": part.clearance}


def update_record(
    packed: PackedParts, found: Check, folder: Path, files: Mapping[str, str]
) -> None:
    """Add the result of the check to the record of a packing, and name all of its files.

    Parameters
    ----------
    found : Check
        The result.
    files : mapping of str to str
        SHA-256 of the files, by their names in the folder; there are no earlier ones any more.

    Raises
    ------
    OSError
        If the file can't be written.
    """
    record = json.loads((folder / RECORD).read_bytes())
    record |= {"summary": summary(packed, found), "files": files, "earlier files": {}}
    _replace(folder, record)


def _form(
    task: PackTask, container: Container, outlines: Mapping[str, str]
) -> dict[str, Any] | None:
    """Return what a container is, but for a box."""
    form = form_of(container)
    if form == "mesh":
        pose = outline_pose(task.outlines[container.name]).tolist()
        return {"form": form, "mesh": outlines[container.name], "pose": pose}
    return None if form == "box" else {"form": form}


def outline_pose(outline: PreparedPart) -> Floats:
    """Return the matrix (4, 4) from the file of a container's mesh to the container."""
    part = outline.part
    return part.user_from_file.shifted(-outline.item_type.low).scaled(outline.scale)


def _replace(folder: Path, record: dict[str, Any]) -> None:
    replace_text(folder / RECORD, json.dumps(record, indent=1, ensure_ascii=False) + "\n")


def mesh_name(part: Part) -> str:
    """Return the name of a part's mesh in the folder, which depends on its content."""
    if _is_copied(part) and part.copy and part.file:
        return f"{MESHES}/{part.file_name}-{part.copy.digest[:_DIGITS]}{part.file.suffix.lower()}"
    sha = hashlib.sha256(np.ascontiguousarray(part.mesh.vertices, "<f8").tobytes())
    sha.update(np.ascontiguousarray(part.mesh.faces, "<i8").tobytes())
    return f"{MESHES}/{part.file_name}-{sha.hexdigest()[:_DIGITS]}.obj"


def mesh_content(part: Part) -> bytes:
    """Return the file of a part's mesh: its own, or OBJ if that has more or needs others."""
    if _is_copied(part) and part.copy:
        return part.copy.content
    vertices = np.asarray(part.mesh.vertices, dtype=float)
    return obj_text(vertices, np.asarray(part.mesh.faces)).encode()


def _is_copied(part: Part) -> bool:
    return bool(
        part.file and part.copy and part.node is None and part.file.suffix.lower() in _WHOLE
    )


def _write_mesh(part: Part, folder: Path, earlier: Mapping[str, str]) -> str:
    """Write the mesh of a part, unless it is there; return its digest."""
    name = mesh_name(part)
    content = mesh_content(part)
    digest = hashlib.sha256(content).hexdigest()
    if earlier.get(name) != digest:
        with replacing(folder / name) as file:
            file.write(content)
    return digest


@contextmanager
def own_folder(folder: Path) -> Iterator[None]:
    """Keep other processes from packing into a folder while the block runs.

    Parameters
    ----------
    folder : Path
        The folder; it is created.

    Yields
    ------
    None
        While the folder is locked.

    Raises
    ------
    ArgumentError
        If it is a file.
    BusyError
        If another process packs into it.
    """
    if folder.exists() and not folder.is_dir():
        raise ArgumentError(f"{folder} is a file: choose a folder")
    folder.mkdir(parents=True, exist_ok=True)
    with claimed(folder / ".lock", folder):
        yield
