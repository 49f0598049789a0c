"""Paths of mesh files in files about packings: relative, and never out of their folder."""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath

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
    return next((folder for folder in folders if (folder / path).is_file()), None)
