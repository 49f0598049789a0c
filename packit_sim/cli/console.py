"""The console, progress bars and options that the commands share."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment

from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.core.files import require_replaceable
from packit_sim.core.parallel import BackendName, SearchBackend
from packit_sim.core.plain_text import plain
from packit_sim.game.datasets.pack_files import dataset_library
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.mesh_files import SUFFIXES as MESH_SUFFIXES
from packit_sim.libraries.splits import Split
from packit_sim.physics.convex.decomposition import Decomposition, decompose_all, is_cached
from packit_sim.physics.convex.settings import DecompositionSettings, Method
from packit_sim.physics.world import require_engine


class PlainConsole(Console):
    """A console that ignores control characters in texts: names from files may contain some."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(plain(segment.text), segment.style)


console = PlainConsole()


def checked_dataset(name: str | None) -> str | None:
    """Return the name of a dataset; raise ArgumentError if it is a file of something else."""
    if name is None:
        return None
    file = Path(name)
    suffix = file.suffix.lower()
    if suffix in (".jsonl", *MESH_SUFFIXES) or not file.is_file():
        return name  # its reader reports the problem
    with file.open("rb") as opened:
        line = opened.readline().strip()
    if not (line.startswith(b"{") and line.endswith(b"}")):
        more = "; `packit verify` checks the packing of a .json file" if suffix == ".json" else ""
        raise ArgumentError(
            f"{name} is not a dataset: choose a .jsonl file, or a folder of such{more}"
        )
    return name


LibraryOption = Annotated[
    str,
    typer.Option(
        "--library", help="Shape library: a name, a folder, folder:PATH or shapenet:PATH."
    ),
]
DatasetLibraryOption = Annotated[
    str | None,
    typer.Option(
        "--library",
        help="Shape library: a name, a folder, folder:PATH or shapenet:PATH; "
        "default: the one that the dataset records.",
    ),
]

SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers.")]
DatasetArgument = Annotated[
    str,
    typer.Argument(
        metavar="DATASET",
        callback=checked_dataset,
        help="Dataset or results: a name (see `packit datasets list`), a folder or a file.",
    ),
]
SplitOption = Annotated[Split | None, typer.Option(help="Split of the dataset.")]
DecompositionOption = Annotated[
    Method, typer.Option(help="Method that decomposes shapes into convex pieces.")
]
WorkersOption = Annotated[int, typer.Option(min=0, help="Number of workers; 0: one per core.")]
_WHERE = typer.Option(help="Where the workers run: on this machine, or a Ray cluster.")
BackendOption = Annotated[BackendName, _WHERE]
SearchBackendOption = Annotated[SearchBackend, _WHERE]
AddressOption = Annotated[str | None, typer.Option(help="Address of the Ray cluster's head.")]
TimeOption = Annotated[str, typer.Option(help="Seconds to search, such as 60 or 60s.")]


def read_seconds(text: str) -> float:
    """Read seconds, such as "60" or "60s", or minutes, such as "5min"."""
    number = text.strip()
    factor = 1.0
    for suffix, seconds in (("min", 60.0), ("s", 1.0), ("m", 60.0), ("h", 3600.0)):
        if number.endswith(suffix):
            number, factor = number.removesuffix(suffix), seconds
            break
    try:
        return float(number) * factor
    except ValueError:
        raise ArgumentError(f"--time {text!r} is not possible: seconds, such as 60s") from None


def open_library(library: str | None, dataset: str, split: str | None = None) -> ShapeLibrary:
    """Open the library that was chosen, or else the one that a dataset records."""
    return ShapeLibrary.open(library) if library else dataset_library(dataset, split)


def prepare_folder(path: Path, *inputs: Path | str | None, field: str | None = None) -> None:
    """Create the folder of an output file, so that errors come before the work.

    Parameters
    ----------
    path : Path
        The file to write later.
    *inputs : Path, str or None
        What the command reads, see `require_replaceable`.
    field : str, optional
        The same.

    Raises
    ------
    PackItError
        If the folder is not writable, or the file is not one to replace.
    """
    require_replaceable(path, [Path(each) for each in inputs if each is not None], field)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(path.parent, os.W_OK):
        raise PackItError(f"{path} can't be written: no permission for {path.parent}")


def decompose_shown(
    shapes: Sequence[Shape],
    settings: DecompositionSettings | None = None,
    workers: int | None = None,
) -> int:
    """Decompose the shapes that are in no cache yet for a simulation, with a progress bar.

    Returns
    -------
    int
        The number of shapes that were decomposed.
    """
    require_engine()
    missing = [
        shape
        for shape in {shape.digest: shape for shape in shapes}.values()
        if not is_cached(shape, settings)
    ]
    if not missing:
        return 0
    with progress_bars() as progress:
        bar = progress.add_task("decomposing", total=len(missing), note="shapes, once")

        def show(shape: Shape, found: Decomposition) -> None:
            progress.update(bar, advance=1, note=f"{shape.id}: {len(found.pieces)} convex pieces")

        decompose_all(missing, settings, workers or None, show)
        progress.update(bar, note="")
    return len(missing)


def progress_bars() -> Progress:
    """Create progress bars with a count, the elapsed and remaining time, and a field `note`."""
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description:<14}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
        console=console,
    )
