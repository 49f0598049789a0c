"""`packit generate`: the generation of datasets, with its progress."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import packit_sim
from packit_sim.cli.options import (
    AddressOption,
    BackendOption,
    LibraryOption,
    SeedOption,
    WorkersOption,
)
from packit_sim.cli.stopping import RESUMABLE, stoppable
from packit_sim.core.choices import Split
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.game.datasets.densification_settings import DensificationSettings
from packit_sim.game.datasets.evolution_settings import EvolutionSettings, SearchName

with lazy_imports():
    from packit_sim.cli import generation_progress, output, puzzle_generation, split_generation
    from packit_sim.core import parallel
    from packit_sim.game.datasets import pack_files
    from packit_sim.game.generation import jobs

EVOLUTION_OPTIONS = ("population", "generations", "patience", "size_range", "search", "history")
"""Options without an effect on dense packs of large items."""

DENSE_OPTIONS = ("items", "floor", "largest", "fill", "tolerance", "rounds")
"""Options with an effect on dense packs of large items only."""


def generate_command(
    context: typer.Context,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the dataset.")],
    packs: Annotated[int, typer.Option(min=1, help="Number of packs in the dataset.")] = 1,
    split: Annotated[
        Split | None,
        typer.Option(help="Split of the library; the dataset's file is named after it."),
    ] = None,
    splits: Annotated[
        tuple[int, int, int] | None,
        typer.Option(
            metavar="TRAIN VALIDATION TEST",
            help="Number of packs in each of three splits, instead of --packs and --split.",
        ),
    ] = None,
    seed: SeedOption = 0,
    library: LibraryOption = "everyday",
    pool: Annotated[
        int | None,
        typer.Option(
            min=1,
            show_default=False,
            help=f"Number of shapes drawn for each pack: {EvolutionSettings.pool}, "
            f"or {DensificationSettings.pool} with --dense.",
        ),
    ] = None,
    population: Annotated[int, typer.Option(help="Number of chromosomes in a generation.")] = 100,
    generations: Annotated[
        int, typer.Option(min=0, help="Maximum number of generations per pack.")
    ] = 1000,
    patience: Annotated[
        int,
        typer.Option(
            min=1, help="Number of generations without improvement after which a pack is finished."
        ),
    ] = 100,
    size_range: Annotated[
        tuple[float, float],
        typer.Option(metavar="LOW HIGH", help="Range of a pack's linear size factor."),
    ] = (0.75, 1.0),
    search: Annotated[
        SearchName, typer.Option(help="Search method; the paper's is generational.")
    ] = ("generational"),
    history: Annotated[
        bool,
        typer.Option("--history", help="Also keep the best pack of every 50th generation."),
    ] = False,
    dense: Annotated[
        bool,
        typer.Option(
            "--dense",
            help="Don't evolve packs, but replace their items by larger ones: hard tasks.",
        ),
    ] = False,
    items: Annotated[
        tuple[int, int],
        typer.Option(metavar="LOW HIGH", help="Range of the number of items, with --dense."),
    ] = DensificationSettings.items,
    floor: Annotated[
        float,
        typer.Option(
            help="Smallest volume of an item relative to that of all items, with --dense."
        ),
    ] = DensificationSettings.floor,
    largest: Annotated[
        float,
        typer.Option(help="Largest volume of an item relative to the box's, with --dense."),
    ] = DensificationSettings.largest,
    fill: Annotated[
        float,
        typer.Option(
            help="Largest share of its bounding box that a shape may fill, with --dense: favours "
            "hollow and elongated ones."
        ),
    ] = DensificationSettings.fill,
    tolerance: Annotated[
        float,
        typer.Option(
            help="Mean loss of density that a move may cause at the beginning, with --dense."
        ),
    ] = DensificationSettings.tolerance,
    rounds: Annotated[
        int,
        typer.Option(
            min=0,
            help=f"Number of rounds of {DensificationSettings.moves} moves per pack, with --dense.",
        ),
    ] = DensificationSettings.rounds,
    puzzle: Annotated[
        list[str] | None,
        typer.Option(
            help="Kind of puzzles to cut instead of evolving packs: guillotine, pinwheel, "
            "polycubes or curved; may be repeated."
        ),
    ] = None,
    pieces: Annotated[
        list[int] | None,
        typer.Option(help="Number of pieces of a puzzle (default: 16); may be repeated."),
    ] = None,
    shapes: Annotated[
        Path | None,
        typer.Option(help="Folder for the pieces of puzzles; default: library in --out."),
    ] = None,
    workers: WorkersOption = 0,
    backend: BackendOption = "loky",
    address: AddressOption = None,
) -> None:
    """Generate the packs of a dataset: benchmark tasks with known solutions.

    Packs evolve as in the paper. With --dense, packs have large items of different shapes, which
    are replaced by larger ones again and again (simulated annealing). They become so dense that
    searches rarely find space for all items.

    Puzzles are boxes cut into pieces that fill them: guillotine (cuboids, by planes), pinwheel
    (cuboids that no plane separates), polycubes (of cubes, interlocking), and curved (by slanted
    and curved surfaces). There are --packs puzzles of each kind and number of pieces; the library
    of their pieces is written as well.

    Shapes are drawn from the library with replacement and rescaled to fill a box of length 1, so
    that a dataset from a folder of your meshes has tasks with their shapes, but not with their
    real sizes or numbers. `packit pack` packs your parts at their sizes.

    With --splits the dataset has three files, whose packs share no object. A folder of mesh files
    is first imported into the folder `library` of the dataset: repaired, simplified, and divided so
    that near-duplicates stay together. `packit shapes import` does the same with more options.

    Pack n has the seed SEED + n, so that each can be generated separately. The command can be
    stopped at any time: repeat it to resume. The packs are the same in the end.

    Example: packit generate --packs 100 --split train --workers 8 --out my-packs

    Example: packit generate --library my-meshes --packs 3 --generations 50 --out my-packs

    Example: packit generate --library my-meshes --splits 70 15 15 --out my-dataset

    Example: packit generate --dense --packs 10 --split train --out hard-packs

    Example: packit generate --puzzle polycubes --pieces 16 --packs 10 --out my-puzzles
    """
    if out.is_file():
        raise ArgumentError(f"--out {out} is a file: choose a folder for the dataset")
    puzzle_generation.check_options(context)
    if puzzle:
        puzzle_generation.write_puzzles(
            puzzle, pieces or [puzzle_generation.PIECES], packs, seed, out, shapes
        )
        return
    for name in EVOLUTION_OPTIONS if dense else DENSE_OPTIONS:
        source = context.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            option = f"--{name.replace('_', '-')}"
            raise ArgumentError(
                f"{option} has no effect {'with' if dense else 'without'} --dense: leave it out"
            )
    counts = _counts(context, splits, split, packs)
    if splits is None:
        opened = generation_progress.readable_library(packit_sim.ShapeLibrary.open(library))
    else:
        opened = split_generation.library_with_splits(library, out, workers)
    settings: jobs.SearchSettings
    if dense:
        settings = DensificationSettings(
            items=items,
            floor=floor,
            largest=largest,
            fill=fill,
            pool=pool or DensificationSettings.pool,
            rounds=rounds,
            tolerance=tolerance,
        )
    else:
        settings = EvolutionSettings(
            pool=pool or EvolutionSettings.pool,
            population=population,
            generations=generations,
            patience=patience,
            size_range=size_range,
            search=search,
        )
    with stoppable(RESUMABLE), parallel.Workers(workers, backend, address) as processes:
        for part, count in counts.items():
            shapes_of_it = opened.split(part) if part else opened
            order = jobs.GenerationJob(shapes_of_it, count, seed, part, history, settings)
            file = out / f"{part or pack_files.WHOLE}.jsonl"
            with generation_progress.shown(order, file, processes.count) as on_pack:
                generated = jobs.generate(order, file, processes, on_pack)
            output.print_written(file, f": {len(generated)} packs")


def _counts(
    context: typer.Context,
    splits: tuple[int, int, int] | None,
    split: Split | None,
    packs: int,
) -> dict[Split | None, int]:
    """Return the number of packs of each split, or of the only file."""
    if splits is None:
        return {split: packs}
    for name in ("split", "packs"):
        source = context.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            raise ArgumentError(f"--{name} has no effect with --splits: leave it out")
    if min(splits) < 0 or not any(splits):
        raise ArgumentError(
            f"--splits {' '.join(map(str, splits))} is not possible: 0 or more packs, and not all 0"
        )
    order = split_generation.ORDER
    return {name: count for name, count in zip(order, splits, strict=True) if count}
