"""Types of items, sets of rotations, containers and packings off the grid."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim import Item, Shape
from packit_sim.core.errors import ArgumentError, MeshError
from packit_sim.geometry import rotations
from packit_sim.geometry.motions import IDENTITY, Motion
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.rotation_sets import matrices

BOX = creation.box((1, 2, 3))


def kind(**settings: Any) -> ItemType:
    return ItemType("box", **{"vertices": BOX.vertices, "faces": BOX.faces, **settings})


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("fixed", 1),
        ("yaw-1", 1),
        ("yaw-4", 4),
        ("yaw-360", 360),
        ("axis-1", 1),
        ("axis-2", 4),
        ("axis-4", 10),
        ("axis-8", 22),
        ("cube", 24),
    ],
)
def test_a_set_of_rotations_holds_each_once(name, count) -> None:
    turns = matrices(name)
    assert turns.shape == (count, 3, 3)
    assert np.array_equal(turns[0], np.eye(3))
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), atol=1e-15)
    assert np.allclose(np.linalg.det(turns), 1)
    apart = np.abs(turns[:, None] - turns).max(axis=(2, 3))
    assert apart[~np.eye(count, dtype=bool)].min(initial=1) > 1e-3
    if name in ("yaw-4", "axis-2", "axis-4", "cube"):
        assert set(np.unique(turns)) <= {-1.0, 0.0, 1.0}
    if name.startswith("yaw"):
        assert np.array_equal(turns[:, 2], np.tile((0.0, 0.0, 1.0), (count, 1)))


@pytest.mark.parametrize("name", ["", "yaw", "yaw-0", "axis-361", "axis--4", "cube-4", "Fixed", 4])
def test_unknown_rotations_are_refused(name) -> None:
    with pytest.raises(ArgumentError, match=r"choose from fixed, yaw-N, flip-N, axis-N .*1 to 360"):
        kind(rotations=name)
    with pytest.raises(ArgumentError, match="choose from fixed"):
        matrices(name)


def test_all_rotations_are_no_list() -> None:
    assert kind(rotations="free").rotations == "free"
    with pytest.raises(ArgumentError, match="can't be listed"):
        matrices("free")


def test_a_type_knows_its_mesh() -> None:
    one = kind(demand=3, rotations="axis-4", value=2.0)
    assert one.volume == pytest.approx(6)
    assert one.extents.tolist() == [1, 2, 3]
    assert (one.low.tolist(), one.high.tolist()) == ([-0.5, -1, -1.5], [0.5, 1, 1.5])
    assert repr(one) == "ItemType('box', 12 triangles, demand=3, rotations='axis-4')"
    with pytest.raises(ValueError, match="read-only"):
        one.vertices[0, 0] = 1


def test_only_what_adds_nothing_to_the_surface_is_dropped() -> None:
    vertices = np.concatenate([BOX.vertices + 0.1, BOX.vertices + 0.1, [[math.nan] * 3]])
    faces = np.concatenate([BOX.faces + 8, BOX.faces[:3], [[0, 0, 1], [2, 10, 3]]])
    one = kind(vertices=vertices, faces=faces)
    assert one.vertices.shape == (8, 3) and one.faces.shape == (12, 3)
    rows = {tuple(row) for row in (BOX.vertices + 0.1).tolist()}
    assert {tuple(row) for row in one.vertices.tolist()} == rows
    assert one.volume == pytest.approx(6)


def test_types_of_files_and_of_items(tmp_path: Path) -> None:
    BOX.export(tmp_path / "box.stl")
    one = ItemType.from_file(tmp_path / "box.stl", 2, "fixed", 1.5)
    assert (one.name, one.demand, one.rotations, one.value) == ("box.stl", 2, "fixed", 1.5)
    assert one.file == tmp_path / "box.stl"
    ring = trimesh.creation.torus(1, 0.4)
    item = Item(Shape.from_mesh(ring, "ring"), 0.5, 4)
    other = ItemType.from_item(item, rotations="yaw-8")
    assert (other.name, other.rotations, other.file) == ("ring", "yaw-8", None)
    assert other.extents == pytest.approx(item.extents)
    assert other.volume == item.volume
    assert ItemType("ring", other.vertices, other.faces).volume == pytest.approx(item.volume)
    with pytest.raises(MeshError, match=r"absent\.stl: .*No such file"):
        ItemType.from_file(tmp_path / "absent.stl")


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"demand": 0}, ArgumentError, r"'box': a demand of 0 is not possible: a whole number of"),
        ({"demand": 1.5}, ArgumentError, "demand of 1.5"),
        ({"demand": -2}, ArgumentError, "demand of -2"),
        ({"value": -1}, ArgumentError, "a value of -1 is not possible: at least 0"),
        ({"value": math.nan}, ArgumentError, "a value of nan"),
        ({"value": math.inf}, ArgumentError, "a value of inf"),
        ({"vertices": BOX.vertices * (math.nan, 1, 1)}, MeshError, "'box': .* are not finite"),
        ({"vertices": BOX.vertices * (0, 1, 1)}, MeshError, "'box': .* no extent along x"),
        ({"vertices": BOX.vertices * 1e40}, MeshError, "'box': its lengths are not possible"),
        ({"vertices": [], "faces": []}, MeshError, "'box': the mesh is empty"),
        ({"vertices": [[1, 2]]}, MeshError, "'box': no triangle mesh"),
        ({"vertices": "abc"}, MeshError, "'box': no triangle mesh"),
        ({"faces": BOX.faces + 5}, MeshError, "'box': triangles refer to vertices 5 to 12"),
    ],
)
def test_a_type_that_is_not_possible_is_refused(settings, error, message) -> None:
    with pytest.raises(error, match=message):
        kind(**settings)


def test_a_box_and_a_strip() -> None:
    box, strip = BoxContainer((2, 3, 4)), BoxContainer((2, 3, math.inf))
    assert (box.is_strip, box.base, box.volume, box.longest) == (False, 6, 24, 4)
    assert (strip.is_strip, strip.base, strip.volume, strip.longest) == (True, 6, math.inf, 3)
    points = np.array(((-1.0, 1, 9), (2, 5, 1)))
    depths = dict(box.beyond(points))
    assert depths == {
        "the box's left wall": 1,
        "the box's right wall": 0,
        "the box's back wall": -1,
        "the box's front wall": 2,
        "the box's bottom wall": -1,
        "the box's top wall": 5,
    }
    assert dict(strip.beyond(points)) == depths | {"the box's top wall": -math.inf}


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((1, 2), r"size \(1, 2\) is not possible: three numbers"),
        (3, "size 3 is not possible"),
        ("abc", "size 'abc' is not possible"),
        ((1, 2, 0), "the side 0.0 along z is not possible: .* or infinite for a strip"),
        ((1, 2, -math.inf), "the side -inf along z"),
        ((math.inf, 2, 1), "the side inf along x is not possible: 1e-30 to"),
        ((1, math.nan, 1), "the side nan along y"),
        ((1, -1, 1), "the side -1.0 along y"),
    ],
)
def test_a_container_that_is_not_possible_is_refused(size, message) -> None:
    with pytest.raises(ArgumentError, match=message):
        BoxContainer(size)


def moved(z: float) -> Motion:
    return Motion.shift((0.5, 1, z))


def test_a_packing_is_measured() -> None:
    types = kind(demand=2), kind(demand=3)
    places = Placement(0, moved(1.5)), Placement(0, moved(5.5))
    strip = Packing(types, BoxContainer((1, 2, math.inf)), places)
    assert (strip.height, strip.boxes, strip.left_out) == (7, 1, (0, 3))
    assert strip.volume == pytest.approx(12)
    assert strip.density == pytest.approx(12 / 14)
    assert np.array_equal(strip.vertices(places[1]), types[0].vertices + np.array((0.5, 1, 5.5)))
    box = Packing(types, BoxContainer((1, 2, 10)), places, objective="knapsack")
    assert box.density == pytest.approx(12 / 20)
    empty = Packing(types, BoxContainer((1, 2, 10)), ())
    assert (empty.height, empty.density, empty.boxes, empty.left_out) == (0, 0, 0, (2, 3))


def test_a_changed_type_has_the_same_mesh() -> None:
    one = kind()
    volume, digest = one.volume, one.digest
    new = one.changed(3, "yaw-4", 2.5)
    assert (new.demand, new.rotations, new.value, new.name) == (3, "yaw-4", 2.5, one.name)
    assert new.vertices is one.vertices and new.faces is one.faces
    assert (vars(new)["volume"], vars(new)["digest"]) == (volume, digest)
    assert (one.demand, one.value) == (1, None) and one.changed().rotations == one.rotations
    for settings in ({"demand": 0}, {"rotations": "spin"}, {"value": -1.0}):
        with pytest.raises(ArgumentError, match=r"not possible|spin"):
            one.changed(**settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"objective": "least"}, "objective 'least' is not known: choose from strip, knapsack"),
        ({"objective": "bins"}, "objective 'bins' needs a box with a height"),
        ({"clearance": -0.1}, "clearance -0.1 is not possible: at least 0"),
        ({"placements": (Placement(1),)}, "placement 0 is of type 1: .* types 0 to 0"),
        ({"placements": (Placement(0, box=-1),)}, "placement 0 is in box -1"),
    ],
)
def test_a_packing_that_is_not_possible_is_refused(settings, message) -> None:
    whole = {"types": (kind(),), "container": BoxContainer((1, 1, math.inf)), "placements": ()}
    with pytest.raises(ArgumentError, match=message):
        Packing(**{**whole, **settings})


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3), r"shape \(3, 3\)"),
        (np.eye(4) * math.nan, "is not finite"),
        (np.diag([1, 1, 1, 2]), "last row"),
        (np.diag([1, 1, -1, 1]), "mirrors the mesh"),
        (np.diag([1, 2, 1, 1]), "scales its axes unlike"),
        (np.diag([0, 0, 0, 1]), "its scale is 0"),
    ],
)
def test_a_pose_that_is_not_possible_is_refused(pose, message) -> None:
    with pytest.raises(ArgumentError, match=f"the pose of an item of type 0 .*{message}"):
        Placement.from_matrix(0, pose)


def test_a_placement_has_a_motion() -> None:
    with pytest.raises(ArgumentError, match="of type ndarray: it must be a Motion"):
        Placement(0, np.eye(4))
    with pytest.raises(ArgumentError, match="the pose of an item of type 0 is not finite"):
        Placement(0, Motion.shift((math.nan, 0, 0)))
    with pytest.raises(ArgumentError, match="item type 0: scale 0 is not possible: above 0"):
        Placement(0, IDENTITY, scale=0)


def test_a_matrix_of_a_file_may_have_a_scale() -> None:
    turn = rotations.MATRICES[7]
    matrix = np.eye(4)
    matrix[:3] = np.column_stack((2.5 * turn, (1, 2, 3)))
    placement = Placement.from_matrix(0, matrix)
    assert placement.scale == pytest.approx(2.5) and np.allclose(placement.pose.rotation, turn)
    assert np.allclose(placement.matrix, matrix)
    assert np.allclose(placement.apply(np.ones(3)), turn @ np.full(3, 2.5) + (1, 2, 3))
    matrix[:3, 3] = 4, 5, 6
    assert placement.pose.translation.tolist() == [1, 2, 3]


def test_a_type_may_be_given_its_volume() -> None:
    mesh = trimesh.creation.box((1, 2, 3))
    assert ItemType("a", mesh.vertices, mesh.faces).volume == pytest.approx(6)
    known = ItemType("a", mesh.vertices, mesh.faces, known_volume=5.5)
    assert known.volume == known.changed(demand=2).volume == 5.5


def test_a_matrix_is_a_placement_in_the_first_container_unless_it_says_so() -> None:
    matrix = np.diag((2.0, 2, 2, 1))
    own = Placement.from_matrix(3, matrix)
    assert (own.type, own.box) == (3, 0) and own.scale == pytest.approx(2.0)
    assert Placement.from_matrix(3, matrix, 1).box == 1
