"""`packit shapes`: shape libraries, and the import of meshes."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer

import packit_sim
from packit_sim.cli.help import group
from packit_sim.cli.options import LibraryOption, SeedOption, WorkersOption
from packit_sim.core.choices import SPLITS, Axis, Split
from packit_sim.core.errors import LibraryError, MeshError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.core.length_units import UNITS_CM, Unit
from packit_sim.render.defaults import MAX_SIDE

with lazy_imports():
    from rich import markup
    from rich import table as rich_table

    from packit_sim.cli import library_import, output, shape_tables, terminal
    from packit_sim.geometry import simplification
    from packit_sim.libraries import importer
    from packit_sim.render import contact_sheets

app = group("Describe shape libraries, and import meshes.")

CategoryOption = Annotated[
    list[str] | None, typer.Option("--category", help="Only this category; may be repeated.")
]
OnlySplitOption = Annotated[Split | None, typer.Option("--split", help="Only this split.")]


@app.command("list")
def list_command(
    library: LibraryOption = "everyday",
    category: CategoryOption = None,
    split: OnlySplitOption = None,
) -> None:
    """List the shapes of a library.

    Example: packit shapes list --category mug
    """
    opened = shape_tables.opened_library(library, split)
    ids = shape_tables.selection(opened, category)
    columns = ["id", "category"]
    if opened.source.is_catalogued:
        columns += ["triangles", "watertight", "volume", "licence"]
    table = output.simple_table(*columns)
    for id in ids:
        row = [id, opened.source.categories[id]]
        if opened.source.is_catalogued:
            info = opened.info(id)
            row += [
                str(info.triangles),
                shape_tables.yes_or_no(info.watertight),
                f"{info.volume:.4f}",
                info.licence,
            ]
        table.add_row(*map(markup.escape, row))
    terminal.console.print(table)
    terminal.console.print(f"{len(ids)} shapes")


@app.command()
def show(
    id: Annotated[str, typer.Argument(help="Id of the shape.")],
    library: LibraryOption = "everyday",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="PNG file for a picture of the shape.")
    ] = None,
    size: Annotated[
        int, typer.Option(min=16, max=MAX_SIDE, help="Width and height of the picture, in pixels.")
    ] = 512,
) -> None:
    """Print the facts of a shape.

    Example: packit shapes show coffee-mug --out mug.png
    """
    opened = packit_sim.ShapeLibrary.open(library)
    info, shape = opened.info(id), opened[id]
    table = rich_table.Table(show_header=False, box=None)
    facts = shape_tables.facts(opened, info)
    if shape.is_shell:
        facts["volume"] += ", of a shell: the surface is open, and encloses next to nothing"
    for name, value in facts.items():
        table.add_row(f"[bold]{name}[/]", markup.escape(value))
    table.add_row("[bold]extents[/]", " x ".join(f"{e:.3f}" for e in shape.extents))
    terminal.console.print(table)
    if out is not None:
        output.prepare_folder(out)
        renderer = contact_sheets.contact_sheet([(id, shape)], side=size).save(out)
        output.print_written(out, f" by the {renderer} renderer")


@app.command()
def stats(library: LibraryOption = "everyday") -> None:
    """Count a library's shapes by category and split, with triangles and volumes."""
    opened = packit_sim.ShapeLibrary.open(library)
    known = opened.source.is_catalogued
    try:
        split_of = {id: split for split in SPLITS for id in opened.split(split)}
    except LibraryError:
        split_of = {}
    headings = ["category", "shapes", *(SPLITS if split_of else ())]
    if known:
        headings += ["watertight", "triangles", "volume"]
    table = rich_table.Table(*headings, box=None, pad_edge=False, collapse_padding=True)
    table.columns[0].no_wrap = True
    for name, ids in opened.categories.items():
        table.add_row(markup.escape(name), *shape_tables.counts(opened, ids, split_of))
    table.add_row("all", *shape_tables.counts(opened, opened.ids, split_of))
    terminal.console.print(table)
    summary = f"{len(opened)} shapes in {len(opened.categories)} categories"
    if known:
        infos = list(map(opened.info, opened))
        licences = Counter(info.licence or "no licence" for info in infos)
        summary += (
            f", {len({info.group for info in infos})} different objects; "
            "triangles and volume are medians\n"
            + ", ".join(f"{name}: {count}" for name, count in licences.most_common())
        )
    terminal.console.print(summary, highlight=False, markup=False)
    if opened.missing:
        terminal.console.print(f"{len(opened.missing)} more have no mesh file", style="yellow")


@app.command("contact-sheet")
def contact_sheet_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="PNG file for the picture.")],
    library: LibraryOption = "everyday",
    category: CategoryOption = None,
    split: OnlySplitOption = None,
    id: Annotated[
        list[str] | None, typer.Option("--id", help="Only this shape; may be repeated.")
    ] = None,
    per_category: Annotated[
        int | None, typer.Option(min=1, help="Maximum number of shapes per category.")
    ] = None,
    columns: Annotated[
        int | None, typer.Option(min=1, help="Number of columns; default: as square as possible.")
    ] = None,
    size: Annotated[
        int, typer.Option(min=32, max=512, help="Width and height of each picture, in pixels.")
    ] = 128,
) -> None:
    """Draw a grid of pictures of shapes; exit code 1 if one can't be read.

    Example: packit shapes contact-sheet --category mug --out mugs.png
    """
    opened = shape_tables.opened_library(library, split)
    ids = shape_tables.selection(opened, category, id)
    if per_category is not None:
        seen: Counter[str] = Counter()
        chosen = []
        for name in ids:
            kind = opened.source.categories[name]
            seen[kind] += 1
            if seen[kind] <= per_category:
                chosen.append(name)
        ids = tuple(chosen)
    output.prepare_folder(out)
    problems = []
    with terminal.progress_bars() as progress:
        bar = progress.add_task("drawing", total=len(ids), note="")

        def tiles() -> Any:
            for name in ids:
                progress.update(bar, note=name)
                try:
                    yield name, opened[name]
                except MeshError as error:
                    problems.append(str(error))
                    yield name, str(error)
                progress.advance(bar)

        sheet = contact_sheets.contact_sheet(tiles(), columns=columns, side=size)
    renderer = sheet.save(out)
    output.print_written(out, f" by the {renderer} renderer: {len(ids)} shapes")
    for problem in problems:
        terminal.console.print(problem, style="red", markup=False, highlight=False, soft_wrap=True)
    if problems:
        raise typer.Exit(1)


@app.command("import")
def import_command(
    source: Annotated[
        str, typer.Argument(help="Source: folder:PATH, shapenet:PATH, or another library.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the library to write.")],
    name: Annotated[str, typer.Option(help="Name of the library; default: the folder's.")] = "",
    library_version: Annotated[str, typer.Option(help="Version of the library.")] = "1",
    up: Annotated[
        Axis | None, typer.Option(help="Axis that points up; default: as the files say.")
    ] = None,
    unit: Annotated[
        Unit | None, typer.Option(help="Unit of length, if the files do not say it.")
    ] = None,
    max_triangles: Annotated[
        int,
        typer.Option(min=0, help="Maximum number of triangles, by simplification; 0: no maximum."),
    ] = 4000,
    max_error: Annotated[
        float, typer.Option(help="Maximum error of simplification, relative to the diagonal.")
    ] = 0.01,
    eager: Annotated[
        bool, typer.Option("--eager", help="Simplify all meshes, up to an error of 0.001.")
    ] = False,
    min_thickness: Annotated[
        float, typer.Option(help="Minimum thickness, relative to the diagonal.")
    ] = 0.0,
    memory: Annotated[
        float, typer.Option(min=0.01, max=2**20, help="Maximum memory for one mesh, in GiB.")
    ] = 4.0,
    timeout: Annotated[float, typer.Option(help="Maximum time for one mesh, in seconds.")] = 300.0,
    workers: WorkersOption = 0,
    seed: SeedOption = 0,
    everything: Annotated[
        bool,
        typer.Option("--all", help="Also import shapes that are in none of the source's splits."),
    ] = False,
    report: Annotated[
        Path | None, typer.Option(help="JSON file of the report; default: OUT.report.json.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing library.")
    ] = False,
) -> None:
    """Import meshes as a library: repaired, simplified, divided into splits, with a report.

    Each mesh is read in a separate process with limited memory and time. A file becomes one rigid
    shape, even if its scene has several parts. Of ShapeNet, the paper's three subsets are imported:
    each has 100 shapes of a category, or a third of them.

    Example: packit shapes import folder:meshes --unit mm --out my-library
    """
    settings = importer.ImportSettings(
        up=up,
        unit_cm=None if unit is None else UNITS_CM[unit],
        simplification=simplification.Simplification(max_triangles or None, max_error, eager),
        min_thickness=min_thickness,
        memory=int(memory * 2**30),
        timeout=timeout,
        workers=workers or os.cpu_count() or 1,
        seed=seed,
    )
    opened = packit_sim.ShapeLibrary.open(source, seed=seed)
    report = report or out.with_name(f"{out.name}.report.json")
    output.prepare_folder(out)
    output.prepare_folder(report, source, field="shapes")
    try:
        splits = None if everything else opened.source.splits
    except LibraryError:
        splits = None
    library_import.import_shown(
        opened,
        out,
        name or out.name,
        library_version,
        settings,
        source=source,
        report=report,
        splits=splits,
        overwrite=overwrite,
    )
