"""Films of packing: parts come in by moves that are checked, and end in their places."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from trimesh import creation

from packit_sim import PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError, RenderError
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.order import packing_order
from packit_sim.parts.packings.posed_parts import contents
from packit_sim.parts.results import film as film_module
from packit_sim.parts.results.film import film, film_packing
from packit_sim.render.layouts import Layout
from tests.packed_parts import cuboid, packed

QUICK = PackSettings(workers=1, iterations=20)

FLOOR = cuboid((0, 0, 0), (60, 60, 10))
BELOW = cuboid((70, 10, 0), (90, 30, 20))
ROOF = cuboid((0, 0, 30), (60, 60, 40))
INSIDE = cuboid((20, 20, 12), (40, 40, 28))


def layouts(path: Path, monkeypatch: pytest.MonkeyPatch, *arguments: Any) -> list[Layout]:
    """The places of all parts in each frame of a film."""
    found: list[Layout] = []

    def shot(box: Any, frames: Any, *size: int) -> Any:
        found.extend(layout for _, layout in frames)
        return [np.zeros((8, 8, 3), np.uint8)]

    monkeypatch.setattr(film_module.films, "shot", shot)
    film_packing(path, *arguments)
    return found


def test_parts_come_in_by_straight_moves_and_end_in_their_places(tmp_path, monkeypatch) -> None:
    packing = packed(FLOOR, BELOW, ROOF, INSIDE)
    fixed = Constraints(fixed=frozenset({2}))
    frames = layouts(tmp_path / "a.gif", monkeypatch, packing, fixed)
    order = packing_order(packing, fixed)
    first = frames[0].poses
    assert first[0] is not None and first[1] is not None  # fixed, and stuck below it
    assert first[3] is None
    end = contents(packing, range(4))
    by_name = {tuple(one.pose.translation.round(6)) for one in end.placed}
    assert {tuple(pose.translation.round(6)) for pose in frames[-1].poses if pose} == by_name
    assert order[:2] == (2, 0)
    for n in range(4):
        places = np.array([one.poses[n].translation for one in frames if one.poses[n] is not None])
        steps = np.abs(np.diff(places, axis=0))
        turned = (np.sort(steps, axis=1)[:, 1] > 1e-9).sum()
        assert turned <= 2  # only frames at a corner of the way move along two axes
        assert (places[0, 2] > 4) == (n >= 2)
    n = order.index(3)
    under = np.array([one.poses[n].translation for one in frames if one.poses[n] is not None])
    assert np.ptp(under[:, :2], axis=0).max() > 0.3  # the fixed roof is above it: from the side


def test_a_film_is_written(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(film_module, "SIZE", (120, 90))
    monkeypatch.setattr(film_module, "FPS", 10)
    parts = [Part("cube", creation.box((6, 6, 6)))]
    found = pack(parts, (20, 10, 15), settings=QUICK)
    file = film(found, tmp_path / "packing.gif")
    with Image.open(file) as written:
        assert written.size == film_module.SIZE and written.n_frames > 5
        written.seek(written.n_frames - 1)
        assert len(np.unique(np.asarray(written.convert("RGB").reduce(8)))) > 5
    with pytest.raises(RenderError, match=r"packing\.txt is no film"):
        film(found, tmp_path / "packing.txt")
    with pytest.raises(ArgumentError, match="one box"):
        film_packing(tmp_path / "a.gif", packed())
