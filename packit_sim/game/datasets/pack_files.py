"""Files of packs: JSON Lines with a manifest, found by a dataset's name or a path."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

from packit_sim.core.assets import assets_folder
from packit_sim.core.choices import SPLITS
from packit_sim.core.errors import LibraryError, PackFormatError, located
from packit_sim.core.suggestions import did_you_mean
from packit_sim.game.datasets.builtin import DEFAULT_LIBRARY, builtin_datasets
from packit_sim.game.datasets.manifests import Manifest, find_manifest, write_described
from packit_sim.game.datasets.packs import LibraryRef, Pack, Task
from packit_sim.libraries.data_files import numbered_lines, read_bytes
from packit_sim.libraries.library import ShapeLibrary, builtin_names

WHOLE = "packs"
"""The name of the only file, "packs.jsonl", of a dataset without splits."""


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
        The file of the folder to choose; by default "packs", if it is the only one.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    PackFormatError
        If there is no such dataset, or it does not have the split.

    Examples
    --------
    >>> from packit_sim import dataset_file
    >>> dataset_file("starter").name
    'packs.jsonl'
    >>> dataset_file("everyday-v1", "test").name
    'test.jsonl'
    >>> dataset_file("everyday-v1")
    Traceback (most recent call last):
        ...
    packit_sim...PackFormatError: ... with the splits test, train, validation: choose one
    """
    path = dataset_path(source)
    if not path.exists():
        raise PackFormatError(
            f"packs can't be read from {path}: No such file or directory; "
            f"{did_you_mean(str(source), builtin_datasets())}"
            f"datasets that come with the package: {', '.join(builtin_datasets())}"
        )
    if not path.is_dir():
        if split:
            raise PackFormatError(f"{path} has no splits: there is no {split!r} in it")
        return path
    splits = [file.stem for file in folder_files(path)]
    if split is None and WHOLE in splits and not set(SPLITS) & set(splits):
        split = WHOLE
    if split not in splits:
        raise PackFormatError(
            f"{path} is a folder with the splits {', '.join(splits)}: "
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
    if not any(file.stem in known for file in files):  # results may be next to the only file
        files = [file for file in files if file.stem == WHOLE] or files
    return tuple(sorted(files, key=lambda file: (known.get(file.stem, len(known)), file.stem)))


def folder_files(folder: Path) -> list[Path]:
    """Find the files of packs in a folder, sorted by name, or raise PackFormatError."""
    files = sorted(folder.glob("*.jsonl"))
    if not files:
        raise PackFormatError(f"{folder} is a folder without packs: it has no .jsonl file")
    return files


def load_tasks(
    source: Path | str, library: ShapeLibrary | None = None, split: str | None = None
) -> tuple[Task, ...]:
    """Load the tasks of a dataset.

    Parameters
    ----------
    source : Path or str
        The name of a built-in dataset, or a path (see `dataset_file`).
    library : ShapeLibrary, optional
        The library of its shapes; by default the one that the dataset records.

    Returns
    -------
    tuple of Task
        The tasks, in the order of the packs.

    Raises
    ------
    PackFormatError
        If there is no such dataset, or it can't be read.
    LibraryError
        If the recorded library can't be opened, or has changed.

    Examples
    --------
    >>> from packit_sim import load_tasks
    >>> tasks = load_tasks("starter")
    >>> len(tasks)
    10
    >>> len(tasks[0].items)
    35
    """
    file = dataset_file(source, split)
    packs = read_packs(file)
    library = library or dataset_library(file)
    return tuple(pack.task(library) for pack in packs)


def dataset_library(source: Path | str, split: str | None = None) -> ShapeLibrary:
    """Open the library that a dataset records.

    Parameters
    ----------
    source : Path or str
        The name of a built-in dataset, or a path.
    split : str, optional
        The split that is needed; by default all.

    Returns
    -------
    ShapeLibrary
        The library; the built-in one if the dataset has no readable pack.

    Raises
    ------
    PackFormatError
        If there is no such dataset.
    LibraryError
        If the library is not where the dataset records it, or has changed since.
    """
    refs = (ref for file in dataset_files(source, split) for ref in _recorded(file))
    return recorded_library(refs, source)


def recorded_library(refs: Iterable[LibraryRef], where: Path | str) -> ShapeLibrary:
    """Open the one library that packs refer to.

    Parameters
    ----------
    refs : iterable of LibraryRef
        The library of each pack.
    where : Path or str
        The dataset, for messages.

    Returns
    -------
    ShapeLibrary
        The library; the built-in one if there are no packs.

    Raises
    ------
    LibraryError
        If there are several libraries, or the one is not where it was, or has changed.
    """
    known = _with_sources(refs)
    if len(known) > 1:
        names = ", ".join(f"{ref.name!r} {ref.version} ({ref.digest[:12]})" for ref in known)
        raise LibraryError(
            f"{where} has packs of several libraries, {names}: choose one (--library)"
        )
    if not known:
        return ShapeLibrary.open(DEFAULT_LIBRARY)
    (ref,) = known
    source = ref.source or (ref.name if ref.name in builtin_names() else None)
    if source is None:
        raise LibraryError(
            f"{where} does not record where its library {ref.name!r} is: choose it (--library)"
        )
    try:
        library = ShapeLibrary.open(source)
    except LibraryError as error:
        raise LibraryError(
            f"{where} records its library {ref.name!r} at {source}, where it can't be opened "
            f"({error}): if it has moved, choose it (--library)"
        ) from None
    if LibraryRef.of(library) != ref:
        raise LibraryError(
            f"{where} records its library {ref.name!r} {ref.version} at {source} with the digest "
            f"{ref.digest[:12]}, but there is {library.name!r} {library.version} with the digest "
            f"{library.digest[:12]}: restore it, or choose the right one (--library)"
        )
    return library


def _recorded(file: Path) -> tuple[LibraryRef, ...]:
    """Return the libraries of a file's manifest, or else that of its first readable pack."""
    data = read_bytes(file)
    described = find_manifest(file, data)
    if described is not None:
        try:
            return Manifest.read(described).libraries
        except PackFormatError:
            pass  # the reader of the packs reports it
    for _, line in numbered_lines(data):
        try:
            return (Pack.from_json(line).library,)
        except PackFormatError:
            continue
    return ()


def _with_sources(refs: Iterable[LibraryRef]) -> tuple[LibraryRef, ...]:
    """Return each library once, in the order of their first pack, with its source if known."""
    known: dict[LibraryRef, LibraryRef] = {}
    for ref in refs:
        if ref not in known or known[ref].source is None:
            known[ref] = ref
    return tuple(known.values())


def write_packs(path: Path | str, packs: Iterable[Pack]) -> None:
    """Write a JSON Lines file of packs and its manifest; the file is written whole or not at all.

    Parameters
    ----------
    path : Path or str
        The file; its folder is created.

    Raises
    ------
    PackFormatError
        If a file that is not a manifest has the name of the manifest.

    Examples
    --------
    >>> from pathlib import Path
    >>> from packit_sim import dataset_file, read_packs, write_packs
    >>> packs = read_packs(dataset_file("starter"))
    >>> write_packs("dense/packs.jsonl", [pack for pack in packs if pack.density > 0.5])
    >>> sorted(file.name for file in Path("dense").iterdir())
    ['packs.jsonl', 'packs.jsonl.manifest.json']
    >>> len(read_packs("dense/packs.jsonl"))
    5
    """
    path = Path(path)
    packs = list(packs)
    data = "".join(pack.to_json() + "\n" for pack in packs).encode()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_described(path, data, len(packs), _with_sources(pack.library for pack in packs))


def read_packs(path: Path | str) -> list[Pack]:
    """Read a file of packs, and compare it with its manifest if it has one.

    Parameters
    ----------
    path : Path or str
        The JSON Lines file.

    Returns
    -------
    list of Pack
        One pack or more.

    Raises
    ------
    PackFormatError
        If the file can't be read, a line is not a pack, or the manifest has another digest. The
        message names the file, the line and the field.

    Examples
    --------
    >>> from packit_sim import dataset_file, read_packs
    >>> packs = read_packs(dataset_file("starter"))
    >>> [round(pack.density, 2) for pack in packs[:3]]
    [0.43, 0.48, 0.52]
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
    described = find_manifest(path, data)
    if described is not None:
        with located(f"{described} is no manifest", PackFormatError):
            manifest = Manifest.read(described)
        if not manifest.describes(data):
            raise PackFormatError(
                f"{path} is not the file that {described.name} describes: its SHA-256 differs"
            )
        refs = {ref: ref for ref in manifest.libraries}
        packs = [
            dataclasses.replace(pack, library=refs.get(pack.library, pack.library))
            for pack in packs
        ]
    return packs
