"""The page of a dataset: provenance, content and limits."""

from __future__ import annotations

import shlex
import textwrap
from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from packit_sim.core import templates
from packit_sim.game.datasets.builtin import DEFAULT_LIBRARY
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_files import WHOLE, dataset_files, dataset_path
from packit_sim.game.datasets.packs import LibraryRef
from packit_sim.game.datasets.split_summaries import SplitSummary
from packit_sim.libraries.library import ShapeLibrary

PAPER = "Goyal and Deng, *PackIt: A Virtual Environment for Geometric Planning*, ICML 2020"

TEMPLATE = Path(__file__).with_name("datasheet.md.jinja")

WIDTH = 100
"""Characters in a line of text."""


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
    opened_as: str = DEFAULT_LIBRARY,
) -> str:
    """Write the page as Markdown, which is the same for the same dataset.

    Parameters
    ----------
    source : Path or str
        The dataset's name or path.
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
        "everyday": DEFAULT_LIBRARY,
        "paper": PAPER,
    }
    filters = {"wrap": _wrapped}
    return templates.render(TEMPLATE, content, filters=filters)


def _known(library: ShapeLibrary) -> bool:
    """Return whether a library records the licence and the object of each shape."""
    return library.source.is_catalogued


def _shared_objects(parts: Sequence[SplitSummary], library: ShapeLibrary) -> set[str]:
    """Return the objects, or else the shapes, that more than one split contains."""
    contained = [
        {library.info(id).group if _known(library) else id for id in part.statistics.shapes}
        for part in parts
    ]
    return set().union(*(one & other for one, other in combinations(contained, 2)))


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
