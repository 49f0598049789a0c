"""What the command line's parts share: the console, progress bars, options."""

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
        "--library", help="Shape library: a name, its folder, folder:PATH or shapenet:PATH."
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Repeats a run exactly.")]
PacksArgument = Annotated[
    str, typer.Argument(help="Packs: a dataset's name, such as starter, its folder or its file.")
]
SplitOption = Annotated[Split | None, typer.Option(help="Which of the dataset's splits.")]
PiecesOption = Annotated[Method, typer.Option(help="What makes shapes convex pieces.")]
WorkersOption = Annotated[int, typer.Option(min=0, help="Processes; 0 for one a core.")]
BackendOption = Annotated[BackendName, typer.Option(help="Where the workers are.")]
AddressOption = Annotated[str | None, typer.Option(help="Of the Ray cluster's head.")]


def make_room(path: Path) -> None:
    """Makes the folder that a file goes to, before there is work that could be lost."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(path.parent, os.W_OK):
        raise PackItError(f"{path} can't be written: no permission for {path.parent}")


def progress_bars() -> Progress:
    """Bars with a count, the time so far and left, and a field `note` of each task."""
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
