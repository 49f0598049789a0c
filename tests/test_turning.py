"""Limits on turning: how far parts lean, and which of their sides may face down."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trimesh import creation

from campaigns.forgeries.judge import Judge
from packit_sim import ItemType, NestSettings, PackSettings, Part, Turning, nest, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.packings.rotation_sets import matrices
from packit_sim.parts.packings.turning import SIDES
from packit_sim.parts.reading.files import ReadSettings, find_parts
from packit_sim.parts.results import exports
from packit_sim.parts.results.resuming import items_of, resumed
from packit_sim.parts.results.verification import verify_record

QUICK = PackSettings(workers=1, iterations=1)


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))


def block(sides, **settings) -> Part:
    return Part("block", creation.box(sides), **settings)


def leans(pose) -> float:
    """Degrees between the z axes of a part's file and of its box."""
    return math.degrees(math.atan2(np.linalg.norm(pose[:2, 2]), pose[2, 2]))


def lowest(pose) -> list[str]:
    """The sides that face down, by the heights of points out of them."""
    points = {f"{a}{s}": float(s + "1") * np.eye(3)[n] for n, a in enumerate("xyz") for s in "-+"}
    heights = {side: float((pose[:3, :3] @ point)[2]) for side, point in points.items()}
    return [side for side, z in heights.items() if z <= min(heights.values()) + 1e-6]


@pytest.mark.parametrize(
    ("limits", "count"),
    [
        ({}, 24),
        ({"max_tilt": 0}, 4),
        ({"max_tilt": 90}, 20),
        ({"down": ("z-", "z+")}, 8),
        ({"down": ("x+",)}, 4),
        ({"max_tilt": 90, "down": ("x+", "z+")}, 4),
    ],
)
def test_limits_allow_some_of_the_24_rotations(limits, count: int) -> None:
    own = Turning(**limits)
    turns = matrices("cube")
    kept = own.allows(turns)
    assert kept.sum() == count
    for turn, is_kept in zip(turns, kept, strict=True):
        is_low = leans(turn) <= own.max_tilt + 1e-9
        assert is_kept == (is_low and bool(set(lowest(turn)) & set(own.down)))
        assert (own.fault(turn) is None) == is_kept


def test_any_angle_is_decided_by_the_axis_and_the_nearest_side() -> None:
    turns = Rotation.random(300, np.random.default_rng(0)).as_matrix()
    for own in (Turning(max_tilt=50), Turning(down=("y-", "z-")), Turning(120, ("x+",))):
        for turn, is_kept in zip(turns, own.allows(turns), strict=True):
            expected = leans(turn) <= own.max_tilt and lowest(turn)[0] in own.down
            assert is_kept == expected
    edge = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    assert all(Turning(down=(side,)).allows(edge[None]) for side in ("z-", "x+"))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Turning(max_tilt=-1), "max tilt -1 is not possible: 0 to 180"),
        (lambda: Turning(max_tilt=math.nan), "max tilt nan"),
        (lambda: Turning(down=()), "no side may face down: choose from x-, x"),
        (lambda: Turning(down=("bottom",)), "'bottom' is not known: choose from x-"),
        (
            lambda: block((1, 1, 1), rotations="fixed", turning=Turning(down=("x+", "y-"))),
            r"'block': none of its rotations \(fixed\) has the side x\+ or y- down",
        ),
        (
            lambda: block((1, 1, 1), rotations="free", turning=Turning(60, ("x+",))),
            r"\(free\) has a tilt of at most 60 degrees and the side x\+ down",
        ),
        (
            lambda: ItemType("i", *_cube(), turning=Turning(45, ("z+",))),
            r"'i': none of its rotations \(cube\) has a tilt",
        ),
    ],
)
def test_impossible_limits_are_one_clear_error(make, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        make()


def _cube():
    mesh = creation.box((1, 1, 1))
    return mesh.vertices, mesh.faces


def test_a_part_that_may_not_lie_down_is_too_large_for_a_low_box() -> None:
    tall = block((10, 10, 30))
    assert pack([tall], (30, 30, 12), settings=QUICK).count == 1
    with pytest.raises(ArgumentError, match="no part fits"):
        pack([replace(tall, turning=Turning(max_tilt=80))], (30, 30, 12), settings=QUICK)
    with pytest.raises(ArgumentError, match="no part fits"):
        pack([replace(tall, turning=Turning(down=("z-", "z+")))], (30, 30, 12), settings=QUICK)
    for side in ("x-", "x+", "y-", "y+"):
        only = replace(tall, turning=Turning(down=(side,)))
        packed = pack([only], (30, 30, 12), settings=QUICK)
        assert lowest(packed.pose(packed.packings[0].placements[0])) == [side]


def test_sides_are_those_after_the_up_axis_has_become_z() -> None:
    own = block((10, 30, 10), up="y", turning=Turning(max_tilt=0))
    packed = pack([own], (12, 12, 30), settings=QUICK)
    assert packed.count == 1
    with pytest.raises(ArgumentError, match="no part fits"):
        pack([own], (12, 30, 12), settings=QUICK)


def test_nest_keeps_the_limits() -> None:
    mesh = creation.box((1, 2, 3))
    kind = ItemType("i", mesh.vertices, mesh.faces, 4, "cube", turning=Turning(down=("x-", "y+")))
    settings = NestSettings(workers=1, iterations=2)
    packing = nest([kind], (5, 5, 5), "knapsack", settings=settings)
    assert len(packing.placements) > 1
    assert {lowest(one.matrix)[0] for one in packing.placements} <= {"x-", "y+"}


@pytest.mark.parametrize("rotations", ["cube", "free"])
def test_forged_tilts_and_sides_are_refused(rotations: str, tmp_path: Path) -> None:
    limits = Turning(20, ("z-",))
    own = block((10, 12, 14), rotations=rotations, turning=limits)
    pack([own], (40, 40, 40), settings=QUICK, out=tmp_path)
    file = tmp_path / "packing.json"
    record = json.loads(file.read_text())
    part = record["request"]["parts"][0]
    assert (part["max tilt"], part["down"]) == (20, ["z-"])
    assert not verify_record(file).problems

    def problems(changed) -> str:
        other = tmp_path / "forged.json"
        other.write_text(json.dumps(changed))
        return " ".join(str(each) for each in verify_record(other).problems)

    def turned(angle: float) -> dict:
        turn = Rotation.from_euler("x", angle, degrees=True).as_matrix()
        pose = [[*row, 20.0] for row in turn.tolist()]
        return record | {"items": [record["items"][0] | {"pose": [*pose, [0.0, 0.0, 0.0, 1.0]]}]}

    for angle in (21, 90, 180):
        is_known = rotations == "free" or angle % 90 == 0
        words = f"leans by {angle} degrees, more than 20" if is_known else "rotation is none of"
        assert words in problems(turned(angle))
        judge = Judge(tmp_path, record)
        assert judge.verdict(json.dumps(turned(angle)).encode()).state == "wrong"
    if rotations == "free":
        assert "leans" not in problems(turned(19))
    part["down"] = ["z+"]
    assert "none of its rotations" in problems(record)
    part["max tilt"] = 180
    assert "its side z- faces down, which is none of z+" in problems(record)


def test_resuming_drops_what_breaks_a_limit() -> None:
    own = block((10, 12, 14), count=2, rotations="free")
    packed = pack([own], (40, 40, 40), settings=QUICK)
    items = items_of(packed, packed.task.unit)
    turn = Rotation.from_euler("y", 100, degrees=True).as_matrix()
    items[0].pose = (*((*row, 20.0) for row in turn.tolist()), (0.0, 0.0, 0.0, 1.0))
    limits = {"leans by 100": Turning(max_tilt=30), "side x+": Turning(down=("z-",))}
    for words, each in limits.items():
        task = prepared_task([replace(own, turning=each)], (40, 40, 40), "volume", QUICK)
        kept, faults = resumed(task, items, ["box"], 0)
        assert (kept.count, len(faults)) == (1, 1)
        assert words in faults[0][1]


def test_lists_of_parts_have_limits(tmp_path: Path) -> None:
    creation.box((1, 2, 3)).export(tmp_path / "a.stl")
    table = "File;Max Tilt (deg);Down\na.stl;12,5;z- x+\na.stl;30°;\na.stl;;y-\na.stl;steep;\n"
    (tmp_path / "parts.csv").write_text(table + "a.stl;;left\n")
    general = ReadSettings(turning=Turning(max_tilt=100))
    reading = find_parts([tmp_path / "parts.csv"], general)
    assert [each.turning for each in reading.parts] == [
        Turning(12.5, ("z-", "x+")) if n == 0 else limits
        for n, limits in enumerate([None, Turning(30), Turning(100, ("y-",))])
    ]
    reasons = [each.reason for each in reading.unread]
    assert "'steep' is not an angle in degrees, such as 15deg" in reasons[0]
    assert "'left' is not a side: choose from x-" in reasons[1]


ROD = block((115, 2, 2), rotations="free")


@pytest.mark.parametrize(("box", "count"), [((90, 80, 5), 2), ((72, 72, 72), 1)])
def test_a_rod_that_only_fits_diagonally_is_packed(box, count: int) -> None:
    packed = pack([replace(ROD, count=count)], box, settings=QUICK)
    assert packed.count == count
    assert all(not each.problems() for each in packed.packings)
    with pytest.raises(ArgumentError, match="no part fits"):
        pack([replace(ROD, rotations="cube")], box, settings=QUICK)


def test_diagonal_rods_keep_the_limits() -> None:
    upright = replace(ROD, turning=Turning(max_tilt=10))
    packed = pack([upright], (90, 80, 5), settings=QUICK)
    assert leans(packed.pose(packed.packings[0].placements[0])) < 1e-6
    with pytest.raises(ArgumentError, match="no part fits"):
        pack([upright], (72, 72, 72), settings=QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_random_orders_keep_the_limits(seed: int, tmp_path: Path) -> None:
    """Poses of the record are judged by code that shares nothing with the search."""
    rng = np.random.default_rng(seed)
    parts = []
    for n in range(4):
        rotations = str(rng.choice(("cube", "free", "flip-8", "axis-4", "upright")))
        down = tuple(rng.choice(SIDES, int(rng.integers(1, 5)), replace=False).tolist())
        limits = Turning(float(rng.choice((0, 15, 100, 180))), (*down, "z-"))
        mesh = creation.box(rng.uniform(8, 25, 3))
        if rng.random() < 0.3:
            mesh = creation.cylinder(rng.uniform(3, 8), rng.uniform(8, 25), sections=12)
        up = str(rng.choice(("x", "y", "z")))
        parts.append(Part(f"p{n}", mesh, int(rng.integers(1, 5)), rotations=rotations, up=up))
        parts[-1] = replace(parts[-1], turning=limits)
    options = {"clearance": float(rng.choice((0, 0.5)))}
    if options["clearance"] and rng.random() < 0.5:
        options["clearance_z"] = 1.0
    settings = replace(QUICK, iterations=3, **options)
    packed = pack(parts, (50, 45, 40), settings=settings, out=tmp_path)
    assert packed.count > 2
    ups = {"x": [[0, 1, 0], [0, 0, 1], [1, 0, 0]], "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]]}
    for _, one in packed.placements:
        part = packed.part(one).part
        turn = packed.pose(one)[:3, :3] @ np.array(ups.get(part.up, np.eye(3))).T
        assert leans(turn) <= part.turning.max_tilt + 1e-4
        assert set(lowest(turn)) & set(part.turning.down)
    assert not verify_record(tmp_path / "packing.json").problems
