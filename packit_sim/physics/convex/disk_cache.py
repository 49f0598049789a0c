"""Arrays that take long to make and never change, kept on disk between processes."""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from platformdirs import user_cache_path

from packit_sim.core.files import replacing

_T = TypeVar("_T")

Arrays = Mapping[str, npt.NDArray[Any]]

CACHE_VARIABLE = "PACKIT_CACHE"
"""Environment variable: the folder for what is kept."""

_log = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Return `$PACKIT_CACHE`, or else the user's cache folder of PackIt-Sim.

    On Linux that is `packit-sim` in `$XDG_CACHE_HOME`, by default in `~/.cache`.
    """
    if chosen := os.environ.get(CACHE_VARIABLE):
        return Path(chosen)
    return user_cache_path("packit-sim", appauthor=False)


def entry(kind: str, digest: str, *made_by: object) -> Path:
    """The file for what was made of the thing of this digest, in a way that values stand for."""
    way = hashlib.sha256(repr(made_by).encode()).hexdigest()
    return cache_folder() / kind / f"{digest[:32]}-{way[:16]}.npz"


def load(path: Path, read: Callable[[Arrays], _T]) -> _T | None:
    """What `read` makes of the arrays that are kept; None where none are, or they are damaged."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return read(arrays)
    except FileNotFoundError:
        return None
    except Exception as error:  # whatever damage makes numpy and zipfile raise
        _log.warning("%s is damaged and is made anew: %r", path, error)
        return None


def save(path: Path, arrays: Arrays) -> None:
    """Keeps arrays, whole or not at all; where the folder can't be written, goes on without."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
    except OSError as error:
        _log.warning("%s can't be kept, so it will be made again: %s", path, error.strerror)
