"""Output of commands: tables, JSON files, and the paths of written files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from packit_sim.cli.console import console
from packit_sim.core.errors import LibraryError
from packit_sim.core.files import replace_text
from packit_sim.game.datasets.pack_files import recorded_library
from packit_sim.game.evaluation.results import Rollout, check_results
from packit_sim.libraries.library import ShapeLibrary

RESUMABLE = "repeat the command to resume"

NOTHING_WRITTEN = "nothing is written"


def simple_table(*columns: str, **options: Any) -> Table:
    """Create a table with a line below its head; the options are those of `rich.table.Table`."""
    return Table(*columns, box=SIMPLE_HEAD, show_edge=False, pad_edge=False, **options)


def print_written(path: Path | str, note: str = "") -> None:
    """Print the path of a file that was written."""
    console.print(f"wrote {path}{note}", soft_wrap=True, markup=False)


def check_shown(
    file: Path, rollouts: Sequence[Rollout], library: ShapeLibrary | None = None
) -> None:
    """Check results as `check_results` does, and print how many returns could not be checked.

    Parameters
    ----------
    file : Path
        The file of the results.
    rollouts : Sequence[Rollout]
        The results.
    library : ShapeLibrary | None
        Their library; by default the recorded one, if it can be opened.
    """
    why = "the items of their tasks are not recorded"
    if library is None:
        try:
            library = recorded_library((rollout.pack.library for rollout in rollouts), file)
        except LibraryError as error:
            why = str(error)
    if unchecked := check_results(file, rollouts, library):
        note = f"{file}: {unchecked} of {len(rollouts)} returns are not checked: {why}"
        console.print(note, style="yellow", markup=False, soft_wrap=True)


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file atomically, and print its path."""
    replace_text(path, json.dumps(content, ensure_ascii=False, indent=1) + "\n")
    print_written(path)


@contextmanager
def stoppable(hint: str) -> Iterator[None]:
    """Let Ctrl-C end the command with a message and exit code 130.

    Parameters
    ----------
    hint : str
        A note on what remains, or on how to resume.

    Yields
    ------
    None
        While the command works.
    """
    try:
        yield
    except KeyboardInterrupt:
        console.print(f"stopped: {hint}", markup=False)
        raise typer.Exit(130) from None
