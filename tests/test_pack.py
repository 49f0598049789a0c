"""`packit_sim.pack`: parts of real sizes in boxes, checked by their original files."""

import json
import math
import signal
import threading
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh import creation

from packit_sim import BoxType, PackedParts, PackSettings, Part, nest, pack
from packit_sim.core.errors import ArgumentError, BusyError
from packit_sim.parts import check, export, summary, table, view, write_instructions
from packit_sim.parts.filling import box_nesting
from packit_sim.parts.filling.box_nesting import BoxNesting
from packit_sim.parts.handling import sweeps
from packit_sim.parts.handling.broken import broken_constraints
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.order import packing_order
from packit_sim.parts.handling.removal import removable
from packit_sim.parts.handling.supports import stacking
from packit_sim.parts.handling.sweeps import PartSweeps
from packit_sim.parts.nesting.nest import NestingError
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading import prepared as prepared_module
from packit_sim.parts.reading.files import ReadSettings
from packit_sim.parts.reading.prepared import prepare
from packit_sim.parts.results import check as check_module
from packit_sim.parts.results import exports, pictures
from packit_sim.parts.results.record import own_folder
from packit_sim.parts.results.resuming import read_earlier
from tests.read_3mf import bodies

QUICK = PackSettings(workers=1, iterations=300)


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes longer than all else here; `test_pack_cli.py` draws."""
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))


def cube(side: float = 10.0, name: str = "cube", **settings: Any) -> Part:
    return Part(name, creation.box((side, side, side)), **settings)


def slab(x: float, y: float, z: float, name: str = "slab", **settings: Any) -> Part:
    return Part(name, creation.box((x, y, z)), **settings)


def counts(packed: PackedParts) -> dict[str, int]:
    names = [packed.part(one).part.name for _, one in packed.placements]
    return {name: names.count(name) for name in names}


@cache
def packed_bins(folder: Path) -> PackedParts:
    """An L, a ring and a tilted bar from files, with a clearance, exported."""
    mesh = trimesh.util.concatenate(
        [creation.box((20, 10, 10)), creation.box((10, 10, 10)).apply_translation((-5, 10, 0))]
    )
    mesh.apply_translation((100, 50, -20)).export(folder / "angle.stl")
    ring = creation.torus(8, 2, major_sections=12, minor_sections=8)
    ring.apply_scale(1 / 1000).export(folder / "ring.glb")
    creation.box((1, 0.25, 0.25)).export(folder / "bar.stl")
    (folder / "parts.csv").write_text(
        "file,count,density,unit,rotations\n"
        "angle.stl,2,7.8,mm,upright\nring.glb,2,1,,\nbar.stl,3,2.5,in,yaw-8\n"
    )
    settings = replace(QUICK, clearance=0.5, wall_clearance=1.0)
    return pack([folder / "parts.csv"], "60x40x4cm", out=folder / "out", settings=settings)


@pytest.fixture(name="folder", scope="module")
def _folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("parts")


def test_lengths_have_the_unit_of_the_box(folder) -> None:
    packed = packed_bins(folder)
    assert packed.task.unit == "cm"
    assert packed.packings[0].container.size == pytest.approx((60, 40, 4))
    assert counts(packed) == {"angle": 2, "ring": 2, "bar": 3}
    volumes = {part.part.name: part.volume for part in packed.task.parts}
    assert volumes["bar"] == pytest.approx(1 * 0.25 * 0.25 * 2.54**3)


def test_3mf_is_read_as_slicers_do(folder) -> None:
    packed = packed_bins(folder)
    found = bodies(folder / "out" / "packing.3mf")
    assert [name.split()[1] for name in found] == [
        packed.part(one).part.name for _, one in packed.placements
    ]
    for triangles, (_, one) in zip(found.values(), packed.placements, strict=True):
        pose = packed.pose(one)
        expected = packed.part(one).part.mesh.triangles @ pose[:3, :3].T + pose[:3, 3]
        for extreme in (np.min, np.max, np.mean):
            own = extreme(expected, (0, 1))
            assert extreme(triangles, (0, 1)) * 0.1 == pytest.approx(own, abs=2e-5)


@pytest.mark.parametrize("suffix", ["glb", "stl"])
def test_exports_read_back_by_trimesh_have_the_poses(folder, suffix) -> None:
    packed = packed_bins(folder)
    scene = trimesh.load_scene(folder / "out" / f"packing.{suffix}")
    cm = 100.0 if suffix == "glb" else 0.1
    expected = [
        np.vstack(
            [
                packed.part(one).part.mesh.vertices @ (pose := packed.pose(one))[:3, :3].T
                + pose[:3, 3]
            ]
        )
        for _, one in packed.placements
    ]
    if suffix == "stl":
        found = np.asarray(scene.to_mesh().vertices) * cm
        every = np.concatenate(expected)
        assert found.min(axis=0) == pytest.approx(every.min(axis=0), abs=1e-4)
        assert found.max(axis=0) == pytest.approx(every.max(axis=0), abs=1e-4)
        return
    nodes = sorted(node for node in scene.graph.nodes_geometry)
    assert [name.split()[1] for name in nodes] == [
        packed.part(one).part.name for _, one in packed.placements
    ]
    for node, vertices in zip(nodes, expected, strict=True):
        matrix, geometry = scene.graph[node]
        own = trimesh.transform_points(scene.geometry[geometry].vertices, matrix) * cm
        if suffix == "glb":
            own = own[:, [0, 2, 1]] * (1, -1, 1)  # y up
        for low_or_high in (np.min, np.max):
            assert low_or_high(own, axis=0) == pytest.approx(
                low_or_high(vertices, axis=0), abs=2e-5
            )


def test_the_record_is_verified_with_the_meshes_next_to_it(folder) -> None:
    packed = packed_bins(folder)
    report = verify_packing(folder / "out" / "packing.json")
    assert report.problems == () and report.items == packed.count
    (mesh,) = (folder / "out" / "meshes").glob("angle-*.stl")
    assert mesh.read_bytes() == (folder / "angle.stl").read_bytes()


def test_the_original_files_keep_the_promised_distances(folder) -> None:
    packed = packed_bins(folder)
    assert check(packed).problems == ()
    assert check(packed).distance is not None and check(packed).distance >= 0.5
    for box, one in packed.placements:
        vertices = box.vertices(one)
        assert vertices.min() >= 1 - 1e-9
        assert (vertices.max(axis=0) <= np.array((59, 39, 3)) + 1e-9).all()


def test_masses_and_the_centre_of_gravity_are_in_the_table(folder) -> None:
    packed = packed_bins(folder)
    volumes = {part.part.name: part.volume for part in packed.task.parts}
    mass = 2 * 7.8 * volumes["angle"] + 2 * volumes["ring"] + 3 * 2.5 * volumes["bar"]
    assert packed.mass == pytest.approx(mass)
    assert "by mass" in table(packed) and "7 of 7 parts" in table(packed)


def moved(packed: PackedParts, shift: tuple[float, float, float]) -> PackedParts:
    """The last part of the first box moved."""
    (box, *rest) = packed.packings
    *others, last = box.placements
    pose = last.matrix
    pose[:3, 3] += shift
    box = replace(box, placements=(*others, Placement.from_matrix(last.type, pose)))
    return replace(packed, packings=(box, *rest))


def test_the_check_finds_parts_that_overlap_or_are_outside(folder) -> None:
    packed = packed_bins(folder)
    box, last = packed.placements[-1]
    first = box.placements[0]
    onto = moved(packed, tuple(box.vertices(first)[0] - box.vertices(last).mean(axis=0)))
    assert any("crosses" in each for each in check(onto).problems)
    assert any("less than 0.5 cm" in each for each in check(onto).problems)
    assert any("1 cm to the walls" in each for each in check(moved(packed, (0, 0, -0.5))).problems)


def test_a_closed_part_inside_another_is_found() -> None:
    task = pack([cube(30, "large"), cube(5, "small")], (40, 40, 40), settings=QUICK).task
    poses = [np.eye(4), np.eye(4)]
    for pose in poses:
        pose[:3, 3] = 20
    packing = Packing(
        task.types,
        task.boxes[0].container,
        [Placement.from_matrix(n, p) for n, p in enumerate(poses)],
    )
    packed = pack([cube(30, "large"), cube(5, "small")], (40, 40, 40), settings=QUICK)
    inside = replace(packed, packings=(packing,))
    assert any("is inside" in each for each in check(inside).problems)


def test_cubes_that_tile_the_box_are_all_packed() -> None:
    packed = pack([cube(count=8)], (20, 20, 20), settings=QUICK)
    assert packed.count == 8 and packed.density == pytest.approx(1) and check(packed).problems == ()
    assert check(packed).distance == pytest.approx(0, abs=0.02)


def test_bolts_are_packed_inside_a_tube_that_fills_the_box() -> None:
    head = creation.cylinder(4, 5, sections=6).apply_translation((0, 0, 17))
    bolt = trimesh.boolean.union([creation.cylinder(2.5, 30, sections=12), head], engine="manifold")
    tube = creation.annulus(12, 15, 60, sections=24)
    packed = pack([Part("tube", tube), Part("bolt", bolt, count=4)], (31, 31, 61), settings=QUICK)
    assert packed.count == 5 and check(packed).problems == ()


def bolts_and_tube() -> list[Part]:
    """Four bolts in a row fill the tube, which fills a box of 30.1 x 30.1 x 122.2 mm."""
    tube = creation.annulus(12.5, 15, 122, sections=64)
    bolt = creation.revolve([(0, 0), (12, 0), (12, 8), (6, 8), (6, 30), (0, 30)], sections=32)
    return [Part("tube", tube, rotations="axis-4"), Part("bolt", bolt, 4, rotations="axis-4")]


def test_a_large_part_is_not_left_for_last_where_the_number_counts() -> None:
    settings = replace(QUICK, iterations=1000)
    packed = pack(bolts_and_tube(), (30.1, 30.1, 122.2), "count", settings=settings)
    assert packed.count == 5 and check(packed).problems == ()


def test_a_search_by_volume_that_finds_nothing_is_not_the_end(monkeypatch) -> None:
    nested, kinds = BoxNesting.nest, []

    def nest(nesting: BoxNesting, *given: Any) -> None:
        kinds.append(len(given) > 8 and given[8])
        if kinds[-1]:
            raise NestingError("nothing was found")
        nested(nesting, *given)

    monkeypatch.setattr(BoxNesting, "nest", nest)
    settings = replace(QUICK, iterations=20)
    packed = pack(bolts_and_tube(), (30.1, 30.1, 122.2), "count", settings=settings)
    assert packed.count == 4 and kinds == [True, False]


def test_the_pieces_of_a_cube_are_put_together_again() -> None:
    sides = [(30, 60, 60), (30, 20, 60), (30, 40, 20), (30, 40, 10), (10, 40, 30), (20, 40, 30)]
    parts = [slab(x, y, z, f"{x}-{y}-{z}") for x, y, z in sides]
    packed = pack(parts, (60, 60, 60), settings=QUICK)
    assert packed.density == pytest.approx(1) and check(packed).problems == ()


def test_bowls_are_nested() -> None:
    profile = np.array([[0, 0], [12, 0], [20, 18], [18.5, 18], [11, 1.5], [0, 1.5]])
    bowl = creation.revolve(profile, sections=12)
    settings = replace(QUICK, iterations=200, workers=3)  # one search finds it for 3 of 5 seeds
    packed = pack(
        [Part("bowl", bowl, count=3, rotations="upright")],
        (41, 41, 60),
        "height",
        settings=settings,
    )
    assert packed.height < 18 + 2 * 3.75 and check(packed).problems == ()  # at best 3.70 for a step


def test_a_search_of_so_many_passes_does_not_depend_on_the_time() -> None:
    parts = [cube(5, count=4), slab(5, 5, 12, count=2)]
    settings = replace(QUICK, iterations=50)
    short, long = (
        pack(parts, (14, 14, 30), "height", time=time, settings=settings) for time in (1e-9, 60)
    )
    assert short.height == long.height and short.count == 6


def test_shelves_are_shown_before_the_search(monkeypatch) -> None:
    shown: list[int] = []
    before: list[int] = []

    def searched(*arguments: Any, **settings: Any) -> None:
        before.extend(shown)

    monkeypatch.setattr(box_nesting, "nest", searched)
    parts = [cube(count=6)]
    packed = pack(parts, "25x25x15mm", settings=QUICK, callback=lambda p, _: shown.append(p.count))
    assert before == [4] and packed.count == 4


def test_a_box_without_a_unit_has_that_of_the_others() -> None:
    packed = pack([cube()], ["A:300x200x150", "B:30x20x15cm"], settings=QUICK)
    assert packed.task.unit == "cm"
    assert [box.size for box in packed.task.boxes] == [(300, 200, 150), (30, 20, 15)]
    assert packed.notes[0] == "boxes without a unit read as cm: A:300x200x150"
    assert "note: boxes without a unit read as cm" in table(packed)
    settings = replace(QUICK, unit="mm")
    packed = pack([cube()], ["A:30x20x15", "B:3x2x1cm"], settings=settings)
    assert [box.size for box in packed.task.boxes] == [(300, 200, 150), (30, 20, 10)]
    packed = pack([cube()], ["A:30x20x15cm", "B:1x1x1in"], settings=QUICK)
    assert packed.task.boxes[1].size == pytest.approx((2.54,) * 3)
    assert not any("without a unit" in note for note in packed.notes)
    with pytest.raises(ArgumentError, match="box 'C:9x9x9' has no unit, and others have cm and in"):
        pack([cube()], ["A:30x20x15cm", "B:1x1x1in", "C:9x9x9"], settings=QUICK)


def test_a_box_that_is_not_possible_is_named_before_parts_are_read(tmp_path) -> None:
    settings = replace(QUICK, wall_clearance=5.0)
    with pytest.raises(ArgumentError, match="box 'box': 5 mm at each wall leave no space"):
        pack([tmp_path / "none.stl"], "10x10x10", settings=settings)
    with pytest.raises(ArgumentError, match="'best' is not known"):
        pack([tmp_path / "none.stl"], "10x10x10", "best")  # type: ignore[arg-type]


def test_a_summary_checks_no_file(monkeypatch) -> None:
    packed = pack([cube(count=2)], (20, 20, 20), settings=QUICK)
    monkeypatch.setattr(check_module, "LooseMesh", None)
    assert summary(packed)["check"] == "not done" and "smallest distance" not in summary(packed)
    monkeypatch.undo()
    texts = summary(packed, check(packed))
    assert texts["check"].startswith("no problems") and "smallest distance" in texts


def test_the_straight_moves_of_a_packing_are_computed_once(tmp_path, monkeypatch) -> None:
    built = []
    monkeypatch.setattr(
        sweeps, "PartSweeps", lambda packing: built.append(packing) or PartSweeps(packing)
    )
    packed = pack([cube(count=2)], (20, 20, 20), settings=replace(QUICK, iterations=5))
    packing = packed.contents[0]
    for question in (removable, stacking, packing_order):
        question(packing)
    assert broken_constraints(packing, Constraints(removable=True)) == []
    assert built == [packing]


def test_parts_larger_than_every_box_are_left_out_with_the_reason() -> None:
    parts = [cube(), slab(2540, 200, 100, "inches"), slab(50, 5, 5, "bar", rotations="fixed")]
    packed = pack(parts, "120x60x40mm", settings=QUICK)
    reasons = {each.name: each.reason for each in packed.left_out}
    assert counts(packed) == {"cube": 1, "bar": 1}
    assert "larger than the box of 120 x 60 x 40 mm" in reasons["inches"]
    tall = pack([cube(), slab(5, 5, 50, "bar", rotations="upright")], (120, 60, 40), settings=QUICK)
    assert "in its rotations (yaw-4)" in tall.left_out[0].reason


def test_likely_mistakes_of_units_are_named() -> None:
    metres = cube(0.08, "metres", unit="m")
    assert pack([metres], "300x200x150mm", settings=QUICK).notes == ()
    wrong = Part("wrong", creation.box((80, 50, 20)), unit="m")
    packed = pack([wrong, metres], "300x200x150mm", settings=QUICK)
    assert "is its unit mm instead of m? Then it is 80 x 50 x 20 mm" in packed.left_out[0].reason
    small = pack([cube(0.08)], "300x200x150mm", settings=QUICK)
    assert "is its unit m instead of mm?" in small.notes[0]
    inches = pack([slab(3, 2, 2)], "300x200x150mm", settings=QUICK)
    assert "in inches instead of mm?" in inches.notes[0]


def test_higher_priorities_come_first_whatever_the_volumes() -> None:
    parts = [slab(20, 20, 20, "large"), slab(20, 20, 4, "flat", priority=1, rotations="fixed")]
    assert counts(pack(parts, (20, 20, 20), settings=QUICK)) == {"flat": 1}
    parts = [cube(20, "large"), cube(5, "small", count=3)]
    assert counts(pack(parts, (20, 20, 20), settings=QUICK)) == {"large": 1}
    assert counts(pack(parts, (20, 20, 20), "count", settings=QUICK)) == {"small": 3}
    valued = [cube(20, "large", value=1), cube(5, "small", value=2)]
    assert counts(pack(valued, (20, 20, 20), "value", settings=QUICK)) == {"small": 1}


def test_the_lowest_packing_is_below_the_top() -> None:
    parts = [slab(10, 10, 30, count=4)]
    packed = pack(parts, (20, 30, 40), "height", settings=QUICK)
    assert packed.count == 4 and packed.height == pytest.approx(20, abs=0.1)
    full = pack([slab(10, 10, 30, count=9)], (20, 30, 40), "height", settings=QUICK)
    assert full.count == 8 and full.left_out[0].reason == "no space was found"


def test_the_fewest_boxes_are_used() -> None:
    quick = replace(QUICK, iterations=60)
    packed = pack([cube(count=12)], (20, 20, 20), "boxes", settings=quick)
    assert packed.count == 12 and len(packed.packings) == 2 and check(packed).problems == ()
    two = pack([cube(count=20)], (21, 21, 21), "boxes", settings=replace(quick, boxes=2))
    assert two.count == 16 and len(two.packings) == 2


def test_boxes_of_several_sizes_are_filled_and_verified(tmp_path) -> None:
    boxes = [BoxType((20, 20, 20), "A"), "B:10x10x20mm"]
    packed = pack([cube(count=11)], boxes, out=tmp_path, settings=QUICK)
    assert [(box.container.name, len(box.placements)) for box in packed.packings] == [
        ("A", 8),
        ("B", 2),
    ]
    assert verify_packing(tmp_path / "packing.json").problems == ()
    assert {"packing-1.3mf", "packing-2.png"} <= {file.name for file in tmp_path.iterdir()}
    (tmp_path / "packing-1.gif").write_text("the user's")
    pack([cube(count=3)], (20, 20, 20), out=tmp_path, settings=QUICK)
    assert [file.name for file in tmp_path.glob("packing-*")] == ["packing-1.gif"]
    assert (tmp_path / "packing.3mf").exists()


def test_few_boxes_are_as_small_as_they_can_be() -> None:
    """Ten cubes need two boxes, one of which may be a small one."""
    settings = replace(QUICK, iterations=400)
    boxes = ["A:20x20x20mm", "B:20x10x10mm"]
    packed = pack([cube(9, count=10)], boxes, "boxes", settings=settings)
    assert packed.count == 10 and check(packed).problems == ()
    assert sorted(box.container.name for box in packed.packings) == ["A", "B"]


@pytest.mark.slow
def test_the_picture_shows_what_stays_free(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(exports, "draw", pictures.draw)
    free = Part("pillar", creation.box(bounds=[(8, 8, 0), (12, 12, 20)]))
    greys = []
    for volumes in ((), (free,)):
        settings = replace(QUICK, keep_out=volumes)
        pack([cube(6, count=3)], (20, 20, 20), out=tmp_path, settings=settings)
        pixels = np.asarray(Image.open(tmp_path / "packing.png").convert("RGB"), dtype=int)
        greys.append(((np.ptp(pixels, axis=2) < 3) & (abs(pixels[..., 0] - 165) < 35)).mean())
    assert greys[1] > greys[0] + 0.02


class _Few:
    """At most so many parts in a box."""

    def __init__(self, most: int) -> None:
        self.most = most

    def left_out(self, packing: Packing) -> Mapping[int, str]:
        return dict.fromkeys(range(self.most, len(packing.placements)), "too many")

    def __repr__(self) -> str:
        return f"few {self.most}"


def test_parts_that_break_a_constraint_are_left_out_and_reported() -> None:
    packed = pack([cube(count=8)], (20, 20, 20), settings=replace(QUICK, constraints=[_Few(3)]))
    assert packed.count == 3
    assert [(each.count, each.reason) for each in packed.left_out] == [(5, "too many")]


def test_nothing_rests_on_parts_that_carry_nothing_and_loads_are_limited() -> None:
    parts = [cube(name="glass", no_stack=True, mass=5), cube(name="cube", count=2, mass=20)]
    packed = pack(parts, (10, 10, 30), settings=QUICK)
    assert not packed.task.constraints.is_empty
    tops = {packed.part(one).part.name: one.pose.translation[2] for _, one in packed.placements}
    assert max(tops, key=lambda name: tops[name]) == "glass" or set(tops) == {"cube"}
    weak = [cube(name="weak", count=3, mass=20, max_load=20)]
    packed = pack(weak, (10, 10, 30), settings=QUICK)
    assert packed.count == 2 and "40 g: at most 20 g" in packed.left_out[0].reason
    with pytest.raises(ArgumentError, match="load limits need masses"):
        pack([cube(), *weak], (10, 10, 30), settings=QUICK)


def test_parts_are_in_an_order_in_which_they_can_be_put_in() -> None:
    settings = replace(QUICK, insertable=True)
    packed = pack([cube(count=8)], (20, 20, 20), settings=settings)
    heights = [one.pose.translation[2] for _, one in packed.placements]
    assert packed.count == 8 and heights == sorted(heights)


def test_an_earlier_packing_is_kept_until_a_better_one_is_found(tmp_path, monkeypatch) -> None:
    first = pack([cube(count=8)], (20, 20, 20), out=tmp_path, settings=QUICK)
    seen = []
    monkeypatch.setattr("packit_sim.parts.filling.box_nesting.nest", None)  # never called
    again = pack(
        [cube(count=8)],
        (20, 20, 20),
        out=tmp_path,
        callback=lambda found, _: seen.append(found.count),
        settings=QUICK,
    )
    assert (first.count, again.count, seen, again.searches) == (8, 8, [8], 2)
    poses = [packed.placements[3][1].matrix for packed in (first, again)]
    assert poses[0] == pytest.approx(poses[1])


def test_parts_of_an_earlier_packing_that_are_not_valid_are_packed_anew(tmp_path) -> None:
    pack([cube(count=8)], (20, 20, 20), out=tmp_path, settings=QUICK)
    record = json.loads((tmp_path / "packing.json").read_text())
    record["items"][0]["pose"] = record["items"][1]["pose"]
    (tmp_path / "packing.json").write_text(json.dumps(record))
    again = pack([cube(count=8)], (20, 20, 20), out=tmp_path, settings=QUICK)
    assert (again.count, again.searches) == (8, 2) and check(again).problems == ()
    for broken in ({"items": 3}, {"box names": 3}, {"searches": None}):
        (tmp_path / "packing.json").write_text(json.dumps({**record, **broken}))
        assert read_earlier(tmp_path, again.task) is None
    for foreign in ("[]", '{"task": 3}'):
        (tmp_path / "packing.json").write_text(foreign)
        with pytest.raises(ArgumentError, match="choose another folder"):
            pack([cube()], (20, 20, 20), out=tmp_path, settings=QUICK)


def test_two_processes_do_not_pack_into_one_folder(tmp_path) -> None:
    with own_folder(tmp_path), pytest.raises(BusyError, match="is at work there"):
        pack([cube()], (20, 20, 20), out=tmp_path, settings=QUICK)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ArgumentError, match="file is a file: choose a folder"):
        pack([cube()], (20, 20, 20), out=tmp_path / "file", settings=QUICK)


def test_a_box_is_shown_on_a_page() -> None:
    pytest.importorskip("viser")
    packed = pack([cube(count=3)], (20, 20, 20), settings=QUICK)
    with view(packed) as viewer:
        assert len(viewer.items) == packed.count == 3


def test_ctrl_c_returns_the_best_packing_so_far() -> None:
    def interrupt(found: PackedParts, seconds: float) -> None:
        raise KeyboardInterrupt

    packed = pack(
        [cube(count=9)], (20, 20, 20), time=600, callback=interrupt, settings=PackSettings()
    )
    assert packed.count >= 1


CORNER = Part("corner", creation.box((1, 1, 1)))
"""Kept free, so that no grid fills a box at once."""


def test_another_thread_ends_the_search_for_all_boxes() -> None:
    stop = threading.Event()
    settings = PackSettings(workers=1, boxes=3, stop=stop, keep_out=[CORNER])
    packed = pack(
        [cube(count=20)], (20, 20, 20), time=3600, callback=lambda *_: stop.set(), settings=settings
    )
    assert len(packed.packings) == 1 and 1 <= packed.count <= 8


def test_ctrl_c_also_ends_the_search_for_further_boxes() -> None:
    before = signal.getsignal(signal.SIGINT)
    packed = pack(
        [cube(count=20)],
        (20, 20, 20),
        callback=lambda *_: signal.raise_signal(signal.SIGINT),
        settings=replace(QUICK, boxes=3, keep_out=[CORNER]),
    )
    assert len(packed.packings) == 1 and 1 <= packed.count <= 8
    assert signal.getsignal(signal.SIGINT) is before


def test_a_detailed_mesh_is_simplified_and_its_deviation_kept_free(monkeypatch) -> None:
    monkeypatch.setattr(prepared_module, "TRIANGLES", 400)
    ball = creation.icosphere(subdivisions=3, radius=10)
    part = Part("ball", ball, count=2)
    prepared = prepare(part, "mm", accuracy=0.5)
    assert len(prepared.item_type.faces) <= 400 < len(ball.faces)
    assert 0 < prepared.deviation <= 0.5
    assert prepared.volume == pytest.approx(ball.volume, rel=1e-6)
    settings = replace(QUICK, accuracy=0.5, clearance=0.3, wall_clearance=0.1, iterations=10)
    packed = pack([part], (22, 22, 44), settings=settings)
    assert packed.count == 2 and check(packed).problems == ()
    assert packed.task.gap >= 0.3 + 2 * prepared.deviation
    assert "reduced" in packed.notes[0]


def test_tiny_parts_next_to_large_ones_are_packed_as_boxes() -> None:
    parts = [cube(30, "large"), cube(0.1, "tiny", count=3), cube(2, "small")]
    packed = pack(parts, (40, 40, 40), settings=replace(QUICK, clearance=0.2, iterations=20))
    sides = {each.part.name: each.item_type.extents.max() for each in packed.task.parts}
    assert sides == pytest.approx({"large": 30, "tiny": 30 / 25, "small": 2})
    assert packed.count == 5 and check(packed).problems == ()
    assert packed.volume == pytest.approx(30**3 + 2**3 + 3 * 0.1**3)
    assert packed.notes == ("tiny: tiny among these parts: packed as a box of 1.2 x 0.1 x 0.1 mm",)


def test_open_and_self_intersecting_surfaces_are_solid_by_voxels() -> None:
    bowl = creation.box((10, 10, 10))
    bowl.update_faces(bowl.face_normals[:, 2] < 0.5)
    twice = trimesh.util.concatenate([creation.box((10, 10, 10))] * 2)
    twice.vertices[8:] += 3
    for mesh in (bowl, twice):
        prepared = prepare(Part("mesh", mesh), "mm")
        assert not prepared.is_closed
    packed = pack([Part("bowl", bowl), cube(5)], (20, 20, 20), settings=QUICK)
    assert packed.notes[0].endswith("is only that of a thin sheet: bowl")
    packed = pack([Part("twice", twice)], (20, 20, 20), settings=QUICK)
    assert packed.notes == ("solid by voxels, since open or self-intersecting: twice",)
    assert prepare(Part("mesh", twice), "mm").volume == pytest.approx(2000 - 7**3, rel=0.02)


def test_parts_of_a_scene_are_packed_by_themselves(tmp_path) -> None:
    plate = trimesh.Scene()
    pin = creation.box((2, 2, 10))
    for n in range(3):
        matrix = trimesh.transformations.translation_matrix((4 * n, 0, 0))
        plate.add_geometry(pin, f"pin-{n}", "pin", transform=matrix)
    plate.add_geometry(creation.box((8, 8, 2)), "lid", "lid")
    plate.export(tmp_path / "plate.3mf")
    packed = pack([tmp_path / "plate.3mf"], (20, 20, 12), settings=QUICK)
    assert {part.part.name: part.part.count for part in packed.task.parts} == {
        "plate/pin": 3,
        "plate/lid": 1,
    }
    assert packed.count == 4 and check(packed).problems == ()
    whole = replace(QUICK, reading=ReadSettings(split=False))
    packed = pack([tmp_path / "plate.3mf"], (20, 20, 12), settings=whole)
    assert packed.count == 1 and "packed as one part" in packed.notes[0]


def test_one_broken_file_is_named_and_the_others_are_packed(tmp_path) -> None:
    for n in range(3):
        creation.box((5, 5, 5)).export(tmp_path / f"part-{n}.stl")
    (tmp_path / "broken.stl").write_text("solid nothing")
    packed = pack([tmp_path], (10, 10, 10), settings=QUICK)
    assert packed.count == 3
    assert [Path(each.source).name for each in packed.unread] == ["broken.stl"]
    assert "broken.stl" in table(packed)
    assert "4 files" not in packed.notes[0] and "3 files" in packed.notes[0]


def test_a_manifest_names_what_is_missing(tmp_path) -> None:
    creation.box((5, 5, 5)).export(tmp_path / "a.stl")
    rows = [
        {"file": "a.stl", "count": 2, "value": 3, "priority": 1, "mass": 10, "name": "first"},
        {"file": "b.stl"},
    ]
    (tmp_path / "parts.json").write_text(json.dumps({"parts": rows}))
    packed = pack([tmp_path / "parts.json"], (10, 10, 10), settings=QUICK)
    assert counts(packed) == {"first": 2} and packed.mass == 20
    assert Path(packed.unread[0].source).name == "b.stl"


def test_counts_are_written_behind_a_path(tmp_path) -> None:
    creation.box((5, 5, 5)).export(tmp_path / "a.stl")
    packed = pack([f"{tmp_path}/a.stl=3", f"{tmp_path}/*.stl"], (10, 10, 10), settings=QUICK)
    assert counts(packed) == {"a": 3, "a-2": 1}


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("file,no_stack\na.stl,maybe\n", "no_stack 'maybe' is not yes or no"),
        ("file,no_stak\na.stl,yes\n", "column 'no_stak' is not known: is it 'no_stack'"),
        ("file,count\na.stl,two\n", "count 'two' is not a whole number"),
        ("file,count\na.stl,-1\n", "at least 0"),
        ("file,unit\na.stl,furlong\n", "unit 'furlong' is not known"),
        ("file,rotations\na.stl,sideways\n", "'sideways' are not known"),
        ("file,mass\na.stl,0\n", "mass 0.0 is not possible"),
        ("count\n3\n", "it has no file"),
        ("", "it has no parts"),
        ("file,count\na.stl,1,2\n", "'column 3, without a heading' is not known"),
        ("file,count\na.stl,10001\n", "1 to 10000"),
        ('file,count\n"a.stl' + "x" * 140_000, "it is not CSV"),
    ],
)
def test_manifests_that_are_not_possible_are_named(tmp_path, content, problem) -> None:
    creation.box((5, 5, 5)).export(tmp_path / "a.stl")
    (tmp_path / "parts.csv").write_text(content)
    with pytest.raises(ArgumentError, match=problem):
        pack([tmp_path / "parts.csv"], (10, 10, 10), settings=QUICK)


@pytest.mark.parametrize(
    ("box", "settings", "problem"),
    [
        ("0x10x10mm", {}, "the side 0.0 along x is not possible"),
        ("10x10mm", {}, "is not 3 lengths with a unit"),
        ("10x10x10furlong", {}, "unit 'furlong' is not known"),
        ((10, 10, math.inf), {}, "has no height"),
        (["10x10x10", "20x20x20"], {}, "need different names"),
        ("10x10x10", {"wall_clearance": 5.0}, "leave no space"),
        ("10x10x10", {"clearance": -1.0}, "clearance -1.0 is not possible"),
        ("10x10x10", {"boxes": 0}, "boxes 0 is not possible"),
        ("10x10x10", {"accuracy": 0}, "accuracy 0 is not possible"),
        ("1x1x1", {}, "no part fits"),
    ],
)
def test_arguments_that_are_not_possible_are_named(box, settings, problem) -> None:
    with pytest.raises(ArgumentError, match=problem):
        pack([cube(5)], box, settings=PackSettings(workers=1, iterations=1, **settings))


def test_objectives_that_are_not_possible_are_named() -> None:
    with pytest.raises(ArgumentError, match="'best' is not known"):
        pack([cube()], (20, 20, 20), "best")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="needs parts with a value"):
        pack([cube()], (20, 20, 20), "value")
    with pytest.raises(ArgumentError, match="needs one box"):
        pack([cube()], (20, 20, 20), "height", settings=PackSettings(boxes=2))


@pytest.mark.slow
def test_stable_parts_are_written_where_they_rest() -> None:
    """A ball touches a floor in one point: it rests, and the wall keeps it from rolling away."""
    parts = [slab(18, 9, 3, count=2), Part("ball", creation.icosphere(2, 4.0), mass=20.0)]
    settings = replace(QUICK, stable=3.0, insertable=True)
    packed = pack(parts, (20, 10, 15), settings=settings)
    assert check(packed).problems == ()
    packing = packed.packings[0]
    assert packing.placements
    assert max(stacking(packing).drops) < 0.02
    assert any("1 g/cm3" in note for note in packed.notes)


def test_sources_without_parts_are_errors(tmp_path) -> None:
    for source in (tmp_path, f"{tmp_path}/*.stl", tmp_path / "none.stl"):
        with pytest.raises(ArgumentError, match=tmp_path.name):
            pack([source], (10, 10, 10))
    with pytest.raises(ArgumentError, match="no parts"):
        pack([], (10, 10, 10))


def pillar(folder: Path) -> Path:
    """A file in cm, about 2 x 2 x 9 cm, that stands in a box of 6 x 4 x 4 cm and is higher."""
    mesh = creation.box((2, 2, 9)).apply_translation((3, 2, 4))
    mesh.export(folder / "pillar.stl")
    return folder / "pillar.stl"


@pytest.mark.parametrize("objective", ["volume", "height", "boxes"])
def test_a_volume_stays_free_in_every_box(objective, tmp_path) -> None:
    settings = replace(
        QUICK,
        clearance=1.0,
        wall_clearance=0.5,
        keep_out=[pillar(tmp_path)],
        reading=ReadSettings(unit="cm"),
        boxes=None if objective == "boxes" else 1,
    )
    parts = [cube(8, "cube", count=6), slab(18, 6, 30, count=1)]
    packed = pack(parts, "60x40x40mm", objective, settings=settings, out=tmp_path / "out")
    assert packed.count == 7 and check(packed).problems == ()
    low, high = np.array([20, 10, -5]) - 1 + 1e-3, np.array([40, 30, 85]) + 1 - 1e-3
    for box, one in packed.placements:
        vertices = box.vertices(one)
        assert (vertices.max(axis=0) <= low).any() or (vertices.min(axis=0) >= high).any()
    assert verify_packing(tmp_path / "out" / "packing.json").is_valid
    (obstacle,) = json.loads((tmp_path / "out" / "packing.json").read_text())["obstacles"]
    assert obstacle["name"] == "pillar" and obstacle["pose"][0][0] == 10
    moved = replace(packed, task=replace(packed.task, keep_out=()))
    assert check(moved).problems == ()
    at = packed.placements[0][1].pose.translation
    inside = Part("block", creation.box((300, 300, 300)).apply_translation(at))
    around = replace(packed.task, keep_out=(prepare(inside, "mm"),))
    assert any("block (kept free)" in each for each in check(replace(packed, task=around)).problems)


def test_a_volume_that_fills_the_box_leaves_nothing(tmp_path) -> None:
    creation.box((20, 20, 20)).apply_translation((5, 5, 5)).export(tmp_path / "full.stl")
    settings = replace(QUICK, keep_out=[tmp_path / "full.stl"])
    packed = pack([cube(5)], (10, 10, 10), settings=settings)
    assert packed.count == 0 and packed.left_out[0].reason == "no space was found"
    with pytest.raises(ArgumentError, match=r"nothing is packed.*no space was found"):
        export(packed, tmp_path / "out")


def test_a_keep_out_that_can_not_be_read_is_an_error(tmp_path) -> None:
    (tmp_path / "bad.stl").write_text("solid")
    for name in ("bad.stl", "none.stl"):
        settings = replace(QUICK, keep_out=[tmp_path / name])
        with pytest.raises(ArgumentError, match=f"keep-out.*{name}"):
            pack([cube(5)], (10, 10, 10), settings=settings)


def shelf(folder: Path, **options: Any) -> Part:
    """A board of 20 x 10 x 2 mm, 6.5 mm above the floor of a box of 20 x 10 x 15 mm."""
    file = folder / "shelf.stl"
    creation.box((20, 10, 2)).apply_translation((10, 5, 7.5)).export(file)
    return Part("shelf", trimesh.load_mesh(file), file=file, **options)


def test_parts_are_packed_around_a_fixed_part_and_rest_on_it(tmp_path) -> None:
    settings = replace(QUICK, fixed=[shelf(tmp_path)], stable=1.0, removable=True)
    out = tmp_path / "out"
    packed = pack([cube(6, count=4)], (20, 10, 15), settings=settings, out=out)
    assert check(packed).problems == () and verify_packing(out / "packing.json").is_valid
    low = sorted(box.vertices(one)[:, 2].min() for box, one in packed.placements)
    assert np.array(low) == pytest.approx([8.5] * packed.count, abs=0.01)  # under it: stuck
    assert packed.count >= 2 and "in the way" in packed.left_out[0].reason
    found = bodies(out / "packing.3mf")
    assert sorted(found)[-1] == "fixed 01 shelf" and sorted(found)[:2] == ["01 cube", "02 cube"]
    corners = np.concatenate([triangles.reshape(-1, 3) for triangles in found.values()])
    low, high = corners.min(axis=0), corners.max(axis=0)
    assert (low[2], high[2]) == pytest.approx((6.5, 14.5), abs=0.01)
    (obstacle,) = json.loads((out / "packing.json").read_text())["obstacles"]
    assert (obstacle["name"], obstacle["is part"]) == ("shelf", True)
    pages = write_instructions(packed, out / "instructions.html").read_text()
    assert f"step {packed.count} of {packed.count}" in pages and "shelf" not in pages
    assert pack([cube(6, count=4)], (20, 10, 15), settings=settings, out=out).searches == 2


def test_nothing_rests_on_a_fixed_part_that_may_carry_nothing(tmp_path) -> None:
    settings = replace(QUICK, fixed=[shelf(tmp_path, no_stack=True)])
    packed = pack([cube(6, count=4)], (20, 10, 15), settings=settings)
    assert packed.count == 3 and packed.height < 6.01
    assert "shelf" in packed.left_out[0].reason


def test_fixed_parts_that_are_not_possible_are_errors(tmp_path) -> None:
    for fixed, box, boxes, match in (
        (shelf(tmp_path), (19, 10, 20), None, "'shelf' reaches 1 mm beyond the box's right wall"),
        (shelf(tmp_path), (20, 10, 20), 2, "parts that are fixed need one box"),
        (shelf(tmp_path, count=2), (20, 10, 20), None, "'shelf' has one place"),
        (tmp_path / "none.stl", (20, 10, 20), None, "fixed: .*none.stl"),
    ):
        settings = replace(QUICK, fixed=[fixed], boxes=boxes)
        with pytest.raises(ArgumentError, match=match):
            pack([cube(5)], box, settings=settings)


def test_a_search_resumes_from_the_packing_in_the_folder(tmp_path, monkeypatch) -> None:
    starts: list[Packing | None] = []

    def spied(*arguments: Any) -> Packing:
        starts.append(arguments[-1].start)
        return nest(*arguments)

    monkeypatch.setattr(box_nesting, "nest", spied)
    monkeypatch.setattr("packit_sim.parts.filling.search.shelved_boxes", lambda *_: [])
    run = partial(
        pack,
        [cube(8, "cube", count=20), slab(25, 6, 10)],
        (34, 34, 24),
        settings=replace(QUICK, clearance=1.0, wall_clearance=2.0),
        out=tmp_path,
    )
    first = run()
    again = run()
    assert starts[0] is None and starts[1] is not None
    assert starts[1].problems() == [] and len(starts[1].placements) == first.count > 3
    assert again.volume >= first.volume and again.searches == 2
