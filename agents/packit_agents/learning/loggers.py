"""Loggers of trainings, announced by other packages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter

from packit_sim.core.entry_points import announced, load
from packit_sim.core.errors import ArgumentError

LOGGERS = "packit_sim.loggers"
"""Entry points: a name, and a function of a training's folder and settings.

It returns a `KVWriter` of stable-baselines3: `write(key_values, key_excluded, step)` gets numbers
by name, and `close()` is called at the end.
"""


def require_loggers(names: Sequence[str]) -> None:
    """Raise ArgumentError if a logger is not installed."""
    installed = announced(LOGGERS)
    for name in names:
        if name not in installed:
            known = ", ".join(installed) or "none"
            raise ArgumentError(f"there is no logger {name!r}: installed are {known}")


def open_loggers(names: Sequence[str], folder: Path, settings: Mapping[str, Any]) -> list[KVWriter]:
    """Open loggers by their names.

    Parameters
    ----------
    folder : Path
        The folder of the training.
    settings : mapping
        The settings of the training, in JSON's types.

    Returns
    -------
    list of KVWriter
        The loggers.

    Raises
    ------
    ArgumentError
        If one is not installed, or is no `KVWriter`.
    EntryPointError
        If one can't be imported.
    """
    require_loggers(names)
    installed = announced(LOGGERS)
    opened = [load(installed[name], "logger")(folder, settings) for name in dict.fromkeys(names)]
    for name, logger in zip(dict.fromkeys(names), opened, strict=True):
        if not isinstance(logger, KVWriter):
            raise ArgumentError(f"logger {name!r} is no KVWriter, but {type(logger).__name__}")
    return opened
