"""A disk cache of arrays that take long to compute, shared by all processes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from platformdirs import user_cache_path

from packit_sim.core.files import replacing
from packit_sim.core.plain_text import plain_logger

_T = TypeVar("_T")

Arrays = Mapping[str, npt.NDArray[Any]]

CACHE_VARIABLE = "PACKIT_CACHE"
"""Environment variable: the cache's folder."""

_log = plain_logger(__name__)


def cache_folder() -> Path:
    """Return `$PACKIT_CACHE`, or else the user's cache folder of PackIt-Sim.

    On Linux that is `packit-sim` in `$XDG_CACHE_HOME`, by default in `~/.cache`.
    """
    if chosen := os.environ.get(CACHE_VARIABLE):
        return Path(chosen)
    return user_cache_path("packit-sim", appauthor=False)


def entry(kind: str, digest: str, *settings: object) -> Path:
    """Return the file of the result for the object with this digest and with these settings."""
    settings_digest = hashlib.sha256(repr(settings).encode()).hexdigest()
    return cache_folder() / kind / f"{digest[:32]}-{settings_digest[:16]}.npz"


def load(path: Path, read: Callable[[Arrays], _T]) -> _T | None:
    """Convert the arrays in a file with `read`; return None if it is missing or damaged."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return read(arrays)
    except FileNotFoundError:
        return None
    except Exception as error:  # numpy and zipfile raise many kinds for damaged files
        _log.warning("%s is damaged and will be computed again: %r", path, error)
        return None


def save(path: Path, arrays: Arrays) -> None:
    """Write arrays to a file, atomically; log a warning if it can't be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
    except OSError as error:
        _log.warning("%s can't be written, so it will be computed again: %s", path, error.strerror)
