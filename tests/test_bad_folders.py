"""Folders of broken files and strange names: each is packed, or named with its reason."""

from __future__ import annotations

import importlib.util
import json
import os
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim.core.plain_text import plain
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.pack import pack
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.results import exports
from packit_sim.parts.results.check import check
from packit_sim.parts.results.exports import export
from packit_sim.parts.results.summary import table

BLOCK = creation.box((30, 20, 10))

NAMES = (
    *("Körper groß.stl", "carré.stl", "部品.stl", "деталь 1.stl", "part=2.stl", "a,b;c.stl"),
    *('it\'s "q".stl', "<b>&amp;.stl", "-dash.stl", "UPPER.STL", "két\u0301.stl", "🔧.stl"),
    *("[red].stl", "x*20 (2).stl"),
)


def stl(file: Path, triangles: Sequence[object] | np.ndarray, count: int | None = None) -> None:
    corners = np.asarray(triangles, np.float32).reshape(-1, 9)
    rows = b"".join(b"\0" * 12 + row.tobytes() + b"\0\0" for row in corners)
    header = b"x" * 80 + struct.pack("<I", len(corners) if count is None else count)
    file.write_bytes(header + rows)


def _changed(place: tuple[int, ...], value: object) -> np.ndarray:
    triangles = BLOCK.triangles.copy()
    triangles[place] = value
    return triangles


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    t = BLOCK.triangles
    mixed = t.copy()
    mixed[::2] = mixed[::2, ::-1]
    nothing = np.repeat(t[:6, :1], 3, axis=1)
    BLOCK.export(tmp_path / "good.stl")
    stl(tmp_path / "nan_vertex.stl", _changed((3, 1, 2), np.nan))
    stl(tmp_path / "garbage_1e31.stl", _changed((3, 1), (1.5e31, 2.9e25, -1.1e23)))
    stl(tmp_path / "inf.stl", _changed((3, 1, 0), np.inf))
    stl(tmp_path / "inverted.stl", t[:, ::-1])
    stl(tmp_path / "mixed_winding.stl", mixed)
    stl(tmp_path / "empty_84_bytes.stl", np.zeros((0, 3, 3)))
    (tmp_path / "zero_bytes.stl").touch()
    stl(tmp_path / "truncated.stl", t, count=500)
    stl(tmp_path / "degenerate_only.stl", nothing)
    stl(tmp_path / "with_degenerate.stl", np.concatenate([t, nothing]))
    stl(tmp_path / "doubled.stl", np.concatenate([t, t]))
    stl(tmp_path / "flat_sheet.stl", [[(0, 0, 0), (40, 0, 0), (40, 30, 0)]])
    stl(tmp_path / "far_from_origin.stl", t + np.array([4.5e6, 5.4e6, 300.0]))
    balls = [creation.icosphere(radius=5), creation.icosphere(radius=5)]
    balls[1].apply_translation((60, 0, 0))
    trimesh.util.concatenate(balls).export(tmp_path / "two_bodies.stl")
    (tmp_path / "text.stl").write_text("this is not a mesh\n")
    (tmp_path / "part.step").write_text(
        "ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n"
    )
    return tmp_path


REASONS = {
    "nan_vertex.stl": "not finite",
    "garbage_1e31.stl": "next to its largest coordinate, 1.5e+31",
    "inf.stl": "not finite",
    "empty_84_bytes.stl": "no triangles",
    "zero_bytes.stl": "the file is empty",
    "truncated.stl": "not the length of a binary STL",
    "degenerate_only.stl": "no extent|none of its",
    "flat_sheet.stl": "no extent along z",
    "text.stl": "not ASCII",
    "part.step": "no valid STEP file|cascadio",
}
"""The files that have no meaning, and words of the reason of each, one of which it has."""


def named(task: PackTask) -> dict[str, str]:
    reasons = {Path(each.source).name: each.reason for each in task.unread}
    too_large = {f"{task.parts[n].part.name}.stl": reason for n, reason in task.too_large.items()}
    return reasons | too_large


def test_every_broken_file_is_named_and_the_others_are_packed(folder: Path) -> None:
    task = prepared_task([folder], "300x200x150mm", "volume", PackSettings())
    found = named(task)
    assert set(found) == set(REASONS)
    for name, reason in found.items():
        assert any(word in reason for word in REASONS[name].split("|")), name
    fitting = {p.part.name: p for n, p in enumerate(task.parts) if n not in task.too_large}
    for name in ("good", "inverted", "with_degenerate", "far_from_origin"):
        assert fitting[name].volume == pytest.approx(6000, rel=1e-3), name


@pytest.mark.parametrize("count", [10, 100])
def test_many_broken_files_are_named(tmp_path: Path, count: int) -> None:
    BLOCK.export(tmp_path / "good.stl")
    for n in range(count):
        (tmp_path / f"{n}.stl").write_text("solid nothing")
    reading = find_parts([tmp_path])
    assert [part.name for part in reading.parts] == ["good"]
    assert {Path(each.source).name for each in reading.unread} == {f"{n}.stl" for n in range(count)}


def test_files_of_any_name_are_found_and_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
    folder = tmp_path / "parts"
    folder.mkdir()
    for name in NAMES:
        BLOCK.export(folder / name, file_type="stl")
    stems = sorted(name.rpartition(".")[0] for name in NAMES)
    assert sorted(part.name for part in find_parts([folder]).parts) == stems
    each = [f"{folder}/{name}" for name in NAMES]  # one of them has "=", two look like patterns
    assert sorted(part.name for part in find_parts(each).parts) == stems
    (found,) = find_parts([f"{folder}/[red].stl=3"]).parts
    assert (found.name, found.count) == ("[red]", 3)
    settings = PackSettings(workers=1, iterations=5)
    packed = pack([folder], "300x200x150mm", settings=settings)
    assert packed.count == len(NAMES) and check(packed).problems == ()
    text = table(packed)
    assert all(stem in text for stem in stems)
    export(packed, tmp_path / "out")
    record = json.loads((tmp_path / "out" / "packing.json").read_text(encoding="utf-8"))
    assert sorted(item["name"] for item in record["items"]) == stems
    page = (tmp_path / "out" / "packing.html").read_text(encoding="utf-8")
    assert "<b>&amp;<" not in page and "&lt;b&gt;&amp;amp;" in page
    assert all(stem in page for stem in stems if not set(stem) & set("<>&'\""))


@pytest.mark.skipif(importlib.util.find_spec("cascadio") is None, reason="without the extra cad")
def test_step_files_of_any_name_are_read(tmp_path: Path) -> None:
    from tests import step_files

    for name in ("Körper [1]", "деталь", "🔧", "it's"):
        file = tmp_path / f"{name}.step"
        file.write_text(step_files.box((3, 2, 1), name=name))
        (part,) = find_parts([file]).parts
        assert part.name == plain(name) and os.path.exists(file)
