"""The page of a dataset: provenance, content and limits."""

from __future__ import annotations

import hashlib
import shlex
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path
from typing import Any

from packit_sim.core import templates
from packit_sim.core.errors import PackFormatError
from packit_sim.datasets.densification_settings import DensificationSettings
from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.datasets.manifests import Manifest, find_manifest
from packit_sim.datasets.pack_files import WHOLE, dataset_files, dataset_path, read_packs
from packit_sim.datasets.packs import LibraryRef, Pack
from packit_sim.datasets.provenance import Densified, Evolved, Puzzle
from packit_sim.datasets.statistics import DatasetStatistics
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
    "rounds": "--rounds",
}
"""Options of `packit generate` by the setting that they change."""

PAPER = "Goyal and Deng, *PackIt: A Virtual Environment for Geometric Planning*, ICML 2020"

EVERYDAY = "everyday"
"""The built-in library; the page says more about its shapes."""

TEMPLATE = Path(__file__).with_name("datasheet.md.jinja")

WIDTH = 100
"""Characters in a line of text."""


@dataclass(frozen=True, eq=False)
class SplitSummary:
    """One split of a dataset, with its statistics.

    Attributes
    ----------
    file : Path
        The file.
    packs : sequence of Pack
        Its packs.
    statistics : DatasetStatistics
        Their statistics.
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
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
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
        """How puzzles were cut, the pieces, the packs, and the range of their densities."""
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
        """Whether the packs were made denser, and did not evolve."""
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
        if library != EVERYDAY:
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


def read(source: Path | str, library: ShapeLibrary) -> tuple[SplitSummary, ...]:
    """Read the splits of a dataset."""
    return tuple(SplitSummary.read(file, library) for file in dataset_files(source))


def page(
    source: Path | str,
    parts: Sequence[SplitSummary],
    library: ShapeLibrary,
    *,
    picture: str,
    licence: str = "",
    opened_as: str = EVERYDAY,
) -> str:
    """Write the page as Markdown, which is the same for the same dataset.

    Parameters
    ----------
    source : Path or str
        The dataset's name or path.
    parts : sequence of SplitSummary
        Its splits.
    library : ShapeLibrary
        The library of its shapes.
    picture : str
        The path of its picture, from the page.
    licence : str
        The licence of the packs, if it is known.
    opened_as : str
        The library's name or path, for commands.

    Returns
    -------
    str
        The Markdown text.
    """
    path = dataset_path(source)
    settings = {part.split: part.settings for part in parts if part.settings is not None}
    paper = {name: _plain(value) for name, value in EvolutionSettings().to_json().items()}
    evolved = [
        settings[part.split] for part in parts if part.split in settings and not part.is_dense
    ]
    used = {name: dict.fromkeys(_plain(one.get(name)) for one in evolved) for name in paper}
    columns = [part.statistics.rows() for part in parts]
    shapes = sorted(set().union(*(part.statistics.shapes for part in parts)))
    licences = Counter(library.info(id).licence or "unknown" for id in shapes if _known(library))
    licensed = ["--licence", licence] if licence else []
    name = path.name if path.is_dir() else path.stem
    content = {
        "name": name,
        "command": shlex.join(["packit", "datasets", "datasheet", str(source), *licensed]),
        "library": LibraryRef.of(library),
        "parts": parts,
        "splits": [part.split for part in parts],
        "packs": sum(part.statistics.packs for part in parts),
        "versions": list(dict.fromkeys(part.version or "of unknown version" for part in parts)),
        "commands": {part.split: part.command(opened_as, name) for part in parts},
        "settings": settings,
        "evolved": bool(evolved),
        "setting_rows": [
            [name, *(_plain(one.get(name)) for one in settings.values())]
            for name in dict.fromkeys(name for one in settings.values() for name in one)
        ],
        "usual": paper,
        "changed": {n: " and ".join(found) for n, found in used.items() if {*found} - {paper[n]}},
        "puzzle_rows": [row for part in parts for row in part.puzzle_rows],
        "file_rows": [part.file_row for part in parts],
        "statistics_rows": [
            [name, *(column.get(name, "").replace("\n", ", ") for column in columns)]
            for name in dict.fromkeys(name for column in columns for name in column)
        ],
        "picture": picture,
        "licence": licence,
        "licences": licences.most_common() if _known(library) else None,
        "shapes": len(shapes),
        "shared": len(_shared_objects(parts, library)),
        "count": _count,
        "whole": WHOLE,
        "everyday": EVERYDAY,
        "paper": PAPER,
    }
    filters = {"wrap": _wrapped}
    return templates.render(TEMPLATE, content, filters=filters)


def _known(library: ShapeLibrary) -> bool:
    """Whether a library records the licence and the object of each shape."""
    return library.source.is_catalogued


def _shared_objects(parts: Sequence[SplitSummary], library: ShapeLibrary) -> set[str]:
    """Return the objects, or else the shapes, that more than one split contains."""
    held = [
        {library.info(id).group if _known(library) else id for id in part.statistics.shapes}
        for part in parts
    ]
    return set().union(*(one & other for one, other in combinations(held, 2)))


def _version(file: Path) -> str | None:
    """Return the version in the manifest, if there is one."""
    try:
        found = find_manifest(file, file.read_bytes())
        return None if found is None else Manifest.read(found).version
    except PackFormatError:
        return None


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return (" to " if len(value) == 2 else ", ").join(map(str, value))
    return str(value)


def _wrapped(text: str, indent: str = "") -> str:
    """Break a paragraph into lines; the next ones are indented."""
    words = " ".join(text.split())
    return textwrap.fill(
        words, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"
