"""Files of packs: JSON Lines with a manifest, found by a dataset's name or a path."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from msgspec import Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import PackFormatError, located
from packit_sim.core.files import replace_text
from packit_sim.core.version import __version__
from packit_sim.datasets.packs import FORMAT, LibraryRef, Pack, Task
from packit_sim.datasets.provenance import Count
from packit_sim.libraries.library import ShapeLibrary, assets_folder
from packit_sim.libraries.splits import SPLITS, Split

STARTER_PACKS = "starter"
"""The name of the small built-in dataset."""

WHOLE = "packs"
"""The name of the only file, "packs.jsonl", of a dataset without splits."""


class Manifest(Struct, frozen=True, omit_defaults=True):
    """The record next to a file of packs.

    Attributes
    ----------
    format : int
        The version of the file's format.
    version : str
        The version of PackIt-Sim that wrote the file.
    packs : int
        The number of packs.
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

        Parameters
        ----------
        path : Path
            The file.

        Returns
        -------
        Manifest
            The record.

        Raises
        ------
        PackFormatError
            If the file can't be read or is not a manifest; the message does not name the file.
        """
        try:
            data = path.read_bytes()
        except OSError as error:
            raise PackFormatError(str(error.strerror)) from None
        return typed_json.decode(data, cls, PackFormatError, "a manifest")


def manifest_path(path: Path) -> Path:
    """Return the path of a dataset's manifest."""
    return path.with_suffix(".manifest.json")


def builtin_datasets() -> tuple[str, ...]:
    """Return the names of the built-in datasets."""
    return tuple(sorted(path.name for path in (assets_folder() / "packs").iterdir()))


def dataset_path(source: Path | str) -> Path:
    """Return the folder of a built-in dataset by its name, or else the path itself."""
    built_in = assets_folder() / "packs" / str(source)
    return built_in if str(source) in builtin_datasets() else Path(source)


def dataset_file(source: Path | str, split: str | None = None) -> Path:
    """Find the JSON Lines file of a dataset.

    Parameters
    ----------
    source : Path or str
        The name of a built-in dataset, such as "starter", or the path of a file or a folder.
    split : str, optional
        Which file of the folder; by default "packs", if it is the only one.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    PackFormatError
        If there is no such dataset, or it does not have the split.
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


def dataset_files(source: Path | str, split: str | None = None) -> tuple[Path, ...]:
    """Find the files of a dataset: train, test, validation, and others.

    Parameters
    ----------
    source : Path or str
        The name of a built-in dataset, or a path.
    split : str, optional
        A split, for its file alone.

    Returns
    -------
    tuple of Path
        One file or more.

    Raises
    ------
    PackFormatError
        If there is none.
    """
    path = dataset_path(source)
    if split is not None or not path.is_dir():
        return (dataset_file(source, split),)
    known = {name: n for n, name in enumerate(SPLITS)}
    files = folder_files(path)
    return tuple(sorted(files, key=lambda file: (known.get(file.stem, len(known)), file.stem)))


def folder_files(folder: Path) -> list[Path]:
    """Find the files of packs in a folder, sorted by name, or raise PackFormatError."""
    files = sorted(folder.glob("*.jsonl"))
    if not files:
        raise PackFormatError(f"{folder} is a folder without packs: it has no .jsonl file")
    return files


def load_tasks(
    source: Path | str, library: ShapeLibrary, split: str | None = None
) -> tuple[Task, ...]:
    """Load the tasks of a dataset, or of one of its splits (see `dataset_file`)."""
    return tuple(pack.task(library) for pack in read_packs(dataset_file(source, split)))


def write_packs(path: Path | str, packs: Iterable[Pack]) -> None:
    """Write a JSON Lines file of packs and its manifest; the file is written whole or not at all.

    Parameters
    ----------
    path : Path or str
        The file; its folder is created.
    packs : iterable of Pack
        The packs.
    """
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
    """Read a file of packs.

    Parameters
    ----------
    path : Path or str
        The JSON Lines file.
    manifest : bool, default: True
        Whether to compare the file with its manifest, if it has one.

    Returns
    -------
    list of Pack
        One pack or more.

    Raises
    ------
    PackFormatError
        If the file can't be read, a line is not a pack, or the manifest has another digest. The
        message names the file, the line and the field.
    """
    path = Path(path)
    data = read_bytes(path)
    packs = []
    for number, line in numbered_lines(data):
        try:
            packs.append(Pack.from_json(line))
        except PackFormatError as error:
            raise PackFormatError(f"{path}, line {number}: {error}") from None
    if not packs:
        raise PackFormatError(f"{path} holds no packs")
    described = manifest_path(path)
    if manifest and described.exists():
        with located(f"{described} is no manifest", PackFormatError):
            digest = Manifest.read(described).sha256
        if digest != hashlib.sha256(data).hexdigest():
            raise PackFormatError(
                f"{path} is not the file that {described.name} describes: its SHA-256 differs"
            )
    return packs


def read_bytes(path: Path) -> bytes:
    """Read a file, or raise PackFormatError."""
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:
        problem = error.strerror if isinstance(error, OSError) else error
        raise PackFormatError(f"packs can't be read from {path}: {problem}") from None


def numbered_lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the lines that are not blank, with their numbers from 1."""
    for number, line in enumerate(data.split(b"\n"), start=1):
        if line.strip():
            yield number, line
