"""Lists of boxes: tables that name boxes and other containers, with counts and limits."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from packit_sim.core.errors import ArgumentError, located
from packit_sim.parts.reading.boxes import Boxes, MeshBox, OneBox
from packit_sim.parts.reading.limits import Limits, read_limits
from packit_sim.parts.reading.tables import read_table

SUFFIXES = (".csv", ".tsv", ".xlsx")
"""Suffixes of lists of boxes."""

_COLUMNS = ("box", "name", "count", "max_mass", "max_parts", "balance")


def without_lists(boxes: Boxes) -> tuple[Boxes, dict[str, Limits]]:
    """Replace lists of boxes by the boxes in them.

    Parameters
    ----------
    boxes : str, BoxType, Container, or sequence of float, str, BoxType or Container
        The boxes; a text with one of `SUFFIXES` is the path of a list.

    Returns
    -------
    boxes : Boxes
        The same, with a text as `--box` or `--container` takes it for each row.
    limits : dict of str to Limits
        The limits of those that have some, by their names.

    Raises
    ------
    ArgumentError
        If a list can't be read, or a cell is not possible.
    MissingPackageError
        If it is a spreadsheet, and the package that reads them is not installed.
    """
    several: Any = [boxes] if isinstance(boxes, OneBox) else boxes
    if not any(map(is_list, several)):
        return boxes, {}
    found: list[Any] = []
    limits: dict[str, Limits] = {}
    for each in several:
        if not is_list(each):
            found.append(each)
            continue
        path = Path(each)
        for number, row in _rows(path):
            with located(f"{path}, row {number}", ArgumentError):
                text, name, own = _box(path.parent, row)
            found.append(text)
            if not own.is_empty:
                limits[name] = own
    return found, limits


def is_list(box: object) -> bool:
    """Return whether a box is the path of a list of boxes."""
    return isinstance(box, str) and Path(box).suffix.lower() in SUFFIXES


def _rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Return the cells of each row that are not empty, by their columns, with its number."""
    table = read_table(path)
    names = [str(cell).strip().casefold().replace(" ", "_") for cell in table.heading]
    if "box" not in names or len(set(names)) < len(names) or not set(names) <= set(_COLUMNS):
        raise ArgumentError(
            f"{path}: its first row is {', '.join(map(str, table.heading))}: choose each at most "
            f"once from {', '.join(_COLUMNS)}, with box"
        )
    if not table.rows:
        raise ArgumentError(f"{path}: it has no boxes")
    found = []
    for number, row in table.rows:
        if len(row) > len(names) and any(cell != "" for cell in row[len(names) :]):
            raise ArgumentError(f"{path}, row {number}: it has more cells than the first row")
        cells = {name: _text(cell) for name, cell in zip(names, row, strict=False)}
        found.append((number, {name: cell for name, cell in cells.items() if cell}))
    return found


def _text(cell: object) -> str:
    """Return a cell as text; a spreadsheet has no integers."""
    is_whole = isinstance(cell, float) and cell.is_integer()
    return str(int(cell) if is_whole else cell).strip()  # type: ignore[call-overload]


def _box(folder: Path, row: Mapping[str, str]) -> tuple[str, str, Limits]:
    """Return the text of a box, its name, and its limits."""
    text = row.get("box", "")
    if not text:
        raise ArgumentError("it has no box")
    is_named = ":" in text.removeprefix("cylinder:") and not os.path.isabs(text)
    if is_named or "=" in text:
        raise ArgumentError(f"box {text!r} is not possible: its name and count are other cells")
    count = row.get("count", "1")
    if not count.isdecimal():
        raise ArgumentError(f"count {count!r} is not a whole number")
    if MeshBox.parse(text) is not None:
        text = str(folder / text)
    asked = [[row[key]] if key in row else [] for key in ("max_mass", "max_parts", "balance")]
    if any(":" in value for own in asked for value in own):
        raise ArgumentError("its limits are for the row's own box: leave out the name")
    limits = read_limits(*asked).get("", Limits())
    name = row.get("name", "")
    if not name and not limits.is_empty:
        raise ArgumentError("a box with limits needs a name")
    text = f"{name}:{text}" if name else text
    return f"{text}={count}" if "count" in row else text, name, limits
