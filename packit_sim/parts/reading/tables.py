"""Tables of cells, from text files and spreadsheets as people's programs write them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from zipfile import ZipFile

from packit_sim.core.errors import ArgumentError
from packit_sim.core.extras import needed_for
from packit_sim.libraries.data_files import read_bytes

MAX_BYTES = 2**28
"""Maximum size of a table, and of a spreadsheet's unpacked content."""

MAX_ROWS = 100_000

MAX_CELLS = 5_000_000
"""Maximum number of cells of a spreadsheet, also of empty ones between others."""

MAX_COLUMNS = 1000

_SPACES = re.compile(r"(?<=\d)[ \u00a0\u202f](?=\d{3}(?!\d))")
"""Separators of thousands that are spaces."""

_ONLY_DECIMAL = re.compile(r"[+-]?(\d{1,3}(\.\d{3})+,\d+|(\d*|\d{4,}),(\d{1,2}|\d{4,}))")
"""A number whose comma can't separate thousands."""

_ONE_COMMA = re.compile(r"[+-]?\d+,\d+")


_TAG = re.compile(rb"""<(?:\w+:)?(row|c)\b((?:[^<>"']|"[^"]*"|'[^']*')*)""")
"""The beginning of a row or a cell of a sheet, and its attributes."""

_PLACE = re.compile(rb"""\br\s*=\s*["']([A-Za-z]{0,9})(\d{1,9})""")
"""The column and the row in an attribute."""


@dataclass(frozen=True)
class Table:
    """A table of cells.

    Attributes
    ----------
    heading : tuple
        The cells of the first row that is not empty.
    rows : tuple of (int, tuple)
        The cells of each further row that is not empty, with its number from 1. Those of text files
        are text; an empty one is "".
    notes : tuple of str
        What the user should know about how it was read.
    is_semicolon : bool
        Whether semicolons separate its cells, as where commas are decimal.
    """

    heading: tuple[Any, ...]
    rows: tuple[tuple[int, tuple[Any, ...]], ...]
    notes: tuple[str, ...] = ()
    is_semicolon: bool = False


def read_table(path: Path) -> Table:
    """Read a table.

    Parameters
    ----------
    path : Path
        A spreadsheet (.xlsx), of which the first sheet with content counts, or a text file in
        UTF-8, UTF-16 or cp1252 with commas, semicolons or tabs between cells.

    Returns
    -------
    Table
        Its rows.

    Raises
    ------
    ArgumentError
        If it can't be read.
    MissingPackageError
        If it is a spreadsheet, and the package that reads them is not installed.
    """
    content = read_bytes(path)
    if len(content) > MAX_BYTES:
        raise ArgumentError(f"{path}: {len(content):,} bytes are too many: at most {MAX_BYTES:,}")
    is_sheet = path.suffix.lower() == ".xlsx"
    rows, notes, is_semicolon = _sheet(path, content) if is_sheet else _text(path, content)
    if len(rows) > MAX_ROWS:
        raise ArgumentError(f"{path}: {len(rows):,} rows are too many: at most {MAX_ROWS:,}")
    if any(len(row) > MAX_COLUMNS for row in rows):
        raise ArgumentError(f"{path}: a row has more than {MAX_COLUMNS:,} cells")
    plain = (tuple(c.strip() if isinstance(c, str) else c for c in row) for row in rows)
    filled = [(n, row) for n, row in enumerate(plain, start=1) if any(c != "" for c in row)]
    if not filled:
        raise ArgumentError(f"{path}: it has no parts")
    return Table(filled[0][1], tuple(filled[1:]), notes, is_semicolon)


def decoded(path: Path, content: bytes) -> tuple[str, str]:
    """Decode a text file.

    Returns
    -------
    tuple of str
        The text, and the name of its encoding: UTF-8, UTF-16 or cp1252.

    Raises
    ------
    ArgumentError
        If it is none of them.
    """
    encodings = ["utf-8-sig", "cp1252"]
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ["utf-16"]
    elif b"\0" in content:  # UTF-16 without its mark
        encodings = ["utf-16-le" if content[1::2].count(0) > content[::2].count(0) else "utf-16-be"]
    for encoding in encodings:
        try:
            return content.decode(encoding), encoding
        except UnicodeDecodeError:
            pass
    raise ArgumentError(f"{path}: it is not a text file in UTF-8, UTF-16 or cp1252")


def has_decimal_commas(cells: Iterable[Any], is_semicolon: bool) -> bool:
    """Return whether numbers are written with decimal commas, such as 7,8.

    Parameters
    ----------
    cells : iterable
        The cells of all columns of numbers: one that has no other meaning decides for all.
    is_semicolon : bool
        Whether semicolons separate cells: programs write them where commas are decimal.

    Returns
    -------
    bool
        Whether one of them is.
    """
    pattern = _ONE_COMMA if is_semicolon else _ONLY_DECIMAL
    texts = (cell.strip() for cell in cells if isinstance(cell, str))
    return any(pattern.fullmatch(text) or _ONLY_DECIMAL.fullmatch(text) for text in texts)


def as_number(cell: Any, is_comma: bool) -> float:
    """Read a number.

    Parameters
    ----------
    cell : object
        A number, or a text such as "7.8", "1,234.5" or "1 234".
    is_comma : bool
        Whether commas are decimal: "7,8", "1.234,5".

    Returns
    -------
    float
        The number.

    Raises
    ------
    ArgumentError
        If it has two meanings: "1,500", or "1.500" where commas are decimal.
    ValueError
        If it is no number.
    """
    if not isinstance(cell, str):
        return float(cell)
    text = _SPACES.sub("", cell.strip())
    thousands, decimal = (".", ",") if is_comma else (",", ".")
    groups = re.fullmatch(
        rf"[+-]?\d{{1,3}}((?:\{thousands}\d{{3}})+)(\{decimal}\d+)?", text, re.ASCII
    )
    if groups is not None:
        if groups[2] is None and len(groups[1]) == 4:
            plain, point = text.replace(thousands, ""), text.replace(thousands, decimal)
            raise ArgumentError(f"{cell!r} is {plain} or {point}: write one of these")
        text = text.replace(thousands, "")
    if "_" in text:
        raise ValueError
    return float(text.replace(decimal, "."))


_Rows: TypeAlias = Sequence[Sequence[Any]]


def _text(path: Path, content: bytes) -> tuple[_Rows, tuple[str, ...], bool]:
    """Return the rows of a text file, notes, and whether semicolons separate its cells."""
    text, encoding = decoded(path, content)
    notes: tuple[str, ...] = ()
    if encoding == "cp1252":
        notes = ("not UTF-8, so read as cp1252 (Western European Windows)",)
    named = re.match(r"sep=(.)\r?\n", text)  # which tells Excel
    head = text.lstrip("\r\n").partition("\n")[0]
    separator = max(",;\t", key=head.count) if any(c in head for c in ",;\t") else "\x1f"
    if named is not None:
        text, separator = text[named.end() :], named[1]
    try:
        reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
        rows = list(reader)
    except (csv.Error, TypeError, ValueError) as error:
        raise ArgumentError(f"{path}: it is not CSV: {error}") from None
    return rows, notes, separator == ";"


def _cells(sheet: bytes) -> int:
    """Return the number of cells of a sheet's smallest rectangle around those that it lists.

    calamine takes memory for all of them, and ends the process if there is too little.
    """
    cells, last_row, last_column = 0, 1, 0
    row = b""  # attributes of a row, whose number counts if a cell follows
    for kind, attributes in _TAG.findall(sheet):
        if kind == b"row":
            row = attributes
            continue
        cells += 1
        places = _PLACE.findall(attributes)
        last_row = max(last_row, *(int(number) for _, number in (*_PLACE.findall(row), *places)), 1)
        columns = [_column(letters.upper()) for letters, _ in places]
        last_column = max(last_column, *columns, 0 if places else cells)  # else they follow on
        row = b""
    return last_row * last_column


def _column(letters: bytes) -> int:
    """Return the number of a column from 1: 27 of "AA"."""
    number = 0
    for letter in letters:
        number = number * 26 + letter - ord("A") + 1
    return number


def _sheet(path: Path, content: bytes) -> tuple[_Rows, tuple[str, ...], bool]:
    """Return the same of the first sheet with content."""
    with needed_for("lists in .xlsx", "save the list as CSV"):
        from python_calamine import CalamineWorkbook
    try:
        archive = ZipFile(io.BytesIO(content))
        unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > MAX_BYTES:
            raise ArgumentError(f"{path}: it unpacks to {unpacked:,} bytes: at most {MAX_BYTES:,}")
        cells = max((_cells(archive.read(name)) for name in archive.namelist()), default=0)
    except ArgumentError:
        raise
    except Exception as error:  # zipfile raises any error for a broken archive
        raise ArgumentError(f"{path}: it is no .xlsx file: {error!s:.200}") from None
    if cells > MAX_CELLS:
        raise ArgumentError(f"{path}: {cells:,} cells are too many: at most {MAX_CELLS:,}")
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(content))
        names = book.sheet_names
        for name in names:
            sheet = book.get_sheet_by_name(name)
            rows = sheet.to_python(skip_empty_area=False, nrows=MAX_ROWS + 1)
            if any(cell != "" for row in rows for cell in row):
                notes = (f"sheet {name!r} of {len(names)} is read",) if len(names) > 1 else ()
                return rows, notes, False
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a panic of its Rust code is not an Exception
        raise ArgumentError(f"{path}: it can't be read as .xlsx: {error!s:.200}") from None
    return [], (), False
