"""Manifests of parts: CSV or JSON files that name mesh files with counts and settings."""

from __future__ import annotations

import csv
import io
import json
import reprlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from packit_sim.core.errors import ArgumentError, located
from packit_sim.core.typed_json import refuse_long_integers
from packit_sim.libraries.data_files import read_bytes
from packit_sim.parts.reading.units import check_unit

MANIFESTS = (".csv", ".json")
"""Suffixes of manifests."""


def _yes_or_no(value: object) -> bool:
    """Read a truth value in words."""
    for meaning, words in ((True, ("yes", "true", "1")), (False, ("no", "false", "0"))):
        if str(value).lower() in words:
            return meaning
    raise ValueError


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
}
"""The fields of a part."""


@dataclass(frozen=True)
class ManifestRow:
    """A file to pack, with its settings.

    Attributes
    ----------
    file : Path
        The mesh file.
    settings : mapping of str to object
        Fields of `Part`, by name.
    """

    file: Path
    settings: Mapping[str, Any]

    @property
    def count(self) -> int:
        """The number of parts to pack."""
        return int(self.settings.get("count", 1))


def read_manifest(path: Path) -> list[ManifestRow]:
    """Read a manifest.

    Parameters
    ----------
    path : Path
        A CSV file with a line of column names, or a JSON file with a list of objects, which may be
        the field "parts" of an object.

    Returns
    -------
    list of ManifestRow
        Its parts; files are relative to the manifest's folder. Rows with a count of 0 are left out.

    Raises
    ------
    ArgumentError
        If it can't be read, or a field is not known or not possible.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ArgumentError(f"{path}: it is not a text file in UTF-8") from None
    entries = _json_rows(path, text) if path.suffix.lower() == ".json" else _csv_rows(path, text)
    rows = []
    for number, entry in enumerate(entries, start=1):
        fields = _fields(f"{path}, part {number}", entry)
        file = path.parent / str(fields.pop("file"))
        if fields.get("count", 1) != 0:
            rows.append(ManifestRow(file, fields))
    if not rows:
        raise ArgumentError(f"{path}: it has no parts")
    return rows


def _csv_rows(path: Path, text: str) -> Iterable[Mapping[str, Any]]:
    """Yield the rows of a CSV file; its separator is a comma, semicolon or tab."""
    head = text.partition("\n")[0]
    separator = max(",;\t", key=head.count)
    reader = csv.DictReader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    try:
        rows = list(reader)
    except csv.Error as error:
        raise ArgumentError(f"{path}: it is not CSV: {error}") from None
    for row in rows:
        if None in row:
            raise ArgumentError(
                f"{path}: {reprlib.repr(row[None])} is more than the {len(row) - 1} fields"
            )
        entry = {(name or "").strip(): value for name, value in row.items()}
        if any(isinstance(value, str) and value.strip() for value in entry.values()):
            yield {name: v for name, v in entry.items() if v is not None and v != ""}


def _json_rows(path: Path, text: str) -> Iterable[Mapping[str, Any]]:
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


def _fields(where: str, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Check the fields of a part."""
    found: dict[str, Any] = {}
    for name, value in entry.items():
        if name not in _FIELDS:
            raise ArgumentError(
                f"{where}: field {reprlib.repr(name)} is not known: "
                f"choose from {', '.join(_FIELDS)}"
            )
        is_wrong = isinstance(value, bool) and name != "no_stack"
        if isinstance(value, (list, dict)) or value is None or is_wrong:
            raise ArgumentError(f"{where}: {name} {reprlib.repr(value)} is not possible")
        try:
            if isinstance(value, float) and _FIELDS[name] is int and int(value) != value:
                raise ValueError
            found[name] = _FIELDS[name](value.strip() if isinstance(value, str) else value)
        except ArgumentError as error:
            raise ArgumentError(f"{where}: {error}") from None
        except (TypeError, ValueError, OverflowError):
            what = "yes or no" if name == "no_stack" else "a number"
            raise ArgumentError(f"{where}: {name} {reprlib.repr(value)} is not {what}") from None
    if not found.get("file"):
        raise ArgumentError(f"{where}: it has no file")
    if found.get("count", 1) < 0:
        raise ArgumentError(f"{where}: count {found['count']} is not possible: at least 0")
    return found
