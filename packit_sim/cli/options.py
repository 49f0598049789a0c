"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from packit_sim.cli import completion
from packit_sim.core.choices import BackendName, RotationSet, SearchBackend, Split
from packit_sim.core.errors import ArgumentError
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.core.length_units import Unit
from packit_sim.physics.convex.settings import Method

with lazy_imports():
    from packit_sim.libraries import mesh_files
    from packit_sim.parts.results import record


def checked_dataset(name: str | None) -> str | None:
    """Return the name of a dataset; raise ArgumentError if it is a file of something else."""
    if name is None:
        return None
    file = Path(name)
    suffix = file.suffix.lower()
    if not file.is_file() or suffix in (".jsonl", *mesh_files.SUFFIXES):
        return name  # its reader reports the problem
    with file.open("rb") as opened:
        line = opened.readline().strip()
    if not (line.startswith(b"{") and line.endswith(b"}")):
        more = "; `packit verify` checks the packing of a .json file" if suffix == ".json" else ""
        raise ArgumentError(
            f"{name} is not a dataset: choose a .jsonl file, or a folder of such{more}"
        )
    return name


def packing_file(name: str) -> str | None:
    """Return the file of a packing, also if its folder is named; None for what has packs."""
    folder = Path(name)
    if folder.is_dir() and not any(folder.glob("*.jsonl")):
        file = folder / record.RECORD
        return str(file) if file.is_file() else None
    return name if name.endswith(".json") else None


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
        autocompletion=completion.datasets,
        help="Dataset or results: a name (see `packit datasets list`), a folder or a file.",
    ),
]
SplitOption = Annotated[Split | None, typer.Option(help="Split of the dataset.")]
KinematicOption = Annotated[
    bool, typer.Option("--kinematic", help="Insert items straight down from the open top only.")
]
BufferOption = Annotated[
    int | None,
    typer.Option(
        min=1, metavar="K", help="Play online: items arrive one by one, K of them are visible."
    ),
]
RotationsOption = Annotated[
    RotationSet, typer.Option(help="Rotations that items may have: 24, or four about z.")
]
DecompositionOption = Annotated[
    Method, typer.Option(help="Method that decomposes shapes into convex pieces.")
]
WorkersOption = Annotated[int, typer.Option(min=0, help="Number of workers; 0: one per core.")]
_WHERE = typer.Option(help="Where the workers run: on this machine, or a Ray cluster.")
BackendOption = Annotated[BackendName, _WHERE]
SearchBackendOption = Annotated[SearchBackend, _WHERE]
AddressOption = Annotated[str | None, typer.Option(help="Address of the Ray cluster's head.")]
_CONTAINER = typer.Option(
    help="Another container: cylinder:220x300mm (diameter x height), a closed mesh file, "
    "or a name that `packit containers` lists."
)
ContainerOption = Annotated[str | None, _CONTAINER]
ContainersOption = Annotated[list[str] | None, _CONTAINER]
WallClearanceOption = Annotated[
    str, typer.Option(help="Smallest distance to the walls; sides=5mm,floor=2mm,top=0 for each.")
]
FileUnitOption = Annotated[
    Unit, typer.Option(help="Unit of files without one, such as STL, and of plain numbers.")
]
UpOption = Annotated[str | None, typer.Option(help="Axis that points up in all files: x, y or z.")]
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
