"""Shapes that are selected, and tables of their facts."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from rich.markup import escape
from rich.table import Table

from packit_sim.cli.output import simple_table
from packit_sim.core.choices import SPLITS, Split
from packit_sim.core.errors import UnknownShapeError
from packit_sim.libraries.importer import ImportOutcome
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.sources import ShapeInfo

MAX_ROWS = 40
"""Maximum rows of the table that an import prints; its report contains all."""


def selection(
    library: ShapeLibrary, categories: Sequence[str] | None, ids: Sequence[str] | None = None
) -> tuple[str, ...]:
    """Select ids by name, or else those of categories, or else all.

    Parameters
    ----------
    categories : Sequence[str] | None
        The categories; not used if `ids` are given.
    ids : Sequence[str] | None
        The shapes.

    Returns
    -------
    tuple[str, ...]
        The selected ids.

    Raises
    ------
    UnknownShapeError
        If the library does not contain an id or a category.
    """
    for category in categories or ():
        if category not in library.categories:
            raise UnknownShapeError(
                f"library {library.name!r} has no category {category!r}: "
                f"choose from {', '.join(library.categories)}"
            )
    for id in ids or ():
        library.info(id)
    if ids:
        return tuple(ids)
    if not categories:
        return library.ids
    return tuple(id for name in categories for id in library.categories[name])


def opened_library(library: str, split: Split | None) -> ShapeLibrary:
    """Open a library, or one of its splits."""
    opened = ShapeLibrary.open(library)
    return opened if split is None else opened.split(split)


def facts(library: ShapeLibrary, info: ShapeInfo) -> dict[str, str]:
    """Collect the facts that `show` prints, by name."""
    facts = {name: str(value) for name, value in asdict(info).items() if value not in ("", None)}
    if info.size_cm is not None:
        facts["size_cm"] = " x ".join(f"{length:.4g}" for length in info.size_cm)
    facts |= {"watertight": yes_or_no(info.watertight), "solid": yes_or_no(info.solid)}
    facts["volume"] = f"{info.volume:.5f}"
    if not library.source.is_catalogued:
        return facts
    same = [id for id in library if library.info(id).group == info.group and id != info.id]
    facts["same object"] = ", ".join(same) or "none"
    facts["split"] = next(split for split in SPLITS if info.id in library.split(split))
    return facts


def counts(library: ShapeLibrary, ids: Sequence[str], split_of: Mapping[str, str]) -> list[str]:
    """Compute the cells of a row of `stats`."""
    cells = [str(len(ids))]
    if split_of:
        counts = Counter(split_of.get(id) for id in ids)
        cells += [str(counts[split]) for split in SPLITS]
    if library.source.is_catalogued:
        infos = [library.info(id) for id in ids]
        cells += [
            str(sum(info.watertight for info in infos)),
            f"{statistics.median(info.triangles for info in infos):.0f}",
            f"{statistics.median(info.volume for info in infos):.4f}",
        ]
    return cells


def report_table(outcomes: Sequence[ImportOutcome]) -> Table:
    """Create a table of outcomes: refused meshes first, then those that were changed most."""
    columns = ("mesh", "triangles", "error", "watertight", "outcome")
    table = simple_table(*columns)
    notable = [outcome for outcome in outcomes if outcome.problem is not None]
    kept = [outcome for outcome in outcomes if outcome.problem is None]
    notable += sorted(kept, key=lambda o: (not o.is_shell, o.parts == 1, not o.repairs))
    for outcome in notable[:MAX_ROWS]:
        info = outcome.info
        if info is None:
            table.add_row(escape(outcome.name), "", "", "", f"[red]{escape(outcome.problem or '')}")
            continue
        done = [] if outcome.id == outcome.name else [f"renamed {outcome.id}"]
        done += [f"{outcome.parts} parts joined"] if outcome.parts > 1 else []
        counts = asdict(outcome.repairs) if outcome.repairs else {}
        done += [f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count]
        done += ["open: volume of a shell"] if outcome.is_shell else []
        table.add_row(
            escape(outcome.name),
            f"{outcome.triangles_read} to {info.triangles}",
            f"{info.error_bound:.5f}",
            yes_or_no(info.watertight),
            escape(", ".join(done) or "as it was"),
        )
    if len(notable) > MAX_ROWS:
        table.caption = f"and {len(notable) - MAX_ROWS} more in the report"
    return table


def yes_or_no(value: bool) -> str:
    """Write a bool as a table shows it."""
    return "yes" if value else "no"
