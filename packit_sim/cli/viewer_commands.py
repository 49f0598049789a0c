"""`packit view` and `packit workbench`: local web pages."""

from __future__ import annotations

from typing import Annotated

import typer

from packit_sim.cli.console import DatasetArgument, DatasetLibraryOption, SplitOption, console
from packit_sim.cli.local_pages import (
    BrowserOption,
    HostOption,
    PortOption,
    serve_until_interrupt,
)
from packit_sim.game.datasets.pack_files import dataset_path
from packit_sim.game.explorer.collection import PackCollection
from packit_sim.game.explorer.explorer import Explorer
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.parts.workbench.workbench import Workbench
from packit_sim.web.origins import LOOPBACK


def view_command(
    dataset: DatasetArgument,
    split: SplitOption = None,
    pack: Annotated[
        int, typer.Option("--pack", min=0, help="Number of the pack to show first.")
    ] = 0,
    second: Annotated[
        int | None,
        typer.Option("--second", min=0, help="Number of a second pack, to show next to it."),
    ] = None,
    tasks: Annotated[
        str | None,
        typer.Option(
            "--dataset",
            help="Dataset that was played, for results: to show the items that are not packed.",
        ),
    ] = None,
    library: DatasetLibraryOption = None,
    host: HostOption = LOOPBACK,
    port: PortOption = None,
    browser: BrowserOption = True,
) -> None:
    """Show packs or results on an interactive local web page, until Ctrl-C.

    Example: packit view results.jsonl --dataset starter --pack 3
    """
    folder = dataset_path(dataset).is_dir()
    collection = PackCollection.read(
        dataset,
        ShapeLibrary.open(library) if library else None,
        split if folder or tasks is None else None,
        tasks,
        split,
    )
    with Explorer(collection, pack, second, host=host, port=port) as explorer:
        serve_until_interrupt(dataset, explorer.address, host, browser)
    console.print("\nthe viewer is closed")


def workbench_command(
    host: HostOption = LOOPBACK, port: PortOption = None, browser: BrowserOption = True
) -> None:
    """Pack your own parts on a local web page, until Ctrl-C.

    Drop mesh files on the page, set the box, press Pack, and watch. Locked parts stay in place
    while the others are packed again. Files stay on this machine. Download the results, since
    nothing is kept when the command ends.

    Example: packit workbench
    """
    with Workbench(host, port) as workbench:
        serve_until_interrupt("the workbench", workbench.address, host, browser)
    console.print("\nthe workbench is closed")
