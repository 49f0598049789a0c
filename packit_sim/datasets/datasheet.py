"""A dataset's page: how it was made, what is in it, and what it is not good for."""

from __future__ import annotations

import hashlib
import shlex
import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from packit_sim.core.errors import PackFormatError
from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.datasets.packs import (
    WHOLE,
    LibraryRef,
    Manifest,
    Pack,
    dataset_path,
    manifest_path,
    read_packs,
)
from packit_sim.datasets.provenance import Evolved
from packit_sim.datasets.statistics import DatasetStatistics, dataset_files
from packit_sim.libraries.library import ShapeLibrary

OPTIONS = {
    "pool": "--pool",
    "population": "--population",
    "generations": "--generations",
    "patience": "--patience",
    "size_range": "--size",
    "search": "--search",
}
"""Options of `packit generate` by the setting that they choose."""

PAPER = "Goyal and Deng, *PackIt: A Virtual Environment for Geometric Planning*, ICML 2020"

EVERYDAY = "everyday"
"""The built-in library: what it is for a dataset to be of it is known."""

WIDTH = 100
"""Characters of a line of text."""


@dataclass(frozen=True, eq=False)
class Part:
    """One split of a dataset, read and counted. version: of PackIt-Sim, as its manifest tells."""

    file: Path
    packs: Sequence[Pack]
    census: DatasetStatistics
    sha256: str
    version: str | None

    @classmethod
    def read(cls, file: Path, library: ShapeLibrary) -> Part:
        """Raises what `read_packs` and `DatasetStatistics.of` raise."""
        packs = read_packs(file)
        census = DatasetStatistics.of(file.stem, packs, library)
        return cls(
            file, packs, census, hashlib.sha256(file.read_bytes()).hexdigest(), _version(file)
        )

    @property
    def split(self) -> str:
        return self.census.split

    @property
    def seeds(self) -> list[int]:
        """Of the evolutions, sorted; none where the packs did not evolve."""
        return sorted({one.seed for one in self._evolved})

    @property
    def settings(self) -> Mapping[str, Any] | None:
        """Of the evolutions, where all are the same and all that these packs are of."""
        different = {one.settings for one in self._evolved}
        if len(self._evolved) < len(self.packs) or len(different) != 1:
            return None
        return different.pop().to_json()

    @property
    def _evolved(self) -> list[Evolved]:
        return [one.provenance for one in self.packs if isinstance(one.provenance, Evolved)]

    def command(self, library: str, out: str) -> str | None:
        """The `packit generate` that makes this part anew; None where there is no such."""
        settings, seeds = self.settings, self.seeds
        usual = EvolutionSettings().to_json()
        if settings is None or not seeds or seeds != list(range(seeds[0], seeds[0] + len(seeds))):
            return None
        other = {name: value for name, value in settings.items() if value != usual.get(name)}
        if not other.keys() <= OPTIONS.keys():
            return None
        words = ["packit", "generate", "--packs", str(len(seeds)), "--seed", str(seeds[0])]
        if self.split != WHOLE:
            words += ["--split", self.split]
        if library != EVERYDAY:
            words += ["--library", library]
        for name, value in other.items():
            words += [OPTIONS[name], *map(str, value if isinstance(value, list) else [value])]
        if self._evolved[0].after is not None:
            words.append("--history")
        return shlex.join([*words, "--out", out])


def read(source: Path | str, library: ShapeLibrary) -> tuple[Part, ...]:
    """The splits of a dataset that there are."""
    return tuple(Part.read(file, library) for file in dataset_files(source))


def page(
    source: Path | str,
    parts: Sequence[Part],
    library: ShapeLibrary,
    *,
    picture: str,
    licence: str = "",
    opened_as: str = EVERYDAY,
) -> str:
    """The page as Markdown; the same for the same dataset.

    source: the dataset's name or path. picture: where its picture is, from the page. licence: of
    the packs, where it is known. opened_as: what the library is opened by, for commands.
    """
    path = dataset_path(source)
    name = path.name if path.is_dir() else path.stem
    packs = sum(part.census.packs for part in parts)
    splits = ", ".join(f"{part.census.packs:,} {part.split}" for part in parts)
    told = f" ({splits})" if len(parts) > 1 or parts[0].split != WHOLE else ""
    licensed = ["--licence", licence] if licence else []
    command = shlex.join(["packit", "packs", "datasheet", str(source), *licensed])
    opening = (
        f"{_count(packs, 'pack')}{told} of shapes of the library `{library.name}`. This page is by "
        f"`{command}`; its intervals are of means, by bootstrap over packs."
    )
    sections = {
        "How it was made": _making(name, parts, library, opened_as),
        "Files": _files(parts),
        "What is in it": [*_statistics(parts), f"![Histograms of {name}]({picture})"],
        "Licence": [_wrapped(_licences(parts, library, licence))],
        "Known limits": [
            "\n".join(_wrapped(f"- {limit}", "  ") for limit in _limits(parts, library))
        ],
    }
    blocks = [f"# {name}", _wrapped(opening)]
    for heading, paragraphs in sections.items():
        blocks += [f"## {heading}", *paragraphs]
    return "\n\n".join(blocks) + "\n"


def _making(name: str, parts: Sequence[Part], library: ShapeLibrary, opened_as: str) -> list[str]:
    commands = {part.split: part.command(opened_as, name) for part in parts}
    ref = LibraryRef.of(library)
    made = (
        f"Library `{ref.name}`, version {ref.version}, digest `{ref.digest}`. PackIt-Sim "
        + ", ".join(dict.fromkeys(part.version or "of unknown version" for part in parts))
        + "."
    )
    blocks = [_wrapped(made)]
    known = [f"    {command}" for command in commands.values() if command]
    if known:
        blocks += [_wrapped("These make it again, pack by pack and bit for bit:"), "\n".join(known)]
    for split, command in commands.items():
        if command is None:
            blocks.append(
                _wrapped(f"No one command makes {split}: each pack tells how it was made.")
            )
    settings = {part.split: part.settings for part in parts if part.settings is not None}
    if settings:
        names = dict.fromkeys(name for told in settings.values() for name in told)
        rows = [[name, *(_plain(told.get(name)) for told in settings.values())] for name in names]
        blocks.append(_table(["setting", *settings], rows))
    return blocks


def _files(parts: Sequence[Part]) -> list[str]:
    rows = [
        [
            f"`{part.file.name}`",
            str(part.census.packs),
            f"{part.seeds[0]} to {part.seeds[-1]}" if part.seeds else "not told",
            f"`{part.sha256}`",
        ]
        for part in parts
    ]
    checked = "`packit verify` replays every pack by the oracle, and tells whatever does not hold."
    return [_table(["file", "packs", "seeds", "SHA-256"], rows), _wrapped(checked)]


def _statistics(parts: Sequence[Part]) -> list[str]:
    columns = [part.census.rows() for part in parts]
    names = dict.fromkeys(name for column in columns for name in column)
    rows = [
        [name, *(column.get(name, "").replace("\n", ", ") for column in columns)] for name in names
    ]
    return [_table(["", *(part.split for part in parts)], rows)]


def _licences(parts: Sequence[Part], library: ShapeLibrary, licence: str) -> str:
    told = f"The packs: {licence}." if licence else "The packs' makers tell theirs."
    shapes = sorted(set().union(*(part.census.shapes for part in parts)))
    if not library.source.is_catalogued:
        return f"{told} The shapes' owners tell theirs."
    found = Counter(library.info(id).licence or "none told" for id in shapes)
    listed = ", ".join(f"{name} ({count})" for name, count in found.most_common())
    return (
        f"{told} The {len(shapes)} shapes in them are not part of the dataset, and are under their "
        f"own: {listed}."
    )


def _limits(parts: Sequence[Part], library: ShapeLibrary) -> Iterable[str]:
    """What whoever uses the dataset should know."""
    if library.name == EVERYDAY:
        yield (
            "The shapes are everyday objects, not ShapeNet's: no number measured on these packs "
            f"compares with one of the paper's ({PAPER})."
        )
    else:
        yield (
            f"Numbers measured on these packs are about shapes of `{library.name}`: they compare "
            f"with the paper's ({PAPER}) as far as those shapes do."
        )
    settings = [part.settings for part in parts if part.settings is not None]
    if settings:
        yield (
            "The packs are evolved, and every item stands at its bottom-left-back-fill location "
            "among those before it: places are biased towards the bottom, the left and the back, "
            "and agents that fill from there may have it easier than others."
        )
        yield from _unlike_the_paper(settings)
    yield (
        "A pack is free of collisions, and no more is claimed: it need not be stable under "
        "gravity, nor can its items always be inserted one after the other. Scores for these are "
        "separate."
    )
    yield "A ground truth is a dense pack that was found, not the densest there is."
    if len(parts) > 1:
        yield _shared(parts, library)


def _unlike_the_paper(settings: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    paper = EvolutionSettings().to_json()
    told = {name: dict.fromkeys(_plain(s.get(name)) for s in settings) for name in paper}
    other = {
        name: " and ".join(found)
        for name, found in told.items()
        if [*found] != [_plain(paper[name])]
    }
    if "generations" in other:
        yield (
            f"The evolutions had {other['generations']} generations at most, the paper's "
            f"{paper['generations']}: with fewer, packs are looser and their tasks easier."
        )
    if "size_range" in other:
        yield (
            f"The linear size factor of a pack is drawn from {other['size_range']}, by the "
            f"paper's authors from {_plain(paper['size_range'])}: smaller items are more items."
        )


def _shared(parts: Sequence[Part], library: ShapeLibrary) -> str:
    """Whether splits have shapes in common, by object where the library knows."""

    def objects(part: Part) -> set[str]:
        if not library.source.is_catalogued:
            return set(part.census.shapes)
        return {library.info(id).group for id in part.census.shapes}

    shared = set().union(*(objects(a) & objects(b) for a, b in combinations(parts, 2)))
    if shared:
        verb = "occurs" if len(shared) == 1 else "occur"
        return f"{_count(len(shared), 'object')} {verb} in more than one split."
    return (
        "The splits share no object, but they share categories: a shape's like may be in another."
    )


def _version(file: Path) -> str | None:
    """The manifest's, where there is one."""
    try:
        return Manifest.read(manifest_path(file)).version
    except PackFormatError:
        return None


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)


def _plain(value: Any) -> str:
    if isinstance(value, list):
        return (" to " if len(value) == 2 else ", ").join(map(str, value))
    return str(value)


def _wrapped(text: str, indent: str = "") -> str:
    return textwrap.fill(
        text, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"
