"""Lists of parts as spreadsheets write them."""

from __future__ import annotations

import io
import sys
import zipfile
from pathlib import Path

import pytest
from trimesh import creation

from packit_sim.core.errors import ArgumentError
from packit_sim.core.extras import MissingPackageError
from packit_sim.parts.reading import tables
from packit_sim.parts.reading.files import Reading, find_parts

NAME = "Körper.stl"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "sub").mkdir()
    for name in (NAME, "sub/b.stl", "két\u0301.stl", "a,b;c.stl", "1.stl"):
        creation.box((30, 20, 10)).export(tmp_path / name)
    return tmp_path


def read(folder: Path, text: str, encoding: str = "utf-8", name: str = "list.csv") -> Reading:
    (folder / name).write_bytes(text.encode(encoding))
    return find_parts([folder / name])


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        (f"file,count\r\n{NAME},2\r\n", "utf-8-sig"),
        (f"file;count;density\r\n{NAME};2;7,8\r\n", "utf-8-sig"),
        (f"file,count\r\n{NAME},2\r\n", "cp1252"),
        (f"file\tcount\r\n{NAME}\t2\r\n", "utf-16"),
        (f"file\tcount\r\n{NAME}\t2\r\n", "utf-16-le"),
        (f"file\tcount\r\n{NAME}\t2\r\n", "utf-16-be"),
        (f"file,count,,\r\n{NAME},2,,\r\n,,,\r\n", "utf-8"),
        (f"File,Count,Comment\r\n{NAME},2,urgent\r\n", "utf-8"),
        ("file,count\r\nsub\\b.stl,2\r\n", "utf-8"),
        ("file,count\r\n.\\sub\\b.stl,2\r\n", "utf-8"),
        (f"file,quantity\r\n{NAME},2\r\n", "utf-8"),
        (f"file,count\r\n{NAME},2.0\r\n", "utf-8"),
        (f"Qty.; File Name ;max load [g]\r\n2,0;{NAME};1.000,5\r\n", "utf-8"),
        (f"sep=;\r\npath;pcs\r\n{NAME};2\r\n", "utf-8"),
        ("file,count\r\nke\u0301t\u0301.stl,2\r\n", "utf-8"),
        ('"file","count"\r\n"a,b;c.stl","2"\r\n', "utf-8"),
        ("file\r\na,b;c.stl\r\na,b;c.stl\r\n", "utf-8"),
    ],
)
def test_lists_are_read_as_programs_write_them(folder: Path, text: str, encoding: str) -> None:
    reading = read(folder, text, encoding)
    assert sum(part.count for part in reading.parts) == 2 and reading.unread == ()


@pytest.mark.parametrize(
    ("heading", "separator", "cell", "value"),
    [
        ("density", ";", "7,8", 7.8),
        ("density", ";", "1,500", 1.5),
        ("mass", ";", "1.234,5", 1234.5),
        ("mass", ";", "7.8", 7.8),
        ("mass", ";", "1.500", 1.5),
        ("mass", "\t", "0,25", 0.25),
        ("mass", ",", '"1,234.5"', 1234.5),
        ("mass", ",", '"1,234,567"', 1234567.0),
        ("mass", ",", '"7,8"', 7.8),
        ("mass", ",", "1 234", 1234.0),
        ("mass", ",", "1e2", 100.0),
        ("Mass (g)", ",", "2.5", 2.5),
    ],
)
def test_numbers_mean_what_they_say(
    folder: Path, heading: str, separator: str, cell: str, value: float
) -> None:
    (part,) = read(folder, f"file{separator}{heading}\n{NAME}{separator}{cell}\n").parts
    assert (part.density if heading == "density" else part.mass) == value


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (f'file,mass\n1.stl,2\n{NAME},"1,500"\n', "mass '1,500' is 1500 or 1.500"),
        (f"file\tmass\n1.stl\t2\n{NAME}\t1,500\n", "mass '1,500' is 1500 or 1.500"),
        (f"file;mass\n1.stl;2,5\n{NAME};1.500\n", "mass '1.500' is 1500 or 1,500"),
        (f"file,count\n1.stl,1\n{NAME},2.5\n", "count '2.5' is not a whole number"),
        (f"file,count\n1.stl,1\n{NAME},2_0\n", "count '2_0' is not a whole number"),
        (f"file,count\n1.stl,1\n{NAME},1,2\n", "'column 3, without a heading' is not known"),
        ("file,count\n1.stl,1\n,2\n", "it has no file"),
        (f"file,count\n1.stl,1\n{NAME},100000\n", "count 100000 is not possible"),
    ],
)
def test_a_row_that_cannot_be_read_is_named_and_the_others_are_packed(
    folder: Path, text: str, problem: str
) -> None:
    reading = read(folder, text)
    assert [part.name for part in reading.parts] == ["1"]
    (unread,) = reading.unread
    assert unread.source == "list.csv, row 3" and problem in unread.reason


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("file,cont\n1.stl,2\n", "column 'cont' is not known: is it 'count'"),
        ("file,Mass (kg)\n1.stl,2\n", r"column 'Mass \(kg\)': its unit must be g"),
        ("file,count,Qty\n1.stl,1,2\n", "two columns are the count, one of them 'Qty'"),
        ("1.stl,2\n", "its first row must name the columns .* and is '1.stl', '2'"),
        ("\n", "it has no parts"),
        ("", "it has no parts"),
        ("file,count\n", "it has no parts"),
        ("file\n" + "1.stl\n" * 100_001, "100,002 rows are too many"),
        ("file" + "," * 1001 + "\n1.stl\n", "more than 1,000 cells"),
    ],
)
def test_lists_without_a_meaning_are_refused(folder: Path, text: str, problem: str) -> None:
    with pytest.raises(ArgumentError, match=problem):
        read(folder, text)


def test_binary_files_are_no_lists(folder: Path) -> None:
    (folder / "list.csv").write_bytes(b"\x81\x8d\x8f")
    with pytest.raises(ArgumentError, match="not a text file in UTF-8, UTF-16 or cp1252"):
        find_parts([folder / "list.csv"])


def test_columns_of_no_use_and_guessed_encodings_are_noted(folder: Path) -> None:
    notes = read(folder, f"file,Comment\n{NAME},größer\n", "cp1252").notes
    assert "list.csv: column 'Comment' is not used" in notes
    assert any("read as cp1252" in note for note in notes)


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_long_lists_name_each_bad_row(folder: Path, count: int) -> None:
    rows = "".join(f"1.stl,{'x' if n % 5 == 0 else 1}\n" for n in range(count))
    reading = read(folder, f"file,count\n{rows}")
    assert len(reading.parts) == count * 4 // 5 and len(reading.unread) == count // 5
    assert reading.unread[-1].source == f"list.csv, row {count - 3}"


def workbook(folder: Path, *sheets: list[list[object]]) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for sheet, rows in zip(
        [book.active, *(book.create_sheet() for _ in sheets[1:])], sheets, strict=True
    ):
        for row in rows:
            sheet.append(row)
    book.save(folder / "list.xlsx")
    return folder / "list.xlsx"


def test_spreadsheets_are_read(folder: Path) -> None:
    pytest.importorskip("python_calamine")
    rows = [
        ["File", "Qty", "Density", "no_stack", "Name", None],
        [NAME, 2, 7.8, True, 7, None],
        [None] * 6,
        ["sub\\b.stl", "3", "7,8", "no", "b", None],
        [NAME, "many", None, None, None, None],
    ]
    reading = find_parts([workbook(folder, [], rows)])
    found = [(part.name, part.count, part.density, part.no_stack) for part in reading.parts]
    assert found == [("7", 2, 7.8, True), ("b", 3, 7.8, False)]
    assert reading.unread[0].source == "list.xlsx, row 5"
    assert any("sheet 'Sheet1' of 2 is read" in note for note in reading.notes)


def test_spreadsheets_that_are_broken_or_too_large_are_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("python_calamine")
    file = workbook(folder, [["file"], ["1.stl"]])
    content = file.read_bytes()
    for broken in (b"", b"PK", content[: len(content) // 2]):
        file.write_bytes(broken)
        with pytest.raises(ArgumentError, match=r"list\.xlsx: it is no \.xlsx file"):
            find_parts([file])
    with zipfile.ZipFile(buffer := io.BytesIO(), "w") as archive:
        archive.writestr("a.txt", "a")
    file.write_bytes(buffer.getvalue())
    with pytest.raises(ArgumentError, match=r"list\.xlsx: it can't be read as \.xlsx"):
        find_parts([file])
    file.write_bytes(content)
    monkeypatch.setattr(tables, "MAX_BYTES", len(content))
    with pytest.raises(ArgumentError, match="it unpacks to"):
        find_parts([file])


def test_a_small_spreadsheet_of_many_cells_is_refused(folder: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active["A1"] = "file"
    book.active["XFD1048576"] = 1
    book.save(folder / "list.xlsx")
    with pytest.raises(ArgumentError, match="17,179,869,184 cells are too many: at most 5,000,000"):
        find_parts([folder / "list.xlsx"])


def test_spreadsheets_need_an_extra(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    (folder / "list.xlsx").write_bytes(b"PK")
    with pytest.raises(MissingPackageError, match=r"packit-sim\[sheets\].*save the list as CSV"):
        find_parts([folder / "list.xlsx"])
