"""`packit datasets`: the built-in datasets, statistics, datasheets, the original's packs."""

from __future__ import annotations

import datetime
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli.help import group
from packit_sim.cli.options import DatasetArgument, DatasetLibraryOption, SeedOption, SplitOption
from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.game.datasets.builtin import BUILTIN_DATASETS

with lazy_imports():
    from rich import markup
    from rich import table as rich_table

    from packit_sim.cli import inputs, output, terminal
    from packit_sim.core import files as core_files
    from packit_sim.game.datasets import archives, datasheet, manifests, pack_files, statistics
    from packit_sim.game.datasets import original as original_packs
    from packit_sim.game.reports import statistics_plot
    from packit_sim.render import plots

MAX_ROWS = 40
"""Maximum rows of the table of items without a shape; the report contains all."""

app = group("List and describe datasets, and read those of the original PackIt.")


@app.command("list")
def list_command() -> None:
    """List the built-in datasets, whose names can stand for DATASET in commands.

    Example: packit datasets list
    """
    table = output.simple_table("dataset", "split", "packs", "library", "description")
    for name, what in BUILTIN_DATASETS.items():
        for file in pack_files.dataset_files(name):
            manifest = manifests.Manifest.read(manifests.manifest_path(file))
            libraries = ", ".join(f"{ref.name} {ref.version}" for ref in manifest.libraries)
            split = "" if file.stem == pack_files.WHOLE else file.stem
            table.add_row(name, split, str(manifest.packs), libraries, what)
            name = what = ""
    terminal.console.print(table)
    terminal.console.print(
        "Your own: the folder or file that `packit generate` or `packit evaluate` wrote.",
        highlight=False,
    )


@app.command()
def stats(
    dataset: DatasetArgument,
    split: SplitOption = None,
    library: DatasetLibraryOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="PNG file for a picture of the statistics.")
    ] = None,
    json_: Annotated[Path | None, typer.Option("--json", help="JSON file for all counts.")] = None,
) -> None:
    """Count items, densities, scales and categories of a dataset's packs, split by split.

    Example: packit datasets stats everyday-v1 --out statistics.png
    """
    if out is not None:
        plots.require()
        output.prepare_folder(out, dataset)
    if json_ is not None:
        output.prepare_folder(json_, dataset)
    counted = statistics.take(dataset, inputs.open_library(library, dataset, split), split)
    terminal.console.print(_statistics_table(counted))
    terminal.console.print(
        "intervals: of means, by bootstrap over packs; volumes: shares of the box"
    )
    if out is not None:
        statistics_plot.save(counted, out)
        output.print_written(out)
    if json_ is not None:
        output.write_json(json_, {one.split: one.to_json() for one in counted})


@app.command("datasheet")
def datasheet_command(
    dataset: DatasetArgument,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="Markdown file of the page; its picture goes next to it."),
    ],
    library: DatasetLibraryOption = None,
    licence: Annotated[str, typer.Option(help="Licence of the packs, such as CC0-1.0.")] = "",
) -> None:
    """Write a dataset's page: its provenance, digests, statistics and limits.

    Example: packit datasets datasheet my-packs --licence CC0-1.0 --out my-packs.md
    """
    plots.require()
    picture = out.with_suffix(".png")
    if picture == out:
        raise PackItError(f"{out} is the file of the picture: choose a name that ends in .md")
    output.prepare_folder(out, dataset)
    output.prepare_folder(picture, dataset)
    opened = inputs.open_library(library, dataset)
    parts = datasheet.read(dataset, opened)
    text = datasheet.page(
        dataset,
        parts,
        opened,
        picture=picture.name,
        licence=licence,
        opened_as=library or opened.locator,
    )
    statistics_plot.save([part.statistics for part in parts], picture)
    core_files.replace_text(out, text)
    output.print_written(out, f" and {picture}")


@app.command()
def archive(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="Dataset, or with --shape-library a library: name or path."
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="New folder; the ZIP file goes next to it.")
    ],
    shapes: Annotated[
        bool, typer.Option("--shape-library", help="Archive a shape library.")
    ] = False,
    licence: Annotated[
        str, typer.Option(help="SPDX identifier of your packs' licence, such as CC0-1.0.")
    ] = "",
    author: Annotated[str, typer.Option(help="Who publishes your data.")] = "",
    date: Annotated[
        datetime.datetime | None,
        typer.Option(formats=["%Y-%m-%d"], help="Date of publication; default: today."),
    ] = None,
) -> None:
    """Write what data hosts take: the files, Croissant metadata, a data card and a citation.

    A ZIP file has the same content. Equal data and dates give equal files. Nothing is uploaded.

    Example: packit datasets archive everyday-v1 --out everyday-v1-archive

    Example: packit datasets archive everyday --shape-library --out everyday-archive
    """
    day = (date or datetime.datetime.now()).date().isoformat()
    if shapes:
        if licence:
            raise ArgumentError(
                "--licence has no effect with --shape-library: each shape has its own"
            )
        metadata, card = archives.library_archive(packit_sim.ShapeLibrary.open(name), day, author)
    else:
        plots.require()
        opened = inputs.open_library(None, name)
        metadata, card = archives.dataset_archive(name, opened, day, licence, author)
        with tempfile.TemporaryDirectory() as folder:
            picture = Path(folder) / archives.PICTURE
            statistics_plot.save(statistics.take(name, opened, None), picture)
            metadata = metadata.with_file(picture.name, picture.read_bytes())
    whole = archives.write_archive(metadata, card, out)
    output.print_written(out, f" and {whole}, version {metadata.version}")


@app.command()
def sequences(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the dataset.")],
    library: Annotated[
        str | None,
        typer.Option(
            "--library", help="Library of the shapes, which have real sizes; default: blockout."
        ),
    ] = None,
    items_of: Annotated[
        str | None,
        typer.Option("--items-of", help="Dataset whose items are drawn instead, at their sizes."),
    ] = None,
    split: SplitOption = None,
    count: Annotated[int, typer.Option("--sequences", min=1, help="Number of sequences.")] = 500,
    items: Annotated[int, typer.Option(min=1, help="Number of items of a sequence.")] = 50,
    seed: SeedOption = 0,
    cells: Annotated[
        tuple[int, int, int] | None,
        typer.Option(metavar="X Y Z", help="Cells of the box; default: 20 20 20."),
    ] = None,
    step_cm: Annotated[
        float | None,
        typer.Option(help="Length of a grid step, which is 4 cells, in cm; default: 5.9."),
    ] = None,
) -> None:
    """Draw sequences of items for the online game: shapes at real size, or items of a dataset.

    Each is drawn with the same probability. Sequence n has the seed SEED + n. The defaults are
    those of the benchmark BlockOut.

    Example: packit datasets sequences --out blockout

    Example: packit datasets sequences --items-of everyday-v1 --split test --out online
    """
    if out.is_file():
        raise ArgumentError(f"--out {out} is a file: choose a folder for the dataset")
    sampler: packit_sim.SequenceSampler | packit_sim.ItemSampler
    if items_of is None:
        if split:
            raise ArgumentError("--split has no effect without --items-of: leave it out")
        sampler = packit_sim.SequenceSampler(
            packit_sim.ShapeLibrary.open(library or "blockout"),
            cells or (20, 20, 20),
            5.9 if step_cm is None else step_cm,
            items,
        )
    else:
        given = {"--library": library, "--cells": cells, "--step-cm": step_cm}
        for name in (name for name, value in given.items() if value is not None):
            raise ArgumentError(f"{name} has no effect with --items-of: leave it out")
        opened = pack_files.dataset_library(items_of, split)
        tasks = packit_sim.load_tasks(items_of, opened, split)
        sampler = packit_sim.ItemSampler(opened, tasks, items)
    file = out / f"{split or pack_files.WHOLE}.jsonl"
    output.prepare_folder(file)
    packit_sim.write_packs(file, [sampler.pack(seed + n) for n in range(count)])
    output.print_written(file, f": {count} sequences")


@app.command()
def original(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE", help="Pack files of the original PackIt, or folders."),
    ],
    library: Annotated[
        str, typer.Option("--library", help="Library of their shapes: shapenet:PATH.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="JSONL file for the tasks.")],
    partial: Annotated[
        bool, typer.Option("--partial", help="Keep packs with missing shapes, without those items.")
    ] = False,
    report: Annotated[
        Path | None, typer.Option(help="JSON file of all items without a shape.")
    ] = None,
) -> None:
    """Convert packs of the original PackIt to tasks for `packit evaluate`.

    The original locations are not on our grid, so the tasks have no solution. Other differences are
    described at https://packit-sim.readthedocs.io (Benchmarks, The original PackIt).

    Example: packit datasets original packs/ --library shapenet:ShapeNetCore.v2 --out tasks.jsonl
    """
    output.prepare_folder(out, *files)
    if report is not None:
        output.prepare_folder(report, *files)
    opened = packit_sim.ShapeLibrary.open(library)
    with terminal.progress_bars() as progress:
        bar = progress.add_task("reading", total=None, note="")

        def advance(file: str, number: int) -> None:
            progress.update(bar, advance=1, note=f"{markup.escape(file)}, pack {number}")

        read = [
            packit_sim.read_original(file, opened, partial=partial, on_pack=advance)
            for file in dict.fromkeys(files)
        ]
    found = original_packs.Original(
        tuple(task for one in read for task in one.tasks),
        sum(one.packs for one in read),
        tuple(problem for one in read for problem in one.unresolved),
    )
    if found.unresolved:
        terminal.console.print(_unresolved(found))
    terminal.console.print(found.summary(), highlight=False)
    if report is not None:
        rows = [
            dict(zip(original_packs.Original.COLUMNS, row, strict=True)) for row in found.rows()
        ]
        output.write_json(report, {"summary": found.summary(), "unresolved": rows})
    if not found.tasks:
        hint = "" if partial else ": --partial keeps the items that have a shape"
        raise PackItError(f"none of the {found.packs} packs has all of its shapes{hint}")
    packit_sim.write_packs(out, [task.pack for task in found.tasks])
    output.print_written(out, f": {len(found.tasks)} tasks")


def _statistics_table(counted: Sequence[statistics.DatasetStatistics]) -> rich_table.Table:
    """Create a table with a column for each split."""
    columns = [one.rows() for one in counted]
    table = output.simple_table()
    table.add_column(no_wrap=True)
    for one in counted:
        table.add_column(markup.escape(one.split), overflow="fold")
    for name in dict.fromkeys(name for column in columns for name in column):
        table.add_row(name, *(markup.escape(column.get(name, "")) for column in columns))
    return table


def _unresolved(found: original_packs.Original) -> rich_table.Table:
    table = output.simple_table(*original_packs.Original.COLUMNS)
    rows = found.rows()
    for row in rows[:MAX_ROWS]:
        table.add_row(*map(markup.escape, row))
    if len(rows) > MAX_ROWS:
        table.caption = f"and {len(rows) - MAX_ROWS} more: --report writes all"
    return table
