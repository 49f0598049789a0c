"""Files of packs: datasets in JSON Lines with a manifest, found by name or path."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import PackFormatError
from packit_sim.core.files import replace_text
from packit_sim.core.version import __version__
from packit_sim.datasets.packs import FORMAT, LibraryRef, Pack, Task
from packit_sim.datasets.provenance import Count
from packit_sim.libraries.library import ShapeLibrary, assets_folder
from packit_sim.libraries.splits import Split

STARTER_PACKS = "starter"
"""Name of the dataset that comes with the package."""

WHOLE = "packs"
"""The split of a dataset that has none: the name of its file."""


class Manifest(Struct, frozen=True, omit_defaults=True):
    """What is recorded next to a file of packs.

    Attributes
    ----------
    format : int
        The version of the file's format.
    version : str
        The version of PackIt-Sim that wrote the file.
    packs : int
        The number of packs.
    sha256 : str
        The SHA-256 of the file.
    libraries : tuple of LibraryRef
        The libraries of the packs, in the order of their first pack.
    split : Split, optional
        The split of the library whose shapes the packs hold.
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

        Parameters
        ----------
        path : Path
            The file.

        Returns
        -------
        Manifest
            What it records.

        Raises
        ------
        PackFormatError
            If it can't be read, or is no manifest; the message does not name the file.
        """
        try:
            data = path.read_bytes()
        except OSError as error:
            raise PackFormatError(str(error.strerror)) from None
        return typed_json.decode(data, cls, PackFormatError, "a manifest")


def load_tasks(
    source: Path | str, library: ShapeLibrary, split: str | None = None
) -> tuple[Task, ...]:
    """The tasks of a dataset, or of one of its splits (see `dataset_file`)."""
    return tuple(pack.task(library) for pack in read_packs(dataset_file(source, split)))


def dataset_file(source: Path | str, split: str | None = None) -> Path:
    """The JSON Lines file of a dataset.

    source: the name of one that comes with the package, such as "starter", or a path, of the file
    itself or of a folder. split: which of the folder's files; "packs" where it has that one alone.
    Raises PackFormatError where the split does not go with it.
    """
    path = dataset_path(source)
    if not path.exists():
        raise PackFormatError(
            f"packs can't be read from {path}: No such file or directory; "
            f"datasets that come with the package: {', '.join(builtin_datasets())}"
        )
    if not path.is_dir():
        if split:
            raise PackFormatError(f"{path} has no splits: there is no {split!r} in it")
        return path
    splits = sorted(file.stem for file in path.glob("*.jsonl"))
    if split is None and splits == [WHOLE]:
        split = WHOLE
    if split not in splits:
        raise PackFormatError(
            f"{path} is a folder with the splits {', '.join(splits) or 'none'}: "
            f"{'choose one' if split is None else f'there is no {split!r}'}"
        )
    return path / f"{split}.jsonl"


def dataset_path(source: Path | str) -> Path:
    """The folder of a dataset that comes with the package, or the path itself."""
    built_in = assets_folder() / "packs" / str(source)
    return built_in if str(source) in builtin_datasets() else Path(source)


def builtin_datasets() -> tuple[str, ...]:
    """Names of the datasets that come with PackIt-Sim."""
    return tuple(sorted(path.name for path in (assets_folder() / "packs").iterdir()))


def write_packs(path: Path | str, packs: Iterable[Pack]) -> None:
    """Writes a dataset, whole or not at all: the JSON Lines file and its manifest beside it."""
    path = Path(path)
    packs = list(packs)
    text = "".join(pack.to_json() + "\n" for pack in packs)
    libraries = tuple(dict.fromkeys(pack.library for pack in packs))
    digest = hashlib.sha256(text.encode()).hexdigest()
    manifest = Manifest(FORMAT, __version__, len(packs), digest, libraries)
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_text(path, text)
    replace_text(manifest_path(path), json.dumps(typed_json.builtins(manifest), indent=1) + "\n")


def read_packs(path: Path | str, *, manifest: bool = True) -> list[Pack]:
    """Reads a dataset. Raises PackFormatError that names the file, the line and what is wrong.

    manifest: whether the file must be the one that its manifest describes, where it has one.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PackFormatError(f"packs can't be read from {path}: {error.strerror}") from None
    packs = []
    for number, line in enumerate(data.split(b"\n"), start=1):
        if not line.strip():
            continue
        try:
            packs.append(Pack.from_json(line))
        except PackFormatError as error:
            raise PackFormatError(f"{path}, line {number}: {error}") from None
    if not packs:
        raise PackFormatError(f"{path} holds no packs")
    if manifest and manifest_path(path).exists():
        _check_manifest(manifest_path(path), path, data)
    return packs


def _check_manifest(manifest: Path, path: Path, data: bytes) -> None:
    try:
        digest = Manifest.read(manifest).sha256
    except PackFormatError as error:
        raise PackFormatError(f"{manifest} is no manifest: {error}") from None
    if digest != hashlib.sha256(data).hexdigest():
        raise PackFormatError(
            f"{path} is not the file that {manifest.name} describes: its SHA-256 differs"
        )


def manifest_path(path: Path) -> Path:
    """Where the manifest of a dataset stands."""
    return path.with_suffix(".manifest.json")
