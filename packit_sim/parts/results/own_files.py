"""The files in a folder that `packit pack` may replace: its own, as its record lists them."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from msgspec import Struct, field

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackFormatError
from packit_sim.core.files import digest_of, same_file
from packit_sim.core.plain_text import listed
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.results.record import (
    FILM,
    INSTRUCTIONS,
    MESHES,
    RECORD,
    mesh_content,
    mesh_name,
)

_EXPORT = re.compile(r"packing(-[0-9]+)?\.(3mf|glb|stl|png|html|gif)")

_MESH = re.compile(rf"{MESHES}/[^/\\\0]+\.[a-z0-9]+")


class NotOwnRecordError(ArgumentError):
    """A file has the name of a record, and is none."""


class _Recorded(Struct):
    """The files that a record lists; records of earlier versions have no digests."""

    files: dict[str, str] | tuple[str, ...]
    task: str
    earlier: dict[str, str] = field(name="earlier files", default_factory=dict)


def own_files(folder: Path) -> dict[str, str]:
    """Return SHA-256 of the files that the record in a folder lists and nobody has changed.

    Returns
    -------
    dict of str to str
        The digests, by the names in the folder; none if there is no record.

    Raises
    ------
    NotOwnRecordError
        If there is a file of the record's name that `packit pack` did not write.
    """
    file = folder / RECORD
    if not os.path.lexists(file):
        return {}
    _require_regular(folder, [RECORD])
    try:
        record = typed_json.decode(file.read_bytes(), _Recorded, PackFormatError, "a packing")
    except PackFormatError:
        raise NotOwnRecordError(
            f"{file} is not of `packit pack`: choose another folder, or --force to replace it"
        ) from None
    if isinstance(record.files, tuple):
        return {}
    listed_files = (record.earlier | record.files).items()
    return unchanged(folder, {name: digest for name, digest in listed_files if _is_ours(name)})


def unchanged(folder: Path, files: Mapping[str, str]) -> dict[str, str]:
    """Return those of some files, with their digests, that are there and as they were."""
    return {
        name: digest
        for name, digest in files.items()
        if _is_regular(folder, name) and digest_of(folder / name) == digest
    }


def replaceable(
    folder: Path,
    task: PackTask,
    force: bool = False,
    instructions: bool = False,
    film: bool = False,
) -> dict[str, str]:
    """Return the files that a packing may replace, or refuse if there are others in its way.

    Parameters
    ----------
    folder : Path
        The folder for the packing.
    force : bool
        Whether files of others may be replaced, too.
    instructions : bool
        Whether packing instructions are written as well.
    film : bool
        Whether films are.

    Returns
    -------
    dict of str to str
        Their digests, by their names in the folder.

    Raises
    ------
    ArgumentError
        If a file is in the way that the folder's record does not list, or that somebody has
        changed since; or an input is among the files that may be replaced.
    """
    try:
        found = own_files(folder)
    except NotOwnRecordError:
        if not force:
            raise
        found = {}
    others = [each for each in _in_the_way(folder, task, instructions, film) if each not in found]
    _require_regular(folder, others)
    if others and not force:
        what = "is" if len(others) == 1 else "are"
        raise ArgumentError(
            f"{folder}: {listed(others)} {what} not of `packit pack`, or changed since: choose "
            "another folder, or --force to replace what is there"
        )
    found |= {name: digest_of(folder / name) for name in others}
    inputs = [*task.inputs, *(each.part.file for each in task.all_meshes)]
    for name in (RECORD, *found):
        for file in inputs:
            if file is not None and same_file(folder / name, file):
                raise ArgumentError(
                    f"{file} is an input, and would be replaced: choose another folder"
                )
    return found


def _in_the_way(folder: Path, task: PackTask, instructions: bool, film: bool) -> Iterator[str]:
    """Yield the names of what is where a packing of a task may have its files."""
    if not folder.is_dir():
        return
    has_one_box = len(task.boxes) == 1 and task.boxes[0].count == 1
    for name in sorted(each.name for each in folder.iterdir()):
        export = _EXPORT.fullmatch(name)
        if export and not (has_one_box and export[1]) and (film or f".{export[2]}" != FILM):
            yield name
    if instructions and os.path.lexists(folder / INSTRUCTIONS):
        yield INSTRUCTIONS
    meshes = folder / MESHES
    if meshes.is_symlink() or (meshes.exists() and not meshes.is_dir()):
        yield MESHES
        return
    for each in task.all_meshes:
        name = mesh_name(each.part)
        file = folder / name
        if os.path.lexists(file):
            digest = hashlib.sha256(mesh_content(each.part)).hexdigest()
            if not unchanged(folder, {name: digest}):
                yield name


def is_export(name: str) -> bool:
    """Return whether a file in the folder of a packing has the name of one of its exports."""
    return name == INSTRUCTIONS or bool(_EXPORT.fullmatch(name))


def _is_ours(name: str) -> bool:
    """Return whether a packing may have a file of a name, which a forged record lists."""
    return is_export(name) or bool(_MESH.fullmatch(name))


def _is_regular(folder: Path, name: str) -> bool:
    """Return whether a name is that of a file in a folder, to which no link leads."""
    first = folder / name.partition("/")[0]
    return (folder / name).is_file() and not (folder / name).is_symlink() | first.is_symlink()


def _require_regular(folder: Path, names: Iterable[str]) -> None:
    for name in names:
        if not _is_regular(folder, name):
            raise ArgumentError(f"{folder / name} is not a regular file: choose another folder")
