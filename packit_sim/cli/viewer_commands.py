"""`packit view` and `packit workbench`: local web pages."""

from __future__ import annotations

from typing import Annotated

import typer

import packit_sim
from packit_sim.cli.local_pages import BrowserOption, HostOption, PortOption, serve_until_interrupt
from packit_sim.cli.options import DatasetArgument, DatasetLibraryOption, SplitOption
from packit_sim.core.lazy_imports import lazy_imports
from packit_sim.web.origins import LOOPBACK

with lazy_imports():
    from packit_sim.cli import terminal
    from packit_sim.game.datasets import pack_files
    from packit_sim.parts.workbench import workbench as workbench_page


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
    folder = pack_files.dataset_path(dataset).is_dir()
    collection = packit_sim.PackCollection.read(
        dataset,
        packit_sim.ShapeLibrary.open(library) if library else None,
        split if folder or tasks is None else None,
        tasks,
        split,
    )
    with packit_sim.Explorer(collection, pack, second, host=host, port=port) as explorer:
        serve_until_interrupt(dataset, explorer.address, host, browser)
    terminal.console.print("\nthe viewer is closed")


def workbench_command(
    host: HostOption = LOOPBACK, port: PortOption = None, browser: BrowserOption = True
) -> None:
    """Pack your own parts on a local web page, until Ctrl-C.

    Drop mesh files on the page, set the box, press Pack, and watch. Locked parts stay in place
    while the others are packed again. Files stay on this machine. Download the results, since
    nothing is kept when the command ends.

    Example: packit workbench
    """
    with workbench_page.Workbench(host, port) as workbench:
        serve_until_interrupt("the workbench", workbench.address, host, browser)
    terminal.console.print("\nthe workbench is closed")
