"""The folder of the user's own settings."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_config_path

CONFIG_VARIABLE = "PACKIT_CONFIG"
"""Environment variable: the folder."""


def config_folder() -> Path:
    """Return `$PACKIT_CONFIG`, or else the user's folder of settings of PackIt-Sim.

    On Linux that is `packit-sim` in `$XDG_CONFIG_HOME`, by default in `~/.config`.
    """
    if chosen := os.environ.get(CONFIG_VARIABLE):
        return Path(chosen)
    return user_config_path("packit-sim", appauthor=False)
