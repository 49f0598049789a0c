"""Manifests of parts: tables or JSON files that name mesh files with counts and settings."""

from __future__ import annotations

import json
import re
import reprlib
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import zip_longest
from pathlib import Path
from typing import Any

from packit_sim.core.errors import ArgumentError, located
from packit_sim.core.length_units import check_unit
from packit_sim.core.typed_json import MAX_DIGITS, refuse_long_integers
from packit_sim.libraries.data_files import read_bytes
from packit_sim.parts.packings.bounds import COUNTS, PRIORITIES
from packit_sim.parts.reading.tables import (
    Table,
    as_number,
    decoded,
    has_decimal_commas,
    read_table,
)
from packit_sim.parts.reading.turnings import read_angle, read_sides

MANIFESTS = (".csv", ".json", ".tsv", ".txt", ".xlsx")
"""Suffixes of manifests."""


def _yes_or_no(value: object) -> bool:
    """Read a truth value in words."""
    for meaning, words in ((True, ("yes", "true", "1")), (False, ("no", "false", "0"))):
        if str(value).lower() in words:
            return meaning
    raise ValueError


def _length(value: object) -> str:
    """Return a length as text, whose unit may be that of a file."""
    return str(value)


_LENGTH = re.compile(r"\s*([\d.,]+)(\s*[a-zµ°]*)\s*")
"""A length or an angle: a number as tables have it, and perhaps a unit."""

SURPLUS: Mapping[str, Mapping[str, Any]] = {
    "max": {"count": int(COUNTS.high), "as_many_as_fit": True},
    "fill": {
        "count": int(COUNTS.high),
        "as_many_as_fit": True,
        "priority": int(PRIORITIES.low),
    },
}
"""Words instead of a count, with what they mean: as many as fit, and that after everything else."""

_FIELDS: Mapping[str, Callable[[Any], object]] = {
    "file": str,
    "name": str,
    "count": int,
    "value": float,
    "rotations": str,
    "priority": int,
    "mass": float,
    "density": float,
    "no_stack": _yes_or_no,
    "max_load": float,
    "unit": check_unit,
    "clearance": _length,
    "group": str,
    "max_tilt": read_angle,
    "down": read_sides,
    "stop": int,
}
"""The fields of a part."""

SYNONYMS = {
    "amount": "count",
    "filename": "file",
    "filepath": "file",
    "partname": "name",
    "path": "file",
    "pcs": "count",
    "pieces": "count",
    "qty": "count",
    "quantity": "count",
    "rotation": "rotations",
    "units": "unit",
    "weight": "mass",
}
"""Other headings of fields, without spaces and in lower case."""

_UNITS = {"mass": ("g",), "density": ("g/cm3", "g/cm³"), "max_load": ("g",)}
_UNITS |= {"max_tilt": ("deg", "°"), "clearance": ()}
"""The unit that a heading may have in brackets, such as "Mass (g)"."""


@dataclass(frozen=True)
class ManifestRow:
    """A file to pack, with its settings.

    Attributes
    ----------
    file : Path
        The mesh file.
    settings : mapping of str to object
        Fields of `Part`, by name.
    where : str, optional
        The manifest and the row in it.
    """

    file: Path
    settings: Mapping[str, Any]
    where: str | None = None

    @property
    def count(self) -> int:
        """The number of parts to pack."""
        return int(self.settings.get("count", 1))


@dataclass(frozen=True)
class Manifest:
    """The rows of a manifest.

    Attributes
    ----------
    rows : tuple of ManifestRow
        Its rows, without those whose count is 0.
    unread : tuple of (str, str)
        Each row that can't be read, and why.
    notes : tuple of str
        What the user should know about how it was read.
    """

    rows: tuple[ManifestRow, ...]
    unread: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()


def read_manifest(path: Path) -> Manifest:
    """Read a manifest.

    Parameters
    ----------
    path : Path
        A table with a heading (`read_table`), or a JSON file with a list of objects, which may be
        the field "parts" of an object.

    Returns
    -------
    Manifest
        Its rows; files are relative to the manifest's folder.

    Raises
    ------
    ArgumentError
        If it can't be read, has no rows, or its heading has no file or is misspelt.
    MissingPackageError
        If it is a spreadsheet, and the package that reads them is not installed.
    """
    notes: list[str] = []
    entries: Iterable[tuple[int, Mapping[str, Any]]]
    if path.suffix.lower() == ".json":
        entries = enumerate(_json_entries(path), start=1)
        what, is_comma = "part", False
    else:
        table = read_table(path)
        notes += table.notes
        names = _heading(path, table, notes)
        entries = _table_entries(table, names)
        what, is_comma = "row", _is_comma(table, names)
    rows, unread = [], []
    for number, entry in entries:
        where = f"{path.name}, {what} {number}"
        try:
            fields = part_fields(entry, is_comma)
            if not fields.get("file"):
                raise ArgumentError("it has no file")
        except ArgumentError as error:
            unread.append((where, str(error)))
            continue
        file = _found(path.parent, str(fields.pop("file")))
        if fields.get("count", 1) != 0:
            rows.append(ManifestRow(file, fields, where))
    if not rows and not unread:
        raise ArgumentError(f"{path}: it has no parts")
    return Manifest(tuple(rows), tuple(unread), tuple(f"{path.name}: {note}" for note in notes))


def _heading(path: Path, table: Table, notes: list[str]) -> list[str | None]:
    """Return the field of each column: None of those of no use, "" of those without a heading."""
    names: list[str | None] = []
    for cell in table.heading:
        text = str(cell).strip()
        name = _field(path, text) if text else ""
        if name and name in names:
            raise ArgumentError(f"{path}: two columns are the {name}, one of them {text!r}")
        if name is None:
            notes.append(f"column {reprlib.repr(text)} is not used")
        names.append(name)
    if "file" not in names:
        found = ", ".join(reprlib.repr(str(cell)) for cell in table.heading[:9])
        raise ArgumentError(
            f"{path}: it has no file: its first row must name the columns "
            f"({', '.join(_FIELDS)}), and is {found or 'empty'}"
        )
    return names


def _field(path: Path, text: str) -> str | None:
    """Return the field that a heading means; raise ArgumentError if it seems to be misspelt."""
    base, unit = text.casefold(), None
    if match := re.fullmatch(r"([^()\[\]]*)[(\[]([^()\[\]]*)[)\]]", base):
        base, unit = match[1], match[2].strip()
    short = re.sub(r"[\s_.-]+", "", base)
    known = {name.replace("_", ""): name for name in _FIELDS} | SYNONYMS
    if short not in known:
        if close := get_close_matches(short, known, 1, 0.75):
            raise ArgumentError(
                f"{path}: column {text!r} is not known: is it {known[close[0]]!r}? "
                f"The columns are {', '.join(_FIELDS)}"
            )
        return None
    name = known[short]
    if unit is not None and name in _UNITS and unit not in _UNITS[name]:
        must = f"its unit must be {_UNITS[name][0]}" if _UNITS[name] else "units are in its cells"
        raise ArgumentError(f"{path}: column {text!r}: {must}")
    return name


def _is_comma(table: Table, names: list[str | None]) -> bool:
    numeric = (int, float, _length, read_angle)
    columns = [n for n, name in enumerate(names) if name and _FIELDS[name] in numeric]
    cells = (row[n] for _, row in table.rows for n in columns if n < len(row))
    numbers = (_LENGTH.sub(r"\1", each) if isinstance(each, str) else each for each in cells)
    return has_decimal_commas(numbers, table.is_semicolon)


def _table_entries(
    table: Table, names: list[str | None]
) -> Iterator[tuple[int, Mapping[str, Any]]]:
    """Yield the fields of each row."""
    for number, row in table.rows:
        cells = zip_longest(names, row, fillvalue="")
        yield (
            number,
            {
                name or f"column {n}, without a heading": cell
                for n, (name, cell) in enumerate(cells, start=1)
                if name is not None and cell != ""
            },
        )


def _json_entries(path: Path) -> Iterable[Mapping[str, Any]]:
    text, _ = decoded(path, read_bytes(path))
    with located(path, ArgumentError):
        refuse_long_integers(text, ArgumentError)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ArgumentError(f"{path}: it is not JSON: {error}") from None
    if isinstance(content, dict):
        content = content.get("parts")
    if not isinstance(content, list) or not all(isinstance(each, dict) for each in content):
        raise ArgumentError(f'{path}: it must be a list of objects, such as [{{"file": "a.stl"}}]')
    return content


def part_fields(entry: Mapping[str, Any], is_comma: bool = False) -> dict[str, Any]:
    """Read the fields of a part.

    Parameters
    ----------
    entry : mapping of str to object
        The fields by name, as text or numbers.
    is_comma : bool
        Whether numbers as text have decimal commas.

    Returns
    -------
    dict[str, object]
        Fields of `Part`; a clearance stays text.

    Raises
    ------
    ArgumentError
        If a field is not known or not possible.
    """
    found: dict[str, Any] = {}
    surplus: Mapping[str, Any] = {}
    for name, value in entry.items():
        if name not in _FIELDS:
            raise ArgumentError(
                f"field {reprlib.repr(name)} is not known: choose from {', '.join(_FIELDS)}"
            )
        is_wrong = isinstance(value, bool) and name != "no_stack"
        if is_wrong or not isinstance(value, (str, int, float)):
            raise ArgumentError(f"{name} {reprlib.repr(value)} is not possible")
        if name == "count" and str(value).strip().lower() in SURPLUS:
            surplus = SURPLUS[str(value).strip().lower()]
            continue
        try:
            found[name] = _value(name, value, is_comma)
        except (TypeError, ValueError, OverflowError) as error:
            if isinstance(error, ArgumentError):
                raise ArgumentError(f"{name} {error}" if name != "unit" else str(error)) from None
            kinds = {_yes_or_no: "yes or no", int: "a whole number"}
            what = kinds.get(_FIELDS[name], "a number")
            what += f", {' or '.join(SURPLUS)}" * (name == "count")
            raise ArgumentError(f"{name} {reprlib.repr(value)} is not {what}") from None
    if found.get("count", 1) < 0:
        raise ArgumentError(f"count {found['count']} is not possible: at least 0")
    return {**found, **surplus}


def _value(name: str, value: Any, is_comma: bool) -> object:
    """Convert the value of a field."""
    kind = _FIELDS[name]
    if kind is str and isinstance(value, float) and value.is_integer():
        value = int(value)  # a spreadsheet has no integers: the name 7 is 7.0 there
    if kind is _yes_or_no and isinstance(value, float):
        value = int(value) if value.is_integer() else value
    if isinstance(value, str):
        value = value.strip()
    if kind in (_length, read_angle) and (match := _LENGTH.fullmatch(str(value))):
        value = f"{as_number(match[1], is_comma)!r}{match[2]}"
    if kind is float:
        return as_number(value, is_comma)
    if kind is int and not isinstance(value, int):
        if isinstance(value, str) and re.fullmatch(r"[+-]?[0-9]+", value):
            if len(value) > MAX_DIGITS:
                raise ArgumentError(
                    f"of {len(value):,} digits is not possible: at most {MAX_DIGITS}"
                )
            return int(value)
        number = as_number(value, is_comma)
        if int(number) != number:
            raise ValueError
        return int(number)
    return kind(value)


def _found(folder: Path, text: str) -> Path:
    """Return the file of a row; it may be written with backslashes, or in other Unicode forms."""
    for path in (text, text.replace("\\", "/")):
        for form in (path, unicodedata.normalize("NFC", path), unicodedata.normalize("NFD", path)):
            try:
                if (folder / form).exists():
                    return folder / form
            except (OSError, ValueError):  # of a name that is too long, or has a null
                pass
    return folder / text
