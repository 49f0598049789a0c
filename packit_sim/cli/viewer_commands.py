"""`packit view`: packs and results on a local web page."""

from __future__ import annotations

import os
import threading
import webbrowser
from contextlib import suppress
from typing import Annotated

import typer

from packit_sim.cli.console import DatasetArgument, DatasetLibraryOption, SplitOption, console
from packit_sim.datasets.pack_files import dataset_path
from packit_sim.explorer.collection import PackCollection
from packit_sim.explorer.explorer import Explorer
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.viewer.web_page import LOOPBACK

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
"""Set where a browser can open a window."""


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
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 allows other machines.")
    ] = LOOPBACK,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port to listen on; default: a free one.")
    ] = None,
    browser: Annotated[
        bool, typer.Option(help="Open the page in the browser, if there is a screen.")
    ] = True,
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
    with (
        Explorer(collection, pack, second, host=host, port=port) as explorer,
        suppress(KeyboardInterrupt),
    ):
        console.print(f"{dataset} is shown at {explorer.address} until Ctrl-C", soft_wrap=True)
        if host == LOOPBACK and not _has_screen():
            number = explorer.address.rpartition(":")[2]
            console.print(
                "there is no screen here: open the address in a browser on this machine, or on "
                f"yours after ssh -L {number}:{LOOPBACK}:{number} THIS_MACHINE",
                soft_wrap=True,
            )
        elif browser and _has_screen():
            webbrowser.open(explorer.address)
        threading.Event().wait()
    console.print("\nthe viewer is closed")


def _has_screen() -> bool:
    return any(os.environ.get(name) for name in _DISPLAYS)
