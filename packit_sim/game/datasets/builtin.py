"""The built-in datasets by name."""

from __future__ import annotations

from packit_sim.core.assets import assets_folder

STARTER_PACKS = "starter"
"""The name of the small built-in dataset."""

BUILTIN_DATASETS = {
    "starter": "ten small packs, to try things out",
    "everyday-v1": "the benchmark: 550 packs of 10 to 35 items, in three splits",
    "everyday-v1-history": "packs from the course of 16 evolutions, for the hardness curve",
    "everyday-hard": "550 packs of 20 hollow items that no search finishes, in three splits",
    "puzzles": "40 boxes cut into 8 to 32 pieces, which fill them: cuboids, polycubes, curved ones",
}
"""The built-in datasets, with a description of each."""

DEFAULT_LIBRARY = "everyday"
"""The built-in library of the built-in datasets."""


def builtin_datasets() -> tuple[str, ...]:
    """Return the names of the built-in datasets."""
    return tuple(sorted(path.name for path in (assets_folder() / "packs").iterdir()))
