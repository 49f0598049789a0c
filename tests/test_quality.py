"""Quality scores of packs: a box with known scores, and the command that prints them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest
from typer.testing import CliRunner

from packit_sim import Pack, ShapeLibrary, write_packs
from packit_sim.box import Box
from packit_sim.cli.app import app
from packit_sim.game.datasets.packs import LibraryRef
from packit_sim.game.datasets.provenance import Other, Played
from packit_sim.geometry.shapes import Item
from packit_sim.physics.convex import disk_cache
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.quality import QualityScores, pack_quality
from packit_sim.physics.settings import PhysicsSettings
from tests.zoo import cube_of

HALVES = PhysicsSettings(decomposition=DecompositionSettings(method="bisection"))


@pytest.fixture(autouse=True)
def _store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path / "kept"))


def test_a_floating_cube_next_to_a_supported_one() -> None:
    """It falls by 0.12; both go straight up; pushed together they are twice as deep as wide."""
    box = Box((40, 40, 40))
    box.place(cube_of(12), (0, 0, 0))
    box.place(cube_of(12), (5, 5, 3))
    found = pack_quality(box, HALVES)
    assert found.floating == (1,)
    row = found.row()
    assert row["density"] == pytest.approx(2 * 0.12**3 / 0.4**3)
    assert (row["stable"], row["stable as packed"]) == (0.5, 0.5)
    assert (row["insertable"], row["from above"], row["removable"]) == (1.0, 1.0, 1.0)
    assert (row["interlocked"], row["floating"]) == (0, 1)
    assert row["filled, pushed"] > row["filled"]
    short = asdict(QualityScores.of(box, HALVES))
    assert short == {name: row[name] for name in ("stable", "insertable", "floating")}
    assert pack_quality(Box(), HALVES).row()["stable"] == 1.0


def test_the_command_judges_what_agents_packed(tmp_path: Path) -> None:
    library = ShapeLibrary.open("everyday")
    box = Box()
    for id in library.ids[:2]:
        box.fill(Item(library[id], 0.1))
    mine = Played(agent="mine", task=0, task_digest="", seed=0, total=0.75, end="no room")
    packs = [
        Pack.of(box, LibraryRef.of(library), mine),
        Pack.of(box, LibraryRef.of(library), Other(author="yours")),
    ]
    write_packs(tmp_path / "packs.jsonl", packs)
    out = tmp_path / "scores.json"
    arguments = ["score", str(tmp_path / "packs.jsonl"), "--decomposition", "bisection"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(out)])
    assert done.exit_code == 0, done.output
    mine, yours = json.loads(out.read_text())["each"]
    assert (mine["by"], mine["reward"], yours["by"]) == ("mine", 0.75, "yours")
    assert "reward" not in yours and mine["insertable"] == yours["insertable"] == 1.0
    assert 0 <= mine["stable"] <= 1 and mine["floating"] == []
    assert "insertable" in done.output and "mine" in done.output
