"""`packit generate --splits`: one dataset with a train, a validation and a test split."""

from __future__ import annotations

import os
from pathlib import Path

from packit_sim.cli.library_import import import_shown
from packit_sim.cli.output import prepare_folder
from packit_sim.cli.terminal import console
from packit_sim.core.choices import SPLITS, Split
from packit_sim.core.errors import ArgumentError, LibraryError
from packit_sim.game.generation.puzzles import LIBRARY_FOLDER
from packit_sim.libraries.importer import ImportSettings
from packit_sim.libraries.library import ShapeLibrary

ORDER: tuple[Split, ...] = ("train", "validation", "test")
"""The splits in the order of the option `--splits`."""


def library_with_splits(source: str, out: Path, workers: int) -> ShapeLibrary:
    """Open a library that has splits; one that has none is imported into the dataset's folder.

    Parameters
    ----------
    source : str
        The name or path of the library, such as a folder of mesh files.
    out : Path
        The folder of the dataset.
    workers : int
        The number of processes; 0 for one per core.

    Returns
    -------
    ShapeLibrary
        The library: if it was imported by an earlier run of the command, that one.

    Raises
    ------
    ArgumentError
        If the dataset's folder has a library of other meshes, or a split has no shape.
    """
    opened = ShapeLibrary.open(source)
    if not _has_splits(opened):
        opened = _imported(opened, source, out, workers)
    for split in SPLITS:
        if not len(opened.split(split)):
            raise ArgumentError(
                f"{source} has {len(opened)} shapes, and none of them is in the split {split}: "
                "three different objects or more are needed"
            )
    return opened


def _has_splits(library: ShapeLibrary) -> bool:
    try:
        return bool(library.source.splits)
    except LibraryError:
        return False


def _imported(opened: ShapeLibrary, source: str, out: Path, workers: int) -> ShapeLibrary:
    """Import a library; its version records the digest of the meshes."""
    folder, version = out / LIBRARY_FOLDER, opened.digest[:12]
    if folder.exists():
        library = ShapeLibrary.open(folder)
        if (library.name, library.version) != (opened.name, version):
            raise ArgumentError(
                f"{folder} is not the library of the meshes of {source} as they are now: choose "
                "another folder, or remove it to begin again"
            )
        console.print(f"{folder} has been imported already", markup=False, soft_wrap=True)
        return library
    prepare_folder(folder)
    settings = ImportSettings(workers=workers or os.cpu_count() or 1)
    report = out / f"{LIBRARY_FOLDER}.report.json"
    return import_shown(
        opened, folder, opened.name, version, settings, source=source, report=report
    )
