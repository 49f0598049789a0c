"""Distances: along z apart from x and y, from each wall, and of each part."""

import json
import math
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from trimesh import creation

from packit_sim import (
    BoxContainer,
    BoxType,
    CylinderContainer,
    ItemType,
    MeshContainer,
    NestSettings,
    PackedParts,
    Packing,
    PackSettings,
    Part,
    WallClearance,
    nest,
    pack,
)
from packit_sim.core.errors import ArgumentError, PackFormatError
from packit_sim.geometry.motions import Motion
from packit_sim.parts import check, summary
from packit_sim.parts.filling.box_nesting import BoxNesting
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.filling.stretching import StretchedTypes
from packit_sim.parts.nesting.balance import Balance
from packit_sim.parts.nesting.search_frames import searched_rotations
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.rotation_sets import matrices
from packit_sim.parts.reading.distances import read_wall_clearance
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.results import exports
from packit_sim.parts.results.verification import verify_record

QUICK = PackSettings(workers=1, iterations=5)
BALL = creation.icosphere(subdivisions=1, radius=10)
BLOCK = creation.box((10, 10, 10))


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))


def of(mesh: trimesh.Trimesh, name: str = "part", **settings) -> ItemType:
    return ItemType(name, mesh.vertices, mesh.faces, **settings)


def two(shift: tuple[float, float, float], mesh: trimesh.Trimesh = BALL) -> Packing:
    """Two of a mesh, with a clearance of 2 along x and y, and 6 along z."""
    places = [Placement(0), Placement(0)]
    start = np.array((50.0, 50.0, 50.0))
    places = [
        replace(p, pose=p.pose.shifted(start + n * np.array(shift))) for n, p in enumerate(places)
    ]
    box = BoxContainer((200, 200, 200))
    return Packing((of(mesh),), box, tuple(places), 2.0, "knapsack", clearance_z=6.0)


def oracle(packed: PackedParts) -> float:
    """The least distance of two parts with z divided by three, by points of their surfaces."""
    meshes = []
    for packing, one in packed.placements:
        vertices = packing.vertices(one) * (1, 1, 1 / 3)
        mesh = trimesh.Trimesh(vertices, packing.types[one.type].faces, process=False)
        meshes.append(
            np.concatenate((trimesh.sample.sample_surface(mesh, 3000, seed=0)[0], vertices))
        )
    trees = [cKDTree(points) for points in meshes]
    return min(
        float(tree.query(points)[0].min()) for n, tree in enumerate(trees) for points in meshes[:n]
    )


@pytest.mark.parametrize(
    ("mesh", "shift", "is_valid"),
    [
        (BLOCK, (12.01, 0, 0), True),
        (BLOCK, (11.9, 0, 0), False),
        (BLOCK, (0, 0, 16.01), True),
        (BLOCK, (0, 0, 15.9), False),
        # corners: ((x - 10) / 2)² + ((z - 10) / 6)² must be at least 1
        (BLOCK, (11.5, 0, 10 + 6 * 0.67), True),
        (BLOCK, (11.5, 0, 10 + 6 * 0.65), False),
    ],
)
def test_an_ellipsoid_decides_between_the_two_distances(mesh, shift, is_valid: bool) -> None:
    assert bool(two(shift, mesh).problems()) is not is_valid


def test_lengths_along_z_are_multiplied_before_a_distance_is_measured() -> None:
    at = [(0.0, 0.0, 0.0), (0.0, 0.0, 13.0)]
    one, other = (CheckedItem("a", of(BLOCK), Placement(0, Motion.shift(x)), 200.0) for x in at)
    assert one.stretched_distance(other, 1 / 3) == pytest.approx(1)
    assert one.stretched_distance(other, 2) == pytest.approx(6)


def test_the_check_multiplies_lengths_along_z() -> None:
    settings = PackSettings(clearance=2.0, clearance_z=6.0, unit="mm")
    box = BoxType((50, 50, 60))
    task = prepared_task([Part("block", BLOCK, count=2)], [box], "volume", settings)
    places = tuple(Placement(0, Motion.shift((20.0, 20.0, z))) for z in (10.0, 27.0))
    packing = Packing(task.types, task.container(box), places, 2.0, "knapsack", clearance_z=6.0)
    found = check(PackedParts(task, (packing,)))
    assert not found.problems
    assert found.distance == pytest.approx(7 / 3)


def test_the_distance_along_z_is_kept_by_every_program(tmp_path: Path) -> None:
    parts = [Part("ball", BALL, count=9), Part("bar", creation.box((30, 8, 8)), count=9)]
    settings = replace(QUICK, clearance=2.0, clearance_z=6.0)
    packed = pack(parts, (45, 45, 60), settings=settings, out=tmp_path)
    found = check(packed)
    assert not found.problems
    assert all(not each.problems() for each in packed.packings)
    assert found.distance is not None and 1.999999 <= found.distance <= oracle(packed)
    assert summary(packed, found)["smallest distance"].endswith(", with z times 0.3333")
    file = tmp_path / "packing.json"
    assert not verify_record(file).problems
    everywhere = pack(parts, (45, 45, 60), settings=replace(QUICK, clearance=6.0))
    assert packed.count > everywhere.count
    for name, value in (("clearance", 2.5), ("clearance z", 7.0), ("clearance z", 1e9)):
        record = json.loads(file.read_text())
        for place in (record, record["request"]):
            place[name] = value
        changed = tmp_path / "changed.json"
        changed.write_text(json.dumps(record))
        try:
            assert verify_record(changed).problems
        except PackFormatError as error:
            assert "both above 0" in str(error)  # noqa: PT017
    resumed = pack(parts, (45, 45, 60), settings=replace(settings, iterations=1), out=tmp_path)
    assert resumed.searches == 2
    assert resumed.count >= packed.count


def test_the_lowest_packing_keeps_the_distance_along_z() -> None:
    parts = [Part("bar", creation.box((30, 8, 8)), count=6)]
    low = pack(parts, (50, 50, 90), "height", settings=replace(QUICK, clearance=2, clearance_z=1))
    high = pack(parts, (50, 50, 90), "height", settings=replace(QUICK, clearance=2, clearance_z=9))
    assert low.count == high.count == 6
    assert low.height < high.height
    assert not check(low).problems + check(high).problems


@pytest.mark.parametrize("rotations", ["fixed", "yaw-6", "flip-3", "axis-4", "cube", "free"])
def test_stretched_types_have_all_rotations_once(rotations: str) -> None:
    own = of(creation.capsule(height=20, radius=5), rotations=rotations, demand=2)
    stretched = StretchedTypes([own], 0.4)
    shift = np.array((1.0, 2.0, 3.0))
    placements = [
        stretched.unstretched(Placement(n, Motion(turn, shift)))
        for n, each in enumerate(stretched.types)
        for turn in matrices(each.rotations)
    ]
    turns = np.array([one.pose.rotation for one in placements])
    known = searched_rotations(own)
    errors = np.abs(turns[:, None] - known).max(axis=(2, 3))
    assert sorted(errors.argmin(axis=1)) == list(range(len(known)))
    assert errors.min(axis=1).max() < 1e-9
    for one in placements:
        back = stretched.stretched(one)
        assert back is not None
        scaled = stretched.types[back.type].vertices @ back.pose.rotation.T
        true = own.vertices @ one.pose.rotation.T * (1, 1, 0.4)
        assert np.allclose(scaled, true, atol=1e-9)
        assert np.allclose(back.pose.translation, shift, atol=1e-9)


def test_a_balance_is_the_same_in_stretched_space() -> None:
    types = [of(creation.box(sides), rotations="axis-4") for sides in ((1, 2, 3), (4, 5, 6))]
    stretched = StretchedTypes(types, 0.4)
    own = Balance([2.0, 7.0], [(0.1, 0.2, 0.3), (0.4, 0.5, 0.6)], (0.05, 0.05))
    found = stretched.balance(own)
    assert found.reach == own.reach
    assert list(found.weights) == [own.weights[n] for n in stretched.numbers]
    for n, centre in enumerate(found.centres):
        one = stretched.unstretched(Placement(n))
        true = own.centres[one.type] @ one.pose.rotation.T * (1, 1, 0.4)
        assert centre == pytest.approx(true.tolist())


def test_each_wall_has_its_distance(tmp_path: Path) -> None:
    walls = WallClearance(sides=5, floor=2)
    block = Part("block", BLOCK, count=9, rotations="fixed")
    for box, most in (((20, 20, 12), 1), ((19.9, 20, 12), 0), ((20, 20, 11.9), 0)):
        if most:
            packed = pack([block], box, settings=replace(QUICK, wall_clearance=walls), out=tmp_path)
            assert packed.count == 1 and not check(packed).problems
        else:
            with pytest.raises(
                ArgumentError, match="5 mm at the sides, 2 mm at the floor, 0 mm at"
            ):
                pack([block], box, settings=replace(QUICK, wall_clearance=walls))
    record = json.loads((tmp_path / "packing.json").read_text())
    assert record["wall clearance"] == {"sides": 5, "floor": 2, "top": 0.0}
    assert not verify_record(tmp_path / "packing.json").problems
    for place in (record, record["request"]):
        place["wall clearance"] = {"sides": 5, "floor": 0.0, "top": 0.5}
    changed = tmp_path / "changed.json"
    changed.write_text(json.dumps(record))
    (problem,) = verify_record(changed).problems
    assert "is 0 mm from the box's top wall: less than the clearance of 0.5 mm" in problem.sentence


@pytest.mark.parametrize("name", ["sides", "floor", "top"])
def test_a_distance_from_a_wall_is_within_its_range(name: str) -> None:
    for wrong in (-1.0, math.nan, math.inf, 1e300):
        with pytest.raises(ArgumentError, match=f"the wall clearance {name}"):
            WallClearance(**{name: wrong})


def test_the_search_has_the_space_inside_the_walls() -> None:
    settings = replace(QUICK, wall_clearance=WallClearance(sides=5, floor=2, top=1))
    task = prepared_task([Part("block", BLOCK)], "40x50x60mm", "volume", settings)
    nesting = BoxNesting(task, threading.Event())
    (box,) = task.boxes
    assert nesting.inner(box).size == pytest.approx((30, 40, 57), abs=0.02)
    assert nesting.inner(box, 20.0).size == pytest.approx((30, 40, 17), abs=0.02)


def test_walls_of_other_containers() -> None:
    settings = replace(QUICK, wall_clearance=WallClearance(sides=3, top=1))
    parts = [Part("ball", BALL, count=9)]
    packed = pack(parts, CylinderContainer(60, 42), settings=settings)
    assert packed.count >= 4 and not check(packed).problems
    for packing, one in packed.placements:
        vertices = packing.vertices(one)
        assert np.hypot(*(vertices[:, :2] - 30).T).max() <= 27 + 1e-6
        assert vertices[:, 2].max() <= 41 + 1e-6
    mesh = MeshContainer(of(creation.icosphere(radius=50)))
    with pytest.raises(ArgumentError, match="is a mesh: choose one distance"):
        pack(parts, mesh, settings=settings)


def test_texts_of_wall_clearances() -> None:
    assert read_wall_clearance("5mm", "mm") == 5
    assert read_wall_clearance("sides=5mm, floor=0.2cm", "mm") == WallClearance(5, 2)
    for wrong in ("sides=5mm,sides=2mm", "left=5mm", "sides=", "sides=5mm;floor=2mm", "=5mm"):
        with pytest.raises(ArgumentError):
            read_wall_clearance(wrong, "mm")
    for distances in ((1.0, 0.0), (0.0, 1.0), (1.0, 21.0), (1.0, -1.0), (21.0, 1.0)):
        with pytest.raises(ArgumentError, match="clearance_z"):
            PackSettings(clearance=distances[0], clearance_z=distances[1])


@pytest.mark.parametrize("box", [(60, 60, 45), CylinderContainer(70, 45)])
def test_a_part_keeps_its_own_distance(box, tmp_path: Path) -> None:
    parts = [
        Part("ball", BALL, count=8),
        Part("hot", BLOCK, 2, clearance=6, unit_cm=0.1, priority=1),
    ]
    settings = replace(QUICK, clearance=1.0)
    packed = pack(parts, box, settings=settings, out=tmp_path)
    found = check(packed)
    assert packed.counts[1] == 2 and packed.counts[0] >= 2
    assert not found.problems
    assert found.distance is not None and found.distance < 3
    assert not packed.packings[0].problems()
    file = tmp_path / "packing.json"
    assert not verify_record(file).problems
    record = json.loads(file.read_text())
    assert {one["name"]: one.get("clearance") for one in record["items"]} == {
        "ball": None,
        "hot": pytest.approx(6),
    }
    del next(one for one in record["items"] if one["name"] == "hot")["clearance"]
    changed = tmp_path / "changed.json"
    changed.write_text(json.dumps(record))
    (problem,) = verify_record(changed).problems
    assert "the clearance of 'hot' is said to be None" in problem.sentence


def test_nest_keeps_own_distances_in_all_objectives(tmp_path: Path) -> None:
    types = [of(BALL, "ball", demand=4), of(BLOCK, "hot", demand=2, clearance=6.0)]
    settings = NestSettings(workers=1, iterations=3)
    for objective, box in (("strip", (45, 45, np.inf)), ("bins", (45, 45, 45))):
        packing = nest(types, box, objective, settings=settings)
        assert not packing.problems()
        packing.write(tmp_path / "own.json")
        assert verify_packing(tmp_path / "own.json").is_valid
        again = Packing.read(tmp_path / "own.json")
        assert [each.clearance for each in again.types] == [None, 6.0]
    hot = replace(packing, types=(types[0].changed(clearance=30.0), types[1]))
    assert any("less than the clearance of 30" in each for each in hot.problems())


def test_lists_of_parts_have_distances(tmp_path: Path) -> None:
    BLOCK.export(tmp_path / "a.stl")
    (tmp_path / "list.csv").write_text("file,Clearance\na.stl,2mm\na.stl,0.5\na.stl,\n")
    parts = find_parts([tmp_path / "list.csv"]).parts
    assert [each.clearance for each in parts] == [2.0, 0.5, None]
    (tmp_path / "list.csv").write_text("file;clearance;unit\na.stl;2,5mm;cm\n")
    assert find_parts([tmp_path / "list.csv"]).parts[0].clearance == pytest.approx(0.25)
    (tmp_path / "list.csv").write_text("file,clearance\na.stl,wide\n")
    with pytest.raises(ArgumentError, match="clearance: 'wide' is not a length"):
        find_parts([tmp_path / "list.csv"])
    (tmp_path / "list.csv").write_text("file,clearance (mm)\na.stl,2\n")
    with pytest.raises(ArgumentError, match="units are in its cells"):
        find_parts([tmp_path / "list.csv"])
