"""Parts from mesh files, folders, patterns of paths and manifests.

A broken file stops no other.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from packit_sim.core.errors import ArgumentError, LibraryError, MeshError, located
from packit_sim.core.extras import MissingPackageError
from packit_sim.core.files import exists
from packit_sim.core.length_units import UNITS_CM, Unit, check_unit
from packit_sim.libraries.folder import MeshFolder
from packit_sim.libraries.mesh_files import SUFFIXES, read, read_parts
from packit_sim.libraries.raw_meshes import RawPart
from packit_sim.libraries.step_files import SUFFIXES as STEP
from packit_sim.parts.packings.bounds import COUNTS, LENGTHS
from packit_sim.parts.packings.turning import ANY_TURN, Turning
from packit_sim.parts.reading.file_copies import FileCopies, FileCopy
from packit_sim.parts.reading.manifest import MANIFESTS, SURPLUS, ManifestRow, read_manifest
from packit_sim.parts.reading.part import Part, rotation_set
from packit_sim.parts.reading.units import lengths, unit_of

_COUNTED = re.compile(r"(?P<path>.+)=(?P<count>\d{1,30}|max|fill)")

_PLATES = (".3mf", *STEP)
"""Suffixes of files whose scenes are plates of separate parts, unless `split` says otherwise."""


@dataclass(frozen=True)
class UnreadFile:
    """A file that gave no part.

    Attributes
    ----------
    source : str
        The file, or what was asked for.
    reason : str
        Why.
    """

    source: str
    reason: str


@dataclass(frozen=True)
class Reading:
    """The parts that were read, and the files that could not be.

    Attributes
    ----------
    parts : tuple of Part
        The parts, with names that differ.
    unread : tuple of UnreadFile
        The files that could not be read.
    notes : tuple of str
        What the user should know about how files were understood.
    inputs : tuple of Path
        All files that were named: mesh files and manifests.
    """

    parts: tuple[Part, ...]
    unread: tuple[UnreadFile, ...] = ()
    notes: tuple[str, ...] = ()
    inputs: tuple[Path, ...] = ()


@dataclass(frozen=True)
class ReadSettings:
    """Settings for reading files.

    Parameters
    ----------
    unit : str
        The unit of length of files that don't define it, such as STL.
    up : str, optional
        The axis that points up in all files, "x", "y" or "z"; by default as their formats define.
    rotations : str
        The rotations of parts whose manifest does not say.
    split : bool, optional
        Whether each part of a scene is packed by itself; by default those of 3MF and STEP are.
    accuracy : float, optional
        Largest deviation of tessellations of STEP files, in mm; by default relative to each part.
    turning : Turning
        Limits on how parts turn, where a manifest does not say.

    Raises
    ------
    ArgumentError
        If a setting is not possible.
    """

    unit: Unit = "mm"
    up: str | None = None
    rotations: str = "cube"
    split: bool | None = None
    accuracy: float | None = None
    turning: Turning = ANY_TURN

    def __post_init__(self) -> None:
        check_unit(self.unit)
        rotation_set(self.rotations)


def find_parts(
    sources: Sequence[Part | Path | str], settings: ReadSettings = ReadSettings()
) -> Reading:
    """Read parts.

    Parameters
    ----------
    sources : sequence of Part, Path or str
        Mesh files, with "=4" behind the path for four of it; folders; patterns such as
        "parts/*.stl"; and manifests (.csv or .json).
    settings : ReadSettings
        How files are understood.

    Returns
    -------
    Reading
        The parts, and the files that can't be read.

    Raises
    ------
    ArgumentError
        If there is nothing to read, or nothing could be read.
    """
    if isinstance(sources, (Part, Path, str)):
        sources = [sources]
    parts: list[Part] = []
    unread: list[UnreadFile] = []
    notes: list[str] = []
    inputs: dict[Path, None] = {}
    read_once = cache(partial(_raw_parts, FileCopies()))  # a manifest may name a file many times
    for source in sources:
        if isinstance(source, Part):
            parts.append(source)
            continue
        if Path(source).suffix.lower() in MANIFESTS:
            inputs[Path(source)] = None
        for row in _rows(source, unread, notes):
            inputs[row.file] = None
            try:
                parts += _parts(row, settings, notes, read_once)
            except (MeshError, MissingPackageError, OSError) as error:
                reason = str(error).removeprefix(f"{row.file}: ")
                unread.append(UnreadFile(str(row.file), reason))
            except ArgumentError as error:
                if row.where is None:
                    raise
                unread.append(UnreadFile(row.where, str(error)))
    if not parts:
        if not unread:
            raise ArgumentError(
                "no parts: name mesh files, a folder or a manifest, with counts of at least 1"
            )
        first = unread[0]
        others = len(unread) - 1
        more = f" (and {others} other file{'s' * (others > 1)})" if others else ""
        raise ArgumentError(f"no part can be read: {first.source}: {first.reason}{more}")
    assumed = {each.file for each in parts if each.file and not defines_unit(each.file)}
    if assumed:
        files = "1 file" if len(assumed) == 1 else f"{len(assumed)} files"
        notes.insert(0, f"{files} without a unit of length read as {settings.unit}")
    own_notes = dict.fromkeys(notes)
    return Reading(tuple(with_own_names(parts)), tuple(unread), tuple(own_notes), tuple(inputs))


def defines_unit(file: Path) -> bool:
    """Return whether files with the suffix of this one define their unit of length."""
    return file.suffix.lower() in (".3mf", ".glb", ".gltf", ".dae", *STEP)


def _rows(source: Path | str, unread: list[UnreadFile], notes: list[str]) -> Iterator[ManifestRow]:
    """Yield the files that a source names; add rows of a manifest that can't be read, and notes."""
    if source == "":  # as a path it would be the current folder
        raise ArgumentError("the name of a file is empty")
    path = Path(source)
    settings: Mapping[str, Any] = {"count": 1}
    match = _COUNTED.fullmatch(str(source))
    if match and not exists(path):
        path = Path(match["path"])
        settings = SURPLUS.get(match["count"]) or {"count": int(match["count"])}
        if settings["count"] == 0:
            return
    before, _, behind = str(source).rpartition("=")
    if before and not match and not exists(path) and exists(Path(before)):
        raise ArgumentError(
            f"{source}: {behind!r} is not a count: choose a number, as in {before}=4, "
            f"or {' or '.join(SURPLUS)}"
        )
    if exists(path) and path.is_dir():
        for file in _folder_files(path):
            yield ManifestRow(file, settings)
    elif path.suffix.lower() in MANIFESTS:
        manifest = read_manifest(path)
        notes += manifest.notes
        unread += [UnreadFile(where, reason) for where, reason in manifest.unread]
        for row in manifest.rows:
            count = row.count * settings["count"]
            yield replace(row, settings={**row.settings, **settings, "count": count})
    elif exists(path) or not glob.has_magic(str(path)):
        yield ManifestRow(path, settings)
    else:
        files = sorted(glob.glob(str(path)))
        if not files:
            raise ArgumentError(f"{path}: no file has such a name")
        for name in files:
            yield ManifestRow(Path(name), settings)


def _folder_files(path: Path) -> list[Path]:
    try:
        folder = MeshFolder(path)
    except LibraryError:
        raise ArgumentError(f"{path}: no mesh file in it ({', '.join(SUFFIXES)})") from None
    return [Path(folder.candidate(id).source) for id in folder.categories]


def _raw_parts(
    copies: FileCopies, file: Path, split: bool, accuracy: float | None
) -> tuple[FileCopy, list[RawPart]]:
    """Read a file once: a copy of it, and its parts."""
    if not exists(file):
        raise MeshError("there is no such file")
    contents: dict[str, bytes] = {}
    if split:
        parts = read_parts(file, accuracy, contents.setdefault)
    else:
        parts = [RawPart("", read(file, accuracy, contents.setdefault))]
    return copies.add(contents), parts


def _parts(
    row: ManifestRow,
    settings: ReadSettings,
    notes: list[str],
    read_once: Callable[[Path, bool, float | None], tuple[FileCopy, list[RawPart]]],
) -> list[Part]:
    """Read the parts of a file."""
    suffix = row.file.suffix.lower()
    split = suffix in _PLATES if settings.split is None else settings.split
    copy, raw_parts = read_once(row.file, split, settings.accuracy)
    if not split and raw_parts[0].raw.parts > 1:
        note = (
            f"{row.file.name}: its {raw_parts[0].raw.parts} meshes are packed as one part "
            "(--separate packs each by itself)"
        )
        notes.append(note)
    found = []
    for each in raw_parts:
        options = {"rotations": settings.rotations, **row.settings}
        name = str(options.pop("name", row.file.stem))
        if len(raw_parts) > 1 or (each.node and each.name and "name" not in row.settings):
            name = f"{name}/{each.name}"
        options["count"] = row.count * each.count
        if options.get("as_many_as_fit"):
            options["count"] = min(options["count"], int(COUNTS.high))
        unit = options.pop("unit", None)
        clearance = options.pop("clearance", None)
        limits = {key: options.pop(key) for key in ("max_tilt", "down") if key in options}
        notes += [f"{row.file.name}: {note}" for note in each.raw.notes]
        known, unit_cm = _unit(each.raw.unit_cm, str(unit or settings.unit))
        if clearance is not None:
            with located("clearance", ArgumentError):
                options["clearance"] = own_length(clearance, known, unit_cm)
        found.append(
            Part(
                name,
                each.raw.mesh,
                unit=known,
                unit_cm=unit_cm,
                up=settings.up or each.raw.up,
                file=row.file,
                copy=copy,
                node=each.node,
                deviation=each.raw.deviation,
                turning=replace(settings.turning, **limits),
                **options,
            )
        )
    return found


def own_length(text: str, unit: Unit, unit_cm: float | None) -> float:
    """Read a length in a file's unit, which a text without one has.

    Parameters
    ----------
    unit_cm : float, optional
        The file's unit in cm if `unit` is not its name.

    Returns
    -------
    float
        The length.

    Raises
    ------
    ArgumentError
        If the text is something else.
    """
    if unit_of(text) is None:
        return lengths(text, 1, unit)[0]
    return lengths(text, 1, unit)[0] * (1.0 if unit_cm is None else UNITS_CM[unit] / unit_cm)


def _unit(unit_cm: float | None, assumed: str) -> tuple[Unit, float | None]:
    """Return the name of a file's unit, and its length in cm if no name fits."""
    if unit_cm is None:
        return check_unit(assumed), None
    if unit_cm not in LENGTHS:
        raise MeshError(f"its unit of length is {unit_cm!r} cm: it must be {LENGTHS}")
    for name, centimetres in UNITS_CM.items():
        if abs(centimetres / unit_cm - 1) < 1e-9:
            return name, None
    return "cm", unit_cm


def with_own_names(parts: Sequence[Part], others: Iterable[str] = ()) -> Iterator[Part]:
    """Yield parts with names that differ from each other and from those of others."""
    taken = set(others)
    last: dict[str, int] = {}
    for part in parts:
        name = part.name
        while name in taken:
            last[part.name] = last.get(part.name, 1) + 1
            name = f"{part.name}-{last[part.name]}"
        taken.add(name)
        yield part if name == part.name else replace(part, name=name)
