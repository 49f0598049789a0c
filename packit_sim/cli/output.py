"""Output of commands: tables, JSON files, the folders and paths of written files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType
from rich.table import Table
from rich.text import Text

from packit_sim.cli.terminal import console
from packit_sim.core.errors import PackItError
from packit_sim.core.files import replace_text, require_replaceable

_SPACE = 2
"""Columns between those of a `NumberTable`."""


def simple_table(*columns: str, **options: Any) -> Table:
    """Create a table with a line below its head; the options are those of `rich.table.Table`."""
    return Table(*columns, box=SIMPLE_HEAD, show_edge=False, pad_edge=False, **options)


class NumberTable:
    """A table of numbers, whose columns continue below where the console is too narrow for all.

    Parameters
    ----------
    *columns : str
        Headings; the first column names the rows, and is repeated.

    Attributes
    ----------
    caption : str
        A text below the table.
    """

    def __init__(self, *columns: str) -> None:
        self._rows: list[tuple[str, ...]] = [columns]
        self.caption = ""

    def add_row(self, *cells: str) -> None:
        """Add a row; cells have markup, and may have several lines."""
        self._rows.append(cells)

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> Iterator[RenderableType]:
        for columns in self._blocks(options.max_width):
            table = simple_table(padding=(0, _SPACE - 1, 0, 0))
            for column in columns:
                table.add_column(self._rows[0][column], justify="right", no_wrap=True)
            for row in self._rows[1:]:
                table.add_row(*(row[column] for column in columns))
            yield table
        if self.caption:
            yield Text(self.caption, style="table.caption")

    def _blocks(self, width: int) -> Iterator[list[int]]:
        """Divide the columns into those that fit next to each other."""
        first, *others = (
            max(map(_width, column)) + _SPACE for column in zip(*self._rows, strict=True)
        )
        block, used = [0], first
        for number, own in enumerate(others, start=1):
            if used + own > width and len(block) > 1:
                yield block
                block, used = [0], first
            block.append(number)
            used += own
        yield block


def _width(cell: str) -> int:
    return max(map(cell_len, Text.from_markup(cell).plain.splitlines()), default=0)


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
