"""Summaries of the splits of a dataset: provenance, and the command that generates a split."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from packit_sim.core.errors import PackFormatError
from packit_sim.core.files import digest_of
from packit_sim.game.datasets.builtin import DEFAULT_LIBRARY
from packit_sim.game.datasets.densification_settings import DensificationSettings
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.manifests import Manifest, find_manifest
from packit_sim.game.datasets.pack_files import WHOLE, read_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Densified, Evolved, Puzzle
from packit_sim.game.datasets.statistics import DatasetStatistics
from packit_sim.libraries.library import ShapeLibrary

OPTIONS = {
    "pool": "--pool",
    "population": "--population",
    "generations": "--generations",
    "patience": "--patience",
    "size_range": "--size-range",
    "search": "--search",
    "items": "--items",
    "floor": "--floor",
    "largest": "--largest",
    "fill": "--fill",
    "tolerance": "--tolerance",
    "rounds": "--rounds",
}
"""Options of `packit generate` by the setting that they change."""


@dataclass(frozen=True, eq=False)
class SplitSummary:
    """One split of a dataset, with its statistics.

    Attributes
    ----------
    sha256 : str
        The SHA-256 of the file, in hex.
    version : str or None
        The version of PackIt-Sim that its manifest records.
    """

    file: Path
    packs: Sequence[Pack]
    statistics: DatasetStatistics
    sha256: str
    version: str | None

    @classmethod
    def read(cls, file: Path, library: ShapeLibrary) -> SplitSummary:
        """Read a file; errors are those of `read_packs` and `DatasetStatistics.of`."""
        packs = read_packs(file)
        statistics = DatasetStatistics.of(file.stem, packs, library)
        digest = digest_of(file)
        return cls(file, packs, statistics, digest, _version(file))

    @property
    def split(self) -> str:
        """The name of the split."""
        return self.statistics.split

    @property
    def seeds(self) -> list[int]:
        """The seeds of the packs, sorted; empty if they were not generated."""
        return sorted({one.seed for one in (*self._generated, *self.puzzles)})

    @property
    def puzzles(self) -> list[Puzzle]:
        """The records of the packs that are puzzles."""
        return [one.provenance for one in self.packs if isinstance(one.provenance, Puzzle)]

    @property
    def puzzle_rows(self) -> list[list[str]]:
        """Rows of cut, number of pieces, number of packs and range of densities."""
        densities: dict[tuple[str, int], list[float]] = {}
        for pack in self.packs:
            if isinstance(record := pack.provenance, Puzzle):
                densities.setdefault((record.cuts, record.pieces), []).append(pack.density)
        return [
            [cuts, str(pieces), str(len(found)), f"{min(found):.4f} to {max(found):.4f}"]
            for (cuts, pieces), found in densities.items()
        ]

    @property
    def settings(self) -> Mapping[str, Any] | None:
        """The settings of the packs; None if packs differ in them or were not generated."""
        different = {one.settings for one in self._generated}
        if len(self._generated) < len(self.packs) or len(different) != 1:
            return None
        return different.pop().to_json()

    @property
    def file_row(self) -> list[str]:
        """The file's name, its number of packs, their seeds and its digest."""
        seeds = f"{self.seeds[0]} to {self.seeds[-1]}" if self.seeds else "unknown"
        return [f"`{self.file.name}`", str(self.statistics.packs), seeds, f"`{self.sha256}`"]

    @property
    def is_dense(self) -> bool:
        """True if the packs come from densification, not from evolution."""
        return any(isinstance(one, Densified) for one in self._generated)

    @property
    def _generated(self) -> list[Evolved | Densified]:
        found = (pack.provenance for pack in self.packs)
        return [one for one in found if isinstance(one, Evolved | Densified)]

    def command(self, library: str, out: str) -> str | None:
        """Return the `packit generate` that regenerates this part; None if there is none."""
        if self.puzzles:
            return self._puzzle_command(out)
        settings, seeds = self.settings, self.seeds
        usual = (DensificationSettings() if self.is_dense else EvolutionSettings()).to_json()
        if settings is None or not seeds or seeds != list(range(seeds[0], seeds[0] + len(seeds))):
            return None
        other = {name: value for name, value in settings.items() if value != usual.get(name)}
        if not other.keys() <= OPTIONS.keys():
            return None
        words = ["packit", "generate", *(["--dense"] if self.is_dense else [])]
        words += ["--packs", str(len(seeds)), "--seed", str(seeds[0])]
        if self.split != WHOLE:
            words += ["--split", self.split]
        if library != DEFAULT_LIBRARY:
            words += ["--library", library]
        for name, value in other.items():
            words += [OPTIONS[name], *map(str, value if isinstance(value, list) else [value])]
        first = self._generated[0]
        if isinstance(first, Evolved) and first.after is not None:
            words.append("--history")
        return shlex.join([*words, "--out", out])

    def _puzzle_command(self, out: str) -> str | None:
        """Return the command that cuts these puzzles; None if no single one does."""
        records, seeds = self.puzzles, self.seeds
        cuts = dict.fromkeys(one.cuts for one in records)
        pieces = dict.fromkeys(one.pieces for one in records)
        wanted = [
            Puzzle(cuts=kind, pieces=number, seed=seed)
            for kind, number, seed in product(cuts, pieces, range(seeds[0], seeds[0] + len(seeds)))
        ]
        if [one.provenance for one in self.packs] != wanted:
            return None
        words = ["packit", "generate"]
        for kind in cuts:
            words += ["--puzzle", kind]
        for number in pieces:
            words += ["--pieces", str(number)]
        return shlex.join(
            [*words, "--packs", str(len(seeds)), "--seed", str(seeds[0]), "--out", out]
        )


def _version(file: Path) -> str | None:
    """Return the version in the manifest, if there is one."""
    try:
        found = find_manifest(file, file.read_bytes())
        return None if found is None else Manifest.read(found).version
    except PackFormatError:
        return None
