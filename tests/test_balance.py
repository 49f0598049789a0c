"""The balance of boxes: the search keeps it, the record has it, and the check recomputes it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from trimesh import creation

from packit_sim import (
    BoxContainer,
    BoxType,
    ItemType,
    Limits,
    PackSettings,
    Part,
    WallClearance,
    pack,
)
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.motions import Motion
from packit_sim.parts import summary
from packit_sim.parts.filling.balance import nest_balance, off_middle
from packit_sim.parts.filling.candidates import candidate
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.nesting.balance import excess
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.limits import read_limits
from packit_sim.parts.results import exports
from packit_sim.parts.results.verification import verify_record

QUICK = PackSettings(workers=1, iterations=20)


def cube(name: str, side: float = 10.0, **settings) -> Part:
    return Part(name, creation.box((side, side, side)), rotations="fixed", **settings)


def balanced(share: float, size=(60, 60, 20)) -> BoxType:
    return BoxType(size, limits=Limits(balance=share))


def off(packed) -> float:
    return max(np.abs(off_middle(packed.task, each)).max() for each in packed.packings)


def test_few_parts_stand_around_the_middle() -> None:
    parts = [cube("a", count=2, mass=10), cube("b", 15, mass=100)]
    plain = pack(parts, (60, 60, 20), settings=QUICK)
    packed = pack(parts, balanced(0.02), settings=QUICK)
    assert packed.count == plain.count == 3
    assert off(plain) > 0.1
    assert off(packed) <= 0.02
    assert summary(packed)["limits"].endswith("% of 2% off the middle")


def test_parts_that_fill_a_box_exchange_places() -> None:
    """Four blocks fill the box: only heavy ones in opposite corners balance it."""
    block = creation.box((20, 20, 10))
    parts = [
        Part("heavy", block, 2, rotations="fixed", mass=100),
        Part("light", block, 2, rotations="fixed", mass=1),
    ]
    packed = pack(parts, balanced(0.05, (41, 41, 11)), settings=replace(QUICK, iterations=100))
    assert packed.count == 4
    assert off(packed) <= 0.05


def test_around_a_volume_that_stays_free() -> None:
    free = Part("free", creation.box(bounds=((0, 0, 0), (10, 10, 20))))
    settings = replace(QUICK, keep_out=[free])
    parts = [cube("a", count=3, mass=10), cube("b", count=2, mass=30)]
    packed = pack(parts, balanced(0.03, (40, 40, 12)), settings=settings)
    assert packed.count == 5
    assert off(packed) <= 0.03


def test_without_masses_volumes_count() -> None:
    parts = [cube("a", count=2), cube("b", 15)]
    assert off(pack(parts, balanced(0.02), settings=QUICK)) <= 0.02
    with pytest.raises(ArgumentError, match="by mass, since other parts have one, needs masses"):
        pack([cube("a", mass=1), cube("b")], balanced(0.02), settings=QUICK)


def test_parts_that_break_it_are_left_out_with_the_reason() -> None:
    """They reach from wall to wall, so that moving them together is no way."""
    task = pack([cube("a", count=3)], balanced(0.05), settings=QUICK).task
    poses = [Motion.shift(place) for place in ((5, 30, 5), (15, 30, 5), (55, 30, 5))]
    container = task.container(task.boxes[0])
    found = candidate(task, [task.packing(container, [Placement(0, pose) for pose in poses])])
    assert found.count == 2
    assert "of the sides off the middle: at most 5%" in found.rejected[0][1]


def test_what_is_left_out_is_worth_least_for_what_it_gains() -> None:
    centres = np.array(((0.3, 0.0), (0.3, 0.0), (-0.1, 0.0)))
    goes = excess(np.ones(3), centres, np.array((5.0, 2.0, 1.0)), np.full(2, 0.1))
    assert goes.tolist() == [1]
    assert excess(np.ones(1), centres[:1], np.ones(1), np.full(2, 0.1)).tolist() == [0]


def test_a_record_that_breaks_its_balance_is_not_valid(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))
    parts = [cube("a", count=2, mass=10), cube("b", 15, mass=100)]
    pack(parts, balanced(0.1), settings=QUICK, out=tmp_path)
    file = tmp_path / "packing.json"
    assert not verify_record(file).problems
    record = json.loads(file.read_text())
    record["request"]["boxes"][0]["balance"] = 0.001
    file.write_text(json.dumps(record))
    (problem,) = verify_record(file).problems
    assert "of the sides off the middle: at most 0.1%" in problem.sentence


def test_the_reach_is_a_share_of_the_whole_box_also_with_clearances_of_walls() -> None:
    settings = PackSettings(wall_clearance=WallClearance(4, floor=1, top=0))
    task = prepared_task([cube("a")], [balanced(0.1, (60, 40, 20))], "volume", settings)
    inner = BoxContainer((60 - 8, 40 - 8, 20 - 1))
    found = nest_balance(task, Limits(balance=0.1), [0], inner)
    assert found is not None
    assert found.reach == pytest.approx((6, 4), rel=1e-3)


@pytest.mark.parametrize(("has_obstacle", "count"), [(False, 1), (True, 0)])
def test_the_balance_is_kept_after_parts_of_other_groups_are_left_out(
    has_obstacle: bool, count: int
) -> None:
    """One of two blocks is left out; the other moves to the middle of a box with nothing else."""
    parts = [cube("a", group="a"), cube("b", group="b")]
    task = pack(parts, balanced(0.02), settings=replace(QUICK, groups=("apart",))).task
    container = task.container(task.boxes[0])
    if has_obstacle:
        post = creation.box(bounds=((0, 0, 0), (5, 5, 5)))
        container = container.with_obstacles([ItemType("post", post.vertices, post.faces)])
    poses = [Motion.shift((25, 25, 5)), Motion.shift((35, 35, 5))]
    both = task.packing(container, [Placement(n, pose) for n, pose in enumerate(poses)])
    assert not both.problems()
    found = candidate(task, [both])
    assert found.count == count
    assert count == 0 or off(found) <= 0.02


def test_texts_of_a_balance() -> None:
    assert read_limits([], ["3"], ["10%", "A:2.5%"]) == {
        "": Limits(max_parts=3, balance=0.1),
        "A": Limits(balance=0.025),
    }
    for wrong, said in (("10", "is not a share of a side, such as 10%"), ("60%", "0.001 to 0.5")):
        with pytest.raises(ArgumentError, match=said):
            read_limits([], [], [wrong])
    with pytest.raises(ArgumentError, match="balance nan is not possible"):
        Limits(balance=math.nan)
