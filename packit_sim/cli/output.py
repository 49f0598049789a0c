"""Output of commands: tables, JSON files, the folders and paths of written files."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from packit_sim.cli.terminal import console
from packit_sim.core.errors import PackItError
from packit_sim.core.files import replace_text, require_replaceable


def simple_table(*columns: str, **options: Any) -> Table:
    """Create a table with a line below its head; the options are those of `rich.table.Table`."""
    return Table(*columns, box=SIMPLE_HEAD, show_edge=False, pad_edge=False, **options)


def print_written(path: Path | str, note: str = "") -> None:
    """Print the path of a file that was written."""
    console.print(f"wrote {path}{note}", soft_wrap=True, markup=False)


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file atomically, and print its path."""
    replace_text(path, json.dumps(content, ensure_ascii=False, indent=1) + "\n")
    print_written(path)


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
