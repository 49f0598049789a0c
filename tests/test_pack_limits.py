"""Meshes that would take too much memory are refused before the search, in one line."""

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim import PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.filling import preparation
from packit_sim.parts.reading import prepared

CUBE = creation.box((10, 10, 10))
BALL = creation.icosphere(subdivisions=1, radius=5)
SETTINGS = PackSettings(workers=1, iterations=1)


def test_a_mesh_of_five_million_triangles_is_named_and_the_others_are_packed() -> None:
    faces = np.zeros((5_000_000, 3), dtype=np.int64)
    large = Part("scan", trimesh.Trimesh(CUBE.vertices, faces, process=False), count=2)
    packed = pack([large, Part("cube", CUBE)], "20x20x20mm", settings=SETTINGS)
    assert packed.count == 1
    (unread,) = packed.unread
    assert unread.source == "scan"
    assert "5,000,000 triangles are too many to pack: at most 2,000,000" in unread.reason


def test_the_triangles_of_all_parts_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = [Part(f"ball {n}", BALL, count=100) for n in range(10)]
    monkeypatch.setattr(preparation, "MAX_TRIANGLES", 10 * len(BALL.faces))
    assert preparation.prepared_task(parts, "90x90x90mm", "volume", SETTINGS).parts
    with pytest.raises(ArgumentError, match="11 parts have 812 triangles: at most 800 together"):
        pack([*parts, Part("cube", CUBE)], "90x90x90mm", settings=SETTINGS)


def test_each_part_is_limited_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prepared, "MAX_TRIANGLES", len(BALL.faces) - 1)
    with pytest.raises(ArgumentError, match="ball: 80 triangles are too many to pack: at most 79"):
        pack([Part("ball", BALL)], "20x20x20mm", settings=SETTINGS)
