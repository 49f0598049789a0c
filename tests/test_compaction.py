"""Compaction: drops and slides solved by hand, and no crossing items."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from packit_sim.box import Box
from packit_sim.cli.app import app
from packit_sim.core.errors import PackFormatError
from packit_sim.engine.collision_meshes import LooseMesh
from packit_sim.engine.compaction import GAP, Compacted, compact, drops
from packit_sim.engine.sweeping import surface
from packit_sim.game.datasets.pack_files import write_packs
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.shapes import Item
from tests.examples import examples
from tests.runs import rollout
from tests.zoo import BALL, BOWL, ZOO, cube_of, fill, random_item

NEAR = 2 * CONTACT_TOLERANCE
"""Box units: collision meshes are drawn in."""


def crossing(found: Compacted) -> list[tuple[int, int]]:
    """Pairs whose collision meshes cross where they ended."""
    meshes = []
    for placed, center in zip(found.placed, found.centers, strict=True):
        corners = surface(placed.item).triangles + center
        numbers = np.arange(3 * len(corners)).reshape(-1, 3)
        meshes.append(LooseMesh(corners.reshape(-1, 3), numbers))
    pairs = combinations(range(len(meshes)), 2)
    return [(i, j) for i, j in pairs if meshes[i].crosses(meshes[j])]


def test_a_stack_of_cubes_comes_down_to_the_corner() -> None:
    """Cubes of 10 cells, of which a step of the grid leaves 2 between each two."""
    box = Box()
    for level in range(3):
        box.place(cube_of(10), (1, 2, 1 + 3 * level))
    assert drops(box) == pytest.approx([0.04, 0.02, 0.02], abs=NEAR)
    found = compact(box)
    low = found.centers - 0.05
    assert low[:, 2] == pytest.approx([0, 0.1, 0.2], abs=3 * NEAR)
    assert low[:, :2] == pytest.approx(0, abs=NEAR)
    assert found.converged
    assert found.filled[1] == pytest.approx(1, abs=0.01) and found.filled[0] < 0.4
    assert found.height == pytest.approx((0.38, 0.3), abs=3 * NEAR)
    assert crossing(found) == []


def test_a_ball_comes_down_into_a_bowl() -> None:
    """Its lowest point to the bowl's, where the bounding boxes overlap by far."""
    bowl, ball = Item(BOWL, 1.0), Item(BALL, 0.02)
    box = Box()
    box.place(bowl, (0, 0, 0))
    middle = (np.array(bowl.cells) - ball.cells)[:2] // 8
    level = next(k for k in range(25) if box.is_feasible(ball, (*middle.tolist(), k)))
    box.place(ball, (*middle.tolist(), level + 3))
    assert drops(box)[1] > 0.12
    found = compact(box)
    assert crossing(found) == []
    assert found.centers[1, 2] < box.placed[1].center[2] - 0.12
    assert found.centers[1, 2] + GAP > ball.extents[2] / 2


def test_what_is_together_stays() -> None:
    box = Box()
    box.place(cube_of(20), (0, 0, 0))
    box.place(cube_of(20), (5, 0, 0))
    found = compact(box)
    assert np.abs(found.shifts).max() < NEAR
    assert (found.rounds, found.converged) == (1, True)
    empty = compact(Box())
    assert (empty.filled, empty.rounds, empty.converged) == ((0.0, 0.0), 0, True)


@examples(5)
@given(st.integers(0, 2**32 - 1))
def test_nothing_crosses_and_nothing_rises(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = Box((48, 48, 48))
    fill(box, [random_item(ZOO, 0.2, rng) for _ in range(6)], rng)
    found = compact(box)
    assert (found.shifts <= 1e-12).all()
    assert crossing(found) == []
    halves = np.array([placed.item.extents / 2 for placed in found.placed])
    assert (found.centers - halves > -1e-9).all()
    assert found.filled[1] >= found.filled[0] - 1e-9


def test_the_command_prints_the_regained_volume(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "settled.json"
    write_packs(tmp_path / "packs.jsonl", [rollout("a/b/c", 0, 10).pack])
    packs = str(tmp_path / "packs.jsonl")
    done = CliRunner().invoke(app, ["compact", packs, "--limit", "1", "--out", str(out)])
    assert done.exit_code == 0, done.output
    (row,) = json.loads(out.read_text())["each"]
    assert row["filled, pushed"] > row["filled"] and row["regained"] > 0
    assert row["mean drop"] > 0 and row["height, pushed"] <= row["height"]
    assert "regained" in done.output and "a/b/c" in done.output


def test_the_command_refuses_what_is_no_dataset() -> None:
    done = CliRunner().invoke(app, ["compact", "nowhere"])
    assert isinstance(done.exception, PackFormatError)
    assert "starter" in str(done.exception)
