"""Readers of user-supplied parts: manifests, records of packings, and workbench jobs."""

from __future__ import annotations

import io
import json
from functools import cache
from typing import TYPE_CHECKING

from msgspec import structs
from openpyxl import Workbook
from trimesh import creation

from campaigns.fuzzing import file_changes, world
from campaigns.fuzzing.json_changes import json_tree
from campaigns.fuzzing.reader import Reader
from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError
from packit_sim.core.plain_text import plain_line
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.pack import pack
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results.check import check
from packit_sim.parts.results.record import RECORD, write_record
from packit_sim.parts.results.resuming import read_earlier
from packit_sim.parts.workbench.jobs import PackingJob, read_job

if TYPE_CHECKING:
    from packit_sim.parts.filling.packed import PackedParts

_ROWS = (
    {"file": "box.stl", "count": 2, "value": 1.5, "rotations": "yaw-4", "priority": 1, "mass": 20},
    {"file": "box.stl", "name": "lid", "density": 7.8, "no_stack": "yes", "max_load": 0},
    {"file": "../parts/box.stl", "unit": "in", "count": 0},
    {"file": "box.stl", "stop": 2, "group": "A", "clearance": "1mm", "max_tilt": 15, "down": "z-"},
)


def _manifests() -> list[bytes]:
    return [json.dumps(each).encode() for each in (_ROWS, {"parts": _ROWS})]


def _tables() -> list[bytes]:
    names = list(dict.fromkeys(name for row in _ROWS for name in row))
    rows = [names, *([str(row.get(name, "")) for name in names] for row in _ROWS)]
    texts = ["\r\n".join(separator.join(row) for row in rows) for separator in ",;\t"]
    texts.append("sep=;\nFile Name;Qty;Mass (g);Comment;\nbox.stl;2,0;1.234,5;größer;\n")
    return [
        text.encode(encoding) for text in texts for encoding in ("utf-8-sig", "utf-16", "cp1252")
    ]


def _sheets() -> list[bytes]:
    """Return the tables as small workbooks, with cells of several types."""
    names = list(dict.fromkeys(name for row in _ROWS for name in row))
    book = Workbook()
    for row in [names, *([row.get(name) for name in names] for row in _ROWS)]:
        book.active.append(row)
    book.save(file := io.BytesIO())
    return [file.getvalue()]


def _read_manifest(suffix: str, data: bytes) -> None:
    world.written("parts/box.stl", world.exported(creation.box((1, 2, 3)), "stl"))
    found = find_parts([world.written(f"parts/manifest{suffix}", data)])
    for part in found.parts:
        assert plain_line(part.name) == part.name
        part.digest.encode()
        assert "/" not in part.file_name and len(part.file_name.encode()) < 200
    for unread in found.unread:
        str(unread).encode("utf-8", "surrogatepass")


@cache
def _packed() -> PackedParts:
    parts = [Part(f"cube {n}", creation.box((n, n, n)), count=2) for n in (2, 3)]
    settings = PackSettings(workers=1, iterations=50)
    return pack(parts, (9.0, 8.0, 7.0), settings=settings)


def _records() -> list[bytes]:
    packed = _packed()
    folder = world.folder() / "record-seed"
    write_record(packed, check(packed), folder, {})
    data = (folder / RECORD).read_bytes()
    return [data.replace(packed.task.digest.encode(), world.COMPUTED)]


def _read_record(data: bytes) -> None:
    task = _packed().task
    forged = data.replace(world.COMPUTED, task.digest.encode())
    read_earlier(world.written(f"record/{RECORD}", forged).parent, task)
    write_record(_packed(), check(_packed()), world.folder() / "record", {})


def _orders() -> list[bytes]:
    files = [{"number": 1, "count": 2, "rotations": "cube", "fields": {"mass": "3"}}]
    box = [{"size": "30 x 2.5e1x.2in", "name": "A", "count": 2}, {"size": "cylinder:3x4in"}]
    order = {"box": box, "unit": "mm", "files": files, "clearance": "0.5mm", "clearance_z": "0.1"}
    order |= {"wall_clearance": "sides=1mm,top=1mm", "max_mass": ["2kg"], "max_parts": ["A:3"]}
    return [json.dumps(order | {"seconds": 1.5, "seed": 3, "instructions": True}).encode()]


def _read_order(data: bytes) -> None:
    order = typed_json.decode(data, PackingJob, ArgumentError, "the request")
    read_job(structs.replace(order, files=[]), {}).boxes(order.objective)


READERS = (
    Reader(
        "parts-json",
        "manifests of parts: JSON",
        _manifests,
        lambda data: _read_manifest(".json", data),
        json_tree,
    ),
    Reader(
        "parts-csv",
        "manifests of parts: CSV",
        _tables,
        lambda data: _read_manifest(".csv", data),
        file_changes.tokens,
    ),
    Reader(
        "parts-xlsx",
        "manifests of parts: XLSX",
        _sheets,
        lambda data: _read_manifest(".xlsx", data),
        file_changes.archive(file_changes.tokens),
    ),
    Reader("records", "packings that a search resumes", _records, _read_record, json_tree),
    Reader("orders", "orders of the workbench", _orders, _read_order, json_tree),
)
"""The readers of this module."""
