"""Paths of mesh files in files about packings: relative, and never out of their folder."""

from __future__ import annotations

from os.path import realpath
from pathlib import Path, PurePosixPath, PureWindowsPath

from packit_sim.core.errors import MeshError
from packit_sim.core.files import exists

MAX_LEVELS = 8
"""How many folders above a file are searched."""


def is_inside(path: str) -> bool:
    """Return whether a path with "/" between folders stays inside the folder that it starts in."""
    parts = PurePosixPath(path).parts
    outside = path.startswith("/") or PureWindowsPath(path).anchor or "\0" in path
    return bool(parts) and not outside and ".." not in parts


def root_of(file: Path, path: str) -> Path | None:
    """Find the folder that a path starts in: that of a file, or the nearest one above it.

    Parameters
    ----------
    file : Path
        The file that contains the path.
    path : str
        A path that stays inside.

    Returns
    -------
    Path or None
        The nearest folder in which there is such a file.
    """
    folders = file.absolute().parents[: MAX_LEVELS + 1]
    return next((each for each in folders if exists(each / path) and (each / path).is_file()), None)


def file_inside(folder: Path, path: str) -> Path:
    """Return the file of a path that stays inside a folder, also where links lead.

    Parameters
    ----------
    path : str
        The path, with "/" between folders.

    Returns
    -------
    Path
        The file, which need not exist.

    Raises
    ------
    MeshError
        If the path or a link on it leads out of the folder.
    """
    file = folder / path
    if not is_inside(path) or not Path(realpath(file)).is_relative_to(realpath(folder)):
        raise MeshError(f"{file} is not inside {folder}: no path or link may lead out of it")
    return file
