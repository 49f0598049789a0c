"""What the commands share: the console, progress bars and common options."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from packit_sim.core.errors import PackItError
from packit_sim.core.parallel import BackendName
from packit_sim.libraries.splits import Split
from packit_sim.physics.settings import Method

console = Console()

LibraryOption = Annotated[
    str,
    typer.Option(
        "--library", help="Shape library: a name, a folder, folder:PATH or shapenet:PATH."
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers.")]
PacksArgument = Annotated[
    str, typer.Argument(help="Packs: a dataset's name, such as starter, its folder or its file.")
]
SplitOption = Annotated[Split | None, typer.Option(help="Split of the dataset.")]
PiecesOption = Annotated[
    Method, typer.Option(help="Method that decomposes shapes into convex pieces.")
]
WorkersOption = Annotated[int, typer.Option(min=0, help="Number of processes; 0: one per core.")]
BackendOption = Annotated[
    BackendName, typer.Option(help="Where the processes run: on this machine, or a Ray cluster.")
]
AddressOption = Annotated[str | None, typer.Option(help="Address of the Ray cluster's head.")]


def prepare_folder(path: Path) -> None:
    """Create the folder of an output file, so that errors come before the work.

    Parameters
    ----------
    path : Path
        The file to write later.

    Raises
    ------
    PackItError
        If the folder is not writable.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(path.parent, os.W_OK):
        raise PackItError(f"{path} can't be written: no permission for {path.parent}")


def progress_bars() -> Progress:
    """Create progress bars with a count, the elapsed and remaining time, and a field `note`."""
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description:<14}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
    )
