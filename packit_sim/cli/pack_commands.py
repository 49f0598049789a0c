"""The command line of packs: `packit packs`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from packit_sim.cli.console import (
    LibraryOption,
    PacksArgument,
    SplitOption,
    console,
    make_room,
    progress_bars,
)
from packit_sim.core.errors import PackItError
from packit_sim.core.files import replace_text
from packit_sim.datasets import datasheet, statistics, statistics_plot
from packit_sim.datasets.original import Original, read_original
from packit_sim.datasets.packs import write_packs
from packit_sim.datasets.statistics import DatasetStatistics
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.render import plots

MOST_ROWS = 40
"""Of the table of items without a shape; the report has them all."""

app = typer.Typer(help="Look at datasets of packs, and read foreign ones.", no_args_is_help=True)


@app.command()
def stats(
    packs: PacksArgument,
    split: SplitOption = None,
    library: LibraryOption = "everyday",
    out: Annotated[Path | None, typer.Option("--out", help="Draw it, to this PNG.")] = None,
    json_: Annotated[
        Path | None, typer.Option("--json", help="Write all counts, to this file.")
    ] = None,
) -> None:
    """Counts what a dataset's packs hold, split by split: items, densities, scales, categories."""
    if out is not None:
        plots.require()
        make_room(out)
    if json_ is not None:
        make_room(json_)
    counted = statistics.take(packs, ShapeLibrary.open(library), split)
    console.print(_table(counted))
    console.print("intervals: of means, by bootstrap over packs; volumes: shares of the box")
    if out is not None:
        statistics_plot.save(counted, out)
        console.print(f"wrote {out}", soft_wrap=True)
    if json_ is not None:
        _write_json(json_, {one.split: one.to_json() for one in counted})
        console.print(f"wrote {json_}", soft_wrap=True)


@app.command("datasheet")
def datasheet_command(
    packs: PacksArgument,
    out: Annotated[Path, typer.Option("--out", help="The page to write; the picture beside it.")],
    library: LibraryOption = "everyday",
    licence: Annotated[str, typer.Option(help="Of the packs, such as CC0-1.0.")] = "",
) -> None:
    """Writes a dataset's page: how it was made, its digests and statistics, and its limits."""
    plots.require()
    picture = out.with_suffix(".png")
    if picture == out:
        raise PackItError(f"{out} is where the picture goes: choose a name that ends in .md")
    make_room(out)
    opened = ShapeLibrary.open(library)
    parts = datasheet.read(packs, opened)
    text = datasheet.page(
        packs, parts, opened, picture=picture.name, licence=licence, opened_as=library
    )
    statistics_plot.save([part.census for part in parts], picture)
    replace_text(out, text)
    console.print(f"wrote {out} and {picture}", soft_wrap=True)


@app.command()
def original(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE", help="Pack files of the original PackIt, or folders."),
    ],
    library: Annotated[
        str, typer.Option("--library", help="Of the shapes that they name: shapenet:PATH.")
    ],
    out: Annotated[Path, typer.Option("--out", help="The tasks to write: a .jsonl file.")],
    partial: Annotated[
        bool, typer.Option("--partial", help="Keep packs without the items that have no shape.")
    ] = False,
    report: Annotated[
        Path | None, typer.Option(help="JSON of every item that has no shape.")
    ] = None,
) -> None:
    """Makes tasks of packs of the original PackIt, for `packit evaluate`; see docs/paper-compat.md.

    Their places are not on our grid, so that the tasks come without a pack that solves them.
    """
    make_room(out)
    if report is not None:
        make_room(report)
    opened = ShapeLibrary.open(library)
    with progress_bars() as progress:
        bar = progress.add_task("reading", total=None, note="")

        def advance(file: str, number: int) -> None:
            progress.update(bar, advance=1, note=f"{escape(file)}, pack {number}")

        read = [
            read_original(file, opened, partial=partial, on_pack=advance)
            for file in dict.fromkeys(files)
        ]
    found = Original(
        tuple(task for one in read for task in one.tasks),
        sum(one.packs for one in read),
        tuple(problem for one in read for problem in one.unresolved),
    )
    if found.unresolved:
        console.print(_unresolved(found))
    console.print(found.summary(), highlight=False)
    if report is not None:
        rows = [dict(zip(Original.COLUMNS, row, strict=True)) for row in found.rows()]
        _write_json(report, {"summary": found.summary(), "unresolved": rows})
        console.print(f"wrote {report}", soft_wrap=True)
    if not found.tasks:
        hint = "" if partial else ": --partial keeps the items that have a shape"
        raise PackItError(f"none of the {found.packs} packs has all of its shapes{hint}")
    write_packs(out, [task.pack for task in found.tasks])
    console.print(f"wrote {out}: {len(found.tasks)} tasks", soft_wrap=True)


def _table(counted: Sequence[DatasetStatistics]) -> Table:
    """A column for each split."""
    columns = [one.rows() for one in counted]
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column(no_wrap=True)
    for one in counted:
        table.add_column(escape(one.split), overflow="fold")
    for name in dict.fromkeys(name for column in columns for name in column):
        table.add_row(name, *(escape(column.get(name, "")) for column in columns))
    return table


def _unresolved(found: Original) -> Table:
    table = Table(*Original.COLUMNS, box=SIMPLE_HEAD, show_edge=False)
    rows = found.rows()
    for row in rows[:MOST_ROWS]:
        table.add_row(*map(escape, row))
    if len(rows) > MOST_ROWS:
        table.caption = f"and {len(rows) - MOST_ROWS} more: --report writes them all"
    return table


def _write_json(path: Path, content: Any) -> None:
    """Writes a file, whole or not at all."""
    replace_text(path, json.dumps(content, ensure_ascii=False, indent=1) + "\n")
