"""`packit selftest`: totals add up; planted defects are found, reduced and replayed."""

import json
from pathlib import Path

import numpy as np
import pytest
from trimesh import creation

from campaigns import exactness
from campaigns.common import table_in_page
from packit_sim import placement
from packit_sim.box import Box
from packit_sim.core.parallel import Workers
from packit_sim.engine import collision, nofit, oracle
from packit_sim.engine.collision_meshes import collision_mesh
from packit_sim.engine.feasibility import Blockers
from packit_sim.engine.occupancy import Occupancy
from packit_sim.engine.pairs import Pair
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.shapes import Item
from packit_sim.selftest import case_runs
from packit_sim.selftest.cases import Case, draw_case
from packit_sim.selftest.comparisons import CHECKS, differences
from packit_sim.selftest.kinds import KINDS
from packit_sim.selftest.reduction import reduced
from packit_sim.selftest.replays import read_replay, replay_text
from packit_sim.selftest.tally import Tally
from packit_sim.selftest.totals import SelftestError, Totals
from tests.runs import run_packit as packit
from tests.zoo import PLATE, RING, TILTED, item_of

CELLS = (24, 24, 24)

CONTACTS = 3
"""The number of a case of small meshes."""


def small(**rules: bool) -> Case:
    """A ring, a plate and a cube in a small box, and another cube to place."""
    placed = (
        PlacedItem(Item(RING, 0.002, 5), (0, 0, 3)),
        PlacedItem(Item(PLATE, 0.0006), (3, 3, 0)),
        PlacedItem(Item(TILTED, 0.0003, 2), (0, 4, 4)),
    )
    return Case(CELLS, placed, Item(TILTED, 0.0006, 1), (8, 1), **rules)


def nested(**rules: bool) -> Case:
    """A sheet that may be inside a thicker one."""
    plate = item_of(creation.box((0.15, 0.1, 0.0045)))
    sheet = item_of(creation.box((0.05, 0.04, 0.0015)))
    return Case(CELLS, (PlacedItem(plate, (1, 1, 1)),), sheet, (0, 0), **rules)


def totals_at(file: Path, number: int) -> Path:
    """A file of totals whose next case with seed 7 is this one."""
    Totals.begin(None, True).write(file)
    file.write_text(json.dumps({**json.loads(file.read_text()), "seeds": {"7": number}}))
    return file


@pytest.mark.parametrize(
    "case", [small(kinematic=True), small(easy=True), nested(easy=True, kinematic=True)]
)
def test_all_checks_agree(case) -> None:
    tally = Tally()
    for name in CHECKS:
        assert differences(case, name, tally) == []
    assert tally.counts["locations"] == 216 * (1 + 24 * case.easy)
    assert {"cold", "warm", "tables", "restored", "BLBF", "why not", "table offsets"} <= set(
        tally.counts
    )


def test_cases_are_drawn_from_seed_and_number() -> None:
    one, same, other = (draw_case(7, number) for number in (CONTACTS, CONTACTS, CONTACTS + 6))
    assert (one.cells, one.placed, one.item) == (same.cells, same.placed, same.item)
    assert one.item != other.item
    assert len(one.placed) > 5


def test_a_planted_defect_is_found_reduced_and_replayed(monkeypatch, tmp_path) -> None:
    """An engine that is wrong at one location, as soon as a mask is half full."""
    real = placement.feasible

    def wrong(occupancy, item):
        mask = real(occupancy, item)
        locations = np.argwhere(mask)
        if len(occupancy.placed) > 1 and len(locations) > 10:
            mask[tuple(locations[len(locations) // 2])] = False
        return mask

    monkeypatch.setattr(case_runs, "draw_case", lambda *_: small(easy=True))
    monkeypatch.setattr(case_runs, "reduced", lambda case, name: reduced(case, name, 2.0))
    file = totals_at(tmp_path / "totals.json", CONTACTS)
    with monkeypatch.context() as patch:
        patch.setattr(placement, "feasible", wrong)
        result = packit("selftest", "--minutes", 0.01, "--seed", 7, "--out", file)
        assert result.returncode == 1
        replay = tmp_path / f"selftest-7-{CONTACTS}.json"
        assert f"--replay {replay.name}" in result.stdout
        again = packit("selftest", "--replay", replay)
        assert again.returncode == 1 and "cold: 1 locations" in again.stdout
    check, case = read_replay(replay)
    assert check == "masks" and len(case.placed) == 2
    assert len(case.item.shape.mesh.faces) < 12
    assert len(replay.read_text()) < 3000
    totals = Totals.read(file)
    assert {found.check for found in totals.differences} >= {"cold", "warm", "tables"}
    assert totals.differences[0].number == CONTACTS and totals.differences[0].replay == replay.name
    fixed = packit("selftest", "--replay", replay)
    assert fixed.returncode == 0 and "0 differences" in fixed.stdout


def _no_items(occupancy, candidate):
    return Blockers((), ())


def _all(placed, item, mask):
    return mask


def _none(placed, item, mask):
    return mask & False


@pytest.mark.parametrize(
    ("where", "name", "planted", "case", "check", "found"),
    [
        (Box, "blbf", lambda *_: None, small(), "blbf", "BLBF"),
        (placement, "blockers", _no_items, small(), "blockers", "why not"),
        (nofit.NoFit, "conflict", lambda *_: False, small(), "table", "table offsets"),
        (nofit, "_table", lambda *_: 1 / 0, small(), "masks", "masks"),
        (Box, "feasible_in_any", Box.feasible, small(easy=True), "rotations", "union"),
        (Occupancy, "truncate", lambda *_: None, small(), "history", "restored"),
        (placement, "insertable_mask", _all, small(kinematic=True), "kinematic", "ways up"),
        (placement, "insertable_mask", _none, small(kinematic=True), "kinematic", "clear"),
    ],
)
def test_each_check_finds_what_it_is_for(
    monkeypatch, where, name, planted, case, check, found
) -> None:
    assert differences(case, check) == []
    monkeypatch.setattr(where, name, planted)
    assert found in {difference.check for difference in differences(case, check)}


def test_boolean_volumes_find_what_engine_and_oracle_both_miss(monkeypatch) -> None:
    def crossing_alone(a, b, offsets):
        pairs = [Pair.at_offset(a, b, tuple(offset)) for offset in offsets.tolist()]
        mesh, other = collision_mesh(a), collision_mesh(b)
        return np.array([mesh.crosses(other, pair) for pair in pairs])

    monkeypatch.setattr(collision, "conflicts_at", crossing_alone)
    monkeypatch.setattr(oracle, "contains", lambda *_: False)
    case = nested()
    assert differences(case, "masks") == []
    assert {found.check for found in differences(case, "volumes")} == {"shared volumes"}


def test_a_run_adds_to_the_totals_of_the_last_one(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(case_runs, "draw_case", lambda *_: small())
    file = totals_at(tmp_path / "totals.json", CONTACTS)
    for cases in (1, 2):
        with Workers(1) as workers:
            *_, totals = case_runs.run(7, 1e-4, workers, file)
        assert totals.count("cases") == cases
        assert totals == Totals.read(file)
        assert totals.seeds == {"7": CONTACTS + cases}
    assert totals.count("locations") == 2 * 216 and totals.differences == []
    assert totals.seconds > 0 and all(kind.core_seconds > 0 for kind in totals.kinds.values())


def test_a_run_that_is_stopped_keeps_what_was_done(monkeypatch, tmp_path) -> None:
    file = totals_at(tmp_path / "totals.json", CONTACTS)

    def drawn(seed, number):
        if number > CONTACTS:
            raise KeyboardInterrupt
        return small()

    monkeypatch.setattr(case_runs, "draw_case", drawn)
    result = packit("selftest", "--minutes", 1, "--seed", 7, "--out", file)
    assert result.returncode == 130
    assert "stopped: repeat the command to resume" in result.stdout
    assert Totals.read(file).count("cases") == 1


def test_a_failure_while_a_box_is_filled_is_a_difference(monkeypatch) -> None:
    monkeypatch.setattr(Box, "place", lambda *_: 1 / 0)
    outcome = case_runs.run_case(7, CONTACTS)
    assert [found.check for found in outcome.differences] == ["filling"]
    assert outcome.replay is None and outcome.counts == {"cases": 1}


def test_without_manifold3d_volumes_are_left_out(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr("packit_sim.selftest.volumes.is_available", lambda: False)
    monkeypatch.setattr(case_runs, "run", lambda *_: iter(()))
    result = packit("selftest", "--minutes", 0.01)
    assert result.returncode == 0
    assert "boolean volumes are left out: pip install manifold3d" in result.stdout
    tally = Tally()
    assert differences(nested(), "volumes", tally) == [] and not tally.counts
    file = totals_at(tmp_path / "totals.json", 0)
    with pytest.raises(SelftestError, match="volumes"):
        Totals.begin(file, False)


def test_a_replay_is_the_same_case(tmp_path) -> None:
    case = small(kinematic=True)
    file = tmp_path / "replay.json"
    file.write_text(replay_text("kinematic", case))
    check, again = read_replay(file)
    assert check == "kinematic" and replay_text(check, again) == file.read_text()
    assert (again.cells, again.placed, again.item) == (case.cells, case.placed, case.item)
    assert (again.truth == case.truth).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"check": "luck"}, "no check 'luck': choose from masks"),
        ({"cells": [24, 24, 23]}, "box of 24 x 24 x 23 cells is not possible"),
        ({"seed": [-1]}, r"seed \[-1\] is not possible"),
        ({"item": {"shape": 7, "scale": 1, "rotation": 0}}, "there is no shape 7"),
        ({"item": {"shape": 0, "scale": -1, "rotation": 0}}, "scale -1.0 is not possible"),
        ({"item": {"shape": 0, "scale": 1, "rotation": 24}}, "rotation 24 is not one of"),
        (
            {"placed": [{"shape": 0, "scale": 9, "rotation": 0, "location": [0, 0, 0]}]},
            "not inside",
        ),
        ({"placed": [{"shape": 0, "scale": 1, "rotation": 0}]}, "location None is not possible"),
        ({"shapes": [{"id": "a", "vertices": [[0, 0, 0]], "faces": [[0, 0, 1]]}]}, "has no tri"),
        ({"shapes": [{"id": "a", "vertices": [[9, 0, 0]], "faces": [[0, 0, 0]]}]}, "not centred"),
        (
            {"shapes": [{"id": "a", "vertices": [[0, 0, 0]], "faces": [[0, 0, 10**30]]}]},
            "has no tri",
        ),
        (
            {"shapes": [{"id": "a", "vertices": [[1e308, 0, 0]], "faces": [[0, 0, 0]]}]},
            "not centred",
        ),
        ({"shapes": 3}, "field 'shapes' is 3"),
    ],
)
def test_a_file_that_is_no_replay_is_refused(tmp_path, changes, message) -> None:
    file = tmp_path / "replay.json"
    file.write_text(json.dumps(json.loads(replay_text("masks", small())) | changes))
    with pytest.raises(SelftestError, match=message):
        read_replay(file)
    assert packit("selftest", "--replay", file).returncode == 2


def test_totals_of_another_version_or_no_totals_are_refused(tmp_path) -> None:
    file = totals_at(tmp_path / "totals.json", 0)
    file.write_text(file.read_text().replace('"version": "', '"version": "9.'))
    result = packit("selftest", "--minutes", 0.01, "--out", file)
    assert result.returncode == 2 and "choose another --out" in result.stderr
    file.write_text("[]")
    with pytest.raises(SelftestError, match="the totals must be a JSON object"):
        Totals.read(file)


def test_the_page_has_the_totals_of_the_runs() -> None:
    totals = Totals.read(exactness.FILE)
    assert table_in_page("exactness") == exactness.tables(totals)
    names = {name for kind in totals.kinds.values() for name in kind.counts}
    assert exactness.COMPARISONS.keys() <= names
    assert totals.kinds.keys() == exactness.ITEMS.keys() == KINDS.keys()
