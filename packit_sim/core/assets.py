"""The bundled data: shape libraries, datasets, weights and scripts."""

from __future__ import annotations

from pathlib import Path

from packit_sim.core.errors import LibraryError


def assets_folder() -> Path:
    """Return the folder of the bundled data, in a wheel or in a checkout, or raise LibraryError."""
    package = Path(__file__).resolve().parents[1]
    candidates = (package / "assets", package.parent / "assets")
    for folder in candidates:
        if folder.is_dir():
            return folder
    raise LibraryError(
        f"the installation is incomplete: found neither of {', '.join(map(str, candidates))}"
    )
