"""Rewrite files of packs and results, and their manifests, in the newest format.

    python scripts/migrate_packs.py assets/packs [FILE_OR_FOLDER ...]

Items, locations, order, densities and provenance stay the same. Files in the newest format do not
change.
"""

from __future__ import annotations

import sys
from pathlib import Path

from packit_sim.game.datasets.pack_files import read_packs, write_packs


def main(sources: list[str]) -> None:
    """Migrate files, and all `.jsonl` files below folders."""
    for source in map(Path, sources):
        for file in sorted(source.rglob("*.jsonl")) if source.is_dir() else [source]:
            packs = read_packs(file)
            write_packs(file, packs)
            print(f"{file}: {len(packs)} packs")


if __name__ == "__main__":
    main(sys.argv[1:])
