"""Manifests: records next to files of packs that describe their content.

A file and its manifest can't be replaced in one operation. So the new manifest is written under a
separate name first. Then the file is replaced, and then the manifest is renamed. At any moment, one
of the two manifests describes the file.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from msgspec import Struct, structs

from packit_sim.core import typed_json
from packit_sim.core.choices import Split
from packit_sim.core.errors import PackFormatError
from packit_sim.core.files import (
    followed,
    read_whole,
    remove_unfinished,
    replace_text,
    replacing,
)
from packit_sim.core.version import __version__
from packit_sim.game.datasets.packs import FORMAT, LibraryRef
from packit_sim.game.datasets.provenance import Count

SUFFIX = ".manifest.json"
"""A manifest's name is the whole name of its file, and this suffix."""

_PACKS = ".jsonl"

_HERE = "./"
"""The prefix of the source of a library in the manifest's folder."""


class Manifest(Struct, frozen=True, omit_defaults=True):
    """The record next to a file of packs.

    Attributes
    ----------
    format : int
        The version of the file's format.
    version : str
        The version of PackIt-Sim that wrote the file.
    sha256 : str
        The SHA-256 of the file, in hex.
    libraries : tuple of LibraryRef
        The libraries of the packs, in the order of their first pack.
    split : Split, optional
        The split of the library that the packs' shapes belong to.
    """

    format: int
    version: str
    packs: Count
    sha256: str
    libraries: tuple[LibraryRef, ...]
    split: Split | None = None

    @classmethod
    def read(cls, path: Path) -> Manifest:
        """Read a manifest.

        Returns
        -------
        Manifest
            The record; a library in the same folder has its absolute path.

        Raises
        ------
        PackFormatError
            If the file can't be read or is not a manifest; the message does not name the file.
        """
        try:
            data = read_whole(path)
        except OSError as error:
            raise PackFormatError(str(error.strerror)) from None
        found = typed_json.decode(data, cls, PackFormatError, "a manifest")
        folder = path.absolute().parent
        return structs.replace(
            found, libraries=tuple(_absolute(ref, folder) for ref in found.libraries)
        )

    def describes(self, data: bytes) -> bool:
        """Return whether this is the manifest of a file with the given content."""
        return self.sha256 == hashlib.sha256(data).hexdigest()

    def to_json(self) -> str:
        """Write the manifest as JSON, with the sources of the libraries."""
        record = typed_json.builtins(self)
        record["libraries"] = [
            ref.facts() if ref.source is None else {**ref.facts(), "source": ref.source}
            for ref in self.libraries
        ]
        return json.dumps(record, indent=1) + "\n"


def manifest_path(path: Path) -> Path:
    """Return the path of the manifest of a file, the same for every path that leads there."""
    target = followed(path)
    return target.with_name(target.name + SUFFIX)


def former_manifest_path(path: Path) -> Path:
    """Return the path that the manifest of a file had in former versions: one for each stem."""
    return path.with_suffix(SUFFIX)


def find_manifest(path: Path, data: bytes) -> Path | None:
    """Find the manifest of a file, also under the name that it had in former versions.

    Parameters
    ----------
    data : bytes
        Its content.

    Returns
    -------
    Path or None
        The manifest that describes the content; if there is none, the manifest that should, or
        None. A manifest with the former name may belong to another file of the same stem: unless
        the file is a ".jsonl" file, it counts only if it describes the content.
    """
    own, former = manifest_path(path), former_manifest_path(path)
    given = path.with_name(path.name + SUFFIX)
    for candidate in (own, _new_manifest_path(path), given, former):
        manifest = _read(candidate)
        if manifest is not None and manifest.describes(data):
            return candidate
    if own.exists():
        return own
    return former if path.suffix == _PACKS and _read(former) is not None else None


def write_described(path: Path, data: bytes, packs: int, libraries: Sequence[LibraryRef]) -> None:
    """Write a file of packs with its manifest; they match even if the process is killed.

    Parameters
    ----------
    data : bytes
        Its content.
    packs : int
        The number of its packs.
    libraries : sequence of LibraryRef
        The libraries of its packs.

    Raises
    ------
    PackFormatError
        If a file that is not a manifest has the name of the manifest.
    """
    _check_replaceable(path)
    former = _former_manifest(path)
    digest = hashlib.sha256(data).hexdigest()
    folder = manifest_path(path).absolute().parent
    refs = tuple(_relative(ref, folder) for ref in libraries)
    manifest = Manifest(FORMAT, __version__, packs, digest, refs)
    new = _new_manifest_path(path)
    try:
        replace_text(new, manifest.to_json())
        with replacing(path) as file:
            file.write(data)
    except BaseException:
        new.unlink(missing_ok=True)
        raise
    os.replace(new, manifest_path(path))
    if former is not None:
        former.unlink(missing_ok=True)


def prepare(path: Path) -> None:
    """Prepare the writing of a file with its manifest, before the work.

    What a killed process left is finished or removed; the caller has the file's lock.

    Raises
    ------
    PackFormatError
        If a file that is not a manifest has the name of the manifest.
    """
    _check_replaceable(path)
    new = _new_manifest_path(path)
    remove_unfinished(path)
    remove_unfinished(new)
    manifest = _read(new)
    if manifest is not None and path.exists() and manifest.describes(path.read_bytes()):
        os.replace(new, manifest_path(path))
    else:
        new.unlink(missing_ok=True)


def _check_replaceable(path: Path) -> None:
    """Raise PackFormatError if a file that is not a manifest has the name of a file's manifest."""
    own = manifest_path(path)
    if own.exists() and _read(own) is None:
        raise PackFormatError(
            f"{own} is not a manifest of packs, and is not overwritten: "
            f"move it, or choose another name than {path.name}"
        )


def _new_manifest_path(path: Path) -> Path:
    """Return the path of a manifest that is written before its file."""
    own = manifest_path(path)
    return own.with_name(f"{own.name}.new")


def _former_manifest(path: Path) -> Path | None:
    """Return the manifest that describes a file under its former name, if there is one."""
    manifest = _read(former_manifest_path(path))
    if manifest is None or not path.exists() or not manifest.describes(path.read_bytes()):
        return None
    return former_manifest_path(path)


def _relative(ref: LibraryRef, folder: Path) -> LibraryRef:
    """Record a library in a folder by its path from there, so that the folder can be moved."""
    if ref.source is None or not Path(ref.source).is_relative_to(folder):
        return ref
    return replace(ref, source=_HERE + Path(ref.source).relative_to(folder).as_posix())


def _absolute(ref: LibraryRef, folder: Path) -> LibraryRef:
    """Return a library with an absolute path, if it is recorded by its path from a folder."""
    if ref.source is None or not ref.source.startswith(_HERE):
        return ref
    return replace(ref, source=str(folder / ref.source))


def _read(path: Path) -> Manifest | None:
    """Read a manifest; None if there is none, or if the file is not a manifest."""
    try:
        return Manifest.read(path)
    except PackFormatError:
        return None
