"""The record of packed parts in JSON, from which `pack` resumes the search."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackFormatError
from packit_sim.core.files import claimed, replace_text, replacing
from packit_sim.core.plain_text import plain
from packit_sim.core.version import __version__
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.packings.packing_files import obj_text
from packit_sim.parts.reading.part import Part
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

_PACKING_FILE = re.compile(r"packing(-\d+)?\.(3mf|glb|stl|png|html)")

_WHOLE = (".3mf", ".dae", ".glb", ".obj", ".off", ".ply", ".stl")
"""Suffixes of mesh files that need no others."""


class _RecordedFiles(Struct):
    files: tuple[str, ...]


def write_record(
    packed: PackedParts, found: Check | None, folder: Path, written: Sequence[Path]
) -> list[Path]:
    """Write a packing and its meshes so that `packit verify` can check them.

    Parameters
    ----------
    packed : PackedParts
        The packing.
    found : Check, optional
        The result of its check; without it the summary says that it is not done.
    written : sequence of Path
        The packing's other files, also those to come; those of an earlier packing are removed.

    Returns
    -------
    list of Path
        The files: the meshes, and the record, which is written last.

    Raises
    ------
    OSError
        If a file can't be written.
    """
    meshes: dict[int, str] = {}
    files: list[Path] = []
    items = []
    for number, packing in enumerate(packed.packings):
        for one in packing.placements:
            if one.type not in meshes:
                file = _write_mesh(packed.part(one).part, folder / MESHES, set(meshes.values()))
                meshes[one.type] = f"{MESHES}/{file.name}"
                files.append(file)
            items.append(
                {
                    "name": packed.part(one).part.name,
                    "mesh": meshes[one.type],
                    "box": number,
                    "pose": packed.pose(one).tolist(),
                }
            )
    task = packed.task
    obstacles: list[dict[str, Any]] = []
    taken = set(meshes.values())
    for each in task.obstacles:
        file = _write_mesh(each.part, folder / MESHES, taken)
        files.append(file)
        mesh = f"{MESHES}/{file.name}"
        taken.add(mesh)
        what = {"name": each.part.name, "is part": each in task.fixed}
        obstacles.append({**what, "mesh": mesh, "pose": each.part.matrix(each.unit).tolist()})
    boxes = [packing.container for packing in packed.packings]
    record: dict[str, Any] = {
        "created by": f"PackIt-Sim {__version__}, packit pack",
        "box": list(boxes[0].size),
        "boxes": [list(box.size) for box in boxes],
        "box names": [box.name for box in boxes],
        "unit": task.unit,
        "clearance": task.settings.clearance,
        "wall clearance": task.settings.wall_clearance,
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
        "files": [path.name for path in written],
        "task": task.digest,
        "searches": packed.searches,
    }
    record["request"] = request(task, record, folder)
    stale = _files(folder)
    _replace(folder, record)
    for name in sorted(stale):
        (folder / name).unlink(missing_ok=True)
    return [*files, folder / RECORD]


def update_record(packed: PackedParts, found: Check, folder: Path, written: Sequence[Path]) -> None:
    """Add the result of the check to the record of a packing, and name its other files.

    Raises
    ------
    OSError
        If the file can't be written.
    """
    record = json.loads((folder / RECORD).read_bytes())
    record["summary"] = summary(packed, found)
    record["files"] = [path.name for path in written]
    _replace(folder, record)


def _replace(folder: Path, record: dict[str, Any]) -> None:
    replace_text(folder / RECORD, json.dumps(record, indent=1, ensure_ascii=False) + "\n")


def _files(folder: Path) -> set[str]:
    """Return the names of the files that an earlier record lists, and of what comes after it."""
    try:
        record = typed_json.decode((folder / RECORD).read_bytes(), _RecordedFiles, PackFormatError)
    except (OSError, PackFormatError):
        return set()
    listed = {name for name in record.files if _PACKING_FILE.fullmatch(name)}
    films = {f"{Path(name).stem}{FILM}" for name in listed}
    return {*listed, *films, INSTRUCTIONS}


def _write_mesh(part: Part, folder: Path, taken: set[str]) -> Path:
    """Write a part's mesh: a copy of its file, or OBJ if the file has more or needs others."""
    folder.mkdir(parents=True, exist_ok=True)
    is_copy = part.file is not None and part.node is None and part.file.suffix.lower() in _WHOLE
    suffix = part.file.suffix.lower() if is_copy and part.file else ".obj"
    name, number = f"{part.file_name}{suffix}", 1
    while f"{MESHES}/{name}" in taken:
        number += 1
        name = f"{part.file_name}-{number}{suffix}"
    path = folder / name
    if is_copy and part.file is not None:
        if path.exists() and path.samefile(part.file):
            return path
        with part.file.open("rb") as source, replacing(path) as target:
            shutil.copyfileobj(source, target)
    else:
        vertices = np.asarray(part.mesh.vertices, dtype=float)
        replace_text(path, obj_text(vertices, np.asarray(part.mesh.faces)))
    return path


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
