"""Writers of lists of parts as programs for spreadsheets write them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

Row = Mapping[str, str | int | float]

_HEADINGS = {"file": "File", "count": "Quantity", "name": "Name", "density": "Density"}


def _columns(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))


def _cell(value: object, mark: str) -> str:
    return str(value).replace(".", mark) if isinstance(value, float) else str(value)


def _lines(rows: Sequence[Row], between: str, mark: str = ".") -> str:
    columns = _columns(rows)
    lines = [between.join(columns)]
    lines += [between.join(_cell(row.get(name, ""), mark) for name in columns) for row in rows]
    return "".join(f"{line}\r\n" for line in lines)


def plain(path: Path, rows: Sequence[Row]) -> None:
    """Write CSV in UTF-8 with commas."""
    path.write_bytes(_lines(rows, ",").encode())


def german(path: Path, rows: Sequence[Row]) -> None:
    """Write CSV as Excel does in Europe: semicolons, decimal commas, cp1252."""
    path.write_bytes(_lines(rows, ";", ",").encode("cp1252"))


def unicode_text(path: Path, rows: Sequence[Row]) -> None:
    """Write what Excel calls Unicode text: tabs in UTF-16."""
    path.write_bytes(_lines(rows, "\t").encode("utf-16"))


def marked(path: Path, rows: Sequence[Row]) -> None:
    """Write CSV in UTF-8 with a mark at its start, and counts such as 2.0."""
    own = [{n: float(v) if isinstance(v, int) else v for n, v in row.items()} for row in rows]
    path.write_bytes(_lines(own, ",").encode("utf-8-sig"))


def windows(path: Path, rows: Sequence[Row]) -> None:
    r"""Write CSV with headings as people write them, and paths such as parts\a.stl."""
    own = [
        {_HEADINGS.get(name, name): value for name, value in row.items()}
        | {"File": str(row["file"]).replace("/", "\\")}
        for row in rows
    ]
    path.write_bytes(_lines(own, ",").encode("utf-8-sig"))


def json_list(path: Path, rows: Sequence[Row]) -> None:
    """Write JSON."""
    path.write_text(json.dumps({"parts": [dict(row) for row in rows]}))


def workbook(path: Path, rows: Sequence[Row]) -> None:
    """Write an Excel workbook."""
    from openpyxl import Workbook

    book = Workbook()
    sheet = book.active
    assert sheet is not None
    columns = _columns(rows)
    sheet.append(columns)
    for row in rows:
        sheet.append([row.get(name) for name in columns])
    book.save(path)


WRITERS: Mapping[str, tuple[str, Callable[[Path, Sequence[Row]], None]]] = {
    "CSV": (".csv", plain),
    "CSV, European": (".csv", german),
    "CSV, UTF-16": (".csv", unicode_text),
    "CSV, counts as 2.0": (".csv", marked),
    "CSV, Windows paths": (".csv", windows),
    "JSON": (".json", json_list),
    "Excel": (".xlsx", workbook),
}
"""The suffix and the writer of each kind of list."""
