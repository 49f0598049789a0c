"""The validity of packings off the grid, compared with volumes of intersections and distances."""

import json
import math
from functools import cache
from typing import Any

import manifold3d
import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim import Item, ShapeLibrary
from packit_sim.core.errors import ArgumentError
from packit_sim.engine.collision_meshes import LooseMesh
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.packings.checked_meshes import CheckedMesh
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.packings.placements import Placement

OPEN_STRIP = BoxContainer((10, 10, math.inf))


def of(mesh: trimesh.Trimesh, name: str = "item", **settings: Any) -> ItemType:
    return ItemType(name, mesh.vertices, mesh.faces, **settings)


def at(x: float, y: float, z: float, turn: Floats | None = None) -> Floats:
    pose = np.eye(4)
    pose[:3, :3] = np.eye(3) if turn is None else turn
    pose[:3, 3] = x, y, z
    return pose


def turn_of(rng: np.random.Generator) -> Floats:
    turn: Floats = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    return turn


def packed(*items: tuple[trimesh.Trimesh, Floats], clearance: float = 0.0) -> Packing:
    types = tuple(of(mesh) for mesh, _ in items)
    places = tuple(Placement.from_matrix(n, pose) for n, (_, pose) in enumerate(items))
    return Packing(types, OPEN_STRIP, places, clearance)


@cache
def solids() -> list[trimesh.Trimesh]:
    """Closed bodies: convex, with a hole, hollow with an opening, and thin."""
    box = creation.box((2, 1.5, 1))
    tube = creation.annulus(r_min=0.6, r_max=1.0, height=1.2, sections=24)
    cup = trimesh.boolean.difference(
        [
            creation.cylinder(radius=1, height=2, sections=24),
            creation.box((1.2, 1.2, 1.8)).apply_translation((0, 0, 0.4)),
        ],
        engine="manifold",
    )
    frame = trimesh.boolean.difference(
        [creation.box((2, 2, 2)), creation.box((1.7, 1.7, 3))], engine="manifold"
    )
    return [
        box,
        creation.icosphere(subdivisions=2, radius=0.5),
        tube,
        cup,
        frame,
        creation.box((2.4, 0.05, 0.8)),
    ]


def common_volume(one: trimesh.Trimesh, other: trimesh.Trimesh) -> float:
    bodies = [
        manifold3d.Manifold(manifold3d.Mesh64(mesh.vertices, np.asarray(mesh.faces, np.uint64)))
        for mesh in (one, other)
    ]
    assert all(body.status() == manifold3d.Error.NoError for body in bodies)
    return float((bodies[0] ^ bodies[1]).volume())


@pytest.mark.parametrize("seed", range(3))
def test_conflicts_are_those_of_the_intersection_of_the_solids(seed) -> None:
    """Random pairs that cross, that touch almost, that are nested and that are apart."""
    rng = np.random.default_rng(seed)
    found = {True: 0, False: 0}
    for _ in range(40):
        meshes = [solids()[n] for n in rng.integers(len(solids()), size=2)]
        poses = [at(5, 5, 5, turn_of(rng)), at(*(5 + rng.uniform(-1.6, 1.6, 3)), turn_of(rng))]
        packing = packed(*zip(meshes, poses, strict=True))
        moved = [
            mesh.copy().apply_transform(pose) for mesh, pose in zip(meshes, poses, strict=True)
        ]
        common = common_volume(*moved)
        problems = packing.problems()
        found[bool(problems)] += 1
        if problems:
            assert common > 0, (seed, problems)
        else:  # what is common lies within the tolerance of the surfaces
            assert common <= 1e-3 * min(mesh.area for mesh in meshes), seed
    assert min(found.values()) >= 8


@pytest.mark.parametrize("seed", range(2))
def test_meshes_cross_where_those_of_all_their_triangles_do(seed) -> None:
    """Pairs of any sizes near contact, drawn in by the tolerance of the pair."""
    rng = np.random.default_rng(seed)
    found = {True: 0, False: 0}
    for _ in range(150):
        types = [of(solids()[n]) for n in rng.integers(len(solids()), size=2)]
        scales = rng.uniform(0.05, 1, 2)
        unit, drawn_in = rng.choice([0.01, 1.0, 5.0], 2) * 1e-2
        meshes = [CheckedMesh(*each, unit, drawn_in) for each in zip(types, scales, strict=True)]
        whole = []
        for each, scale in zip(types, scales, strict=True):
            left = np.maximum(scale * each.extents - drawn_in, 0) / each.extents
            whole.append(LooseMesh((each.vertices - each.middle) * left / unit, each.faces))
        turn, direction = turn_of(rng), rng.normal(size=3)
        direction /= np.linalg.norm(direction) * unit
        low, high = 0.0, 4.0  # from the last place where they cross along a line
        for _ in range(20):
            middle = (low + high) / 2
            crosses = whole[0].crosses(whole[1], middle * direction, turn)
            low, high = (middle, high) if crosses else (low, middle)
        for way in (low, high, *rng.uniform(0, high, 3)):
            expected = whole[0].crosses(whole[1], way * direction, turn)
            assert meshes[0].crosses(meshes[1], turn, way * direction) == expected
            found[expected] += 1
    assert min(found.values()) >= 100


def test_a_small_item_fits_in_the_hole_of_another_but_not_in_its_solid() -> None:
    tube, ball = solids()[2], solids()[1]
    assert packed((tube, at(5, 5, 5)), (ball, at(5, 5, 5))).problems() == []
    small = ball.copy().apply_scale(0.2)
    (problem,) = packed((tube, at(5, 5, 5)), (small, at(5.8, 5, 5))).problems()
    assert problem == "item 1 ('item') lies, in part or whole, inside item 0 ('item')"
    (problem,) = packed((small, at(5.8, 5, 5)), (tube, at(5, 5, 5))).problems()
    assert problem == "item 0 ('item') lies, in part or whole, inside item 1 ('item')"


def _with_a_slit(box: trimesh.Trimesh) -> trimesh.Trimesh:
    """A box whose faces have come apart by less than a voxel: none of its parts is closed."""
    faces = box.faces
    corners = box.triangles + box.face_normals[:, None] * 1e-6
    loose = trimesh.Trimesh(
        corners.reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3), process=False
    )
    assert not loose.is_watertight
    return loose


def test_nothing_may_be_in_the_solid_of_an_open_mesh() -> None:
    """Its parts are no shells: the enclosed voxels decide."""
    box, small = _with_a_slit(creation.box((2, 2, 2))), creation.box((0.3, 0.2, 0.1))
    rng = np.random.default_rng(0)
    for _ in range(10):
        place = at(*(5 + rng.uniform(-0.7, 0.7, 3)), turn_of(rng))
        assert packed((box, at(5, 5, 5)), (small, place)).problems() == [
            "item 1 ('item') lies, in part or whole, inside item 0 ('item')"
        ]
    outside = at(5, 5, 6.06)
    assert packed((box, at(5, 5, 5)), (small, outside)).problems() == []


def test_a_mesh_with_a_mouth_may_hold_another() -> None:
    box = creation.box((2, 2, 2))
    mouth = box.submesh([np.flatnonzero(box.face_normals[:, 2] < 0.5)], append=True)
    ball = solids()[1]
    assert packed((mouth, at(5, 5, 5)), (ball, at(5, 5, 5))).problems() == []


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(
    ("overlap", "valid"), [(-1e-3, True), (0, True), (9e-4, True), (2e-3, False)]
)
def test_items_may_touch_within_the_tolerance(overlap, valid, turned) -> None:
    """In a container of 10, two items of 2 have the tolerance 1e-3."""
    cube = creation.box((2, 2, 2))
    turn = turn_of(np.random.default_rng(3)) if turned else np.eye(3)
    side = turn @ (2 - overlap, 0.3, 0.2)
    packing = packed((cube, at(4, 4, 4, turn)), (cube, at(*(np.array((4, 4, 4)) + side), turn)))
    assert (packing.problems() == []) == valid


def test_surfaces_in_contact_are_never_in_the_voxels_of_the_other() -> None:
    """Bodies of any shape at a gap of 0: no voxel is enclosed that the tolerance reaches.

    The same for their triangles alone, which are no shells.
    """
    rng = np.random.default_rng(5)
    touching = 0
    for mesh in solids() * 3:
        turn, other_turn = turn_of(rng), turn_of(rng)
        ball = solids()[1]
        triangle = mesh.triangles[rng.integers(len(mesh.faces))] @ turn.T
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        points = ball.vertices @ other_turn.T
        shift = triangle.mean(axis=0) - points[(points @ normal).argmin()]
        poses = at(5, 5, 5, turn), at(*(5 + shift), other_turn)
        bodies = [m.copy().apply_transform(p) for m, p in zip((mesh, ball), poses, strict=True)]
        if common_volume(*bodies) < 1e-9:
            touching += 1
            assert packed((mesh, poses[0]), (ball, poses[1])).problems() == []
            assert packed((_with_a_slit(mesh), poses[0]), (ball, poses[1])).problems() == []
    assert touching >= 9


def brute_distance(one: Floats, other: Floats) -> float:
    """The distance of two surfaces (n, 3, 3) that don't cross, by all edges and all corners."""
    best = math.inf
    for a, b in ((one, other), (other, one)):
        points = a.reshape(-1, 3)
        for triangle in b:
            nearest = trimesh.triangles.closest_point(
                np.repeat(triangle[None], len(points), 0), points
            )
            best = min(best, float(np.linalg.norm(nearest - points, axis=1).min()))
    edges = [np.stack([s, np.roll(s, -1, axis=1)], axis=2).reshape(-1, 2, 3) for s in (one, other)]
    p, u = edges[0][:, None, 0], edges[0][:, None, 1] - edges[0][:, None, 0]
    q, v = edges[1][None, :, 0], edges[1][None, :, 1] - edges[1][None, :, 0]
    w = p - q
    dot = lambda x, y: (x * y).sum(axis=-1)  # noqa: E731
    a, b, c, d, e = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (b * e - c * d) / (a * c - b * b), (a * e - b * d) / (a * c - b * b)
        inner = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
        gaps = np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
    return min(best, float(gaps[inner].min(initial=math.inf)))


@pytest.mark.parametrize("unit", [1e-2, 1.0, 1e5])
def test_distances_are_those_of_all_pairs_of_triangles(unit) -> None:
    rng = np.random.default_rng(7)
    bodies = [mesh for mesh in solids() if len(mesh.faces) < 150]
    for _ in range(8):
        one, other = (bodies[n] for n in rng.integers(len(bodies), size=2))
        turn, shift = turn_of(rng), rng.normal(size=3)
        shift *= (3 + rng.random()) / np.linalg.norm(shift)
        meshes = [LooseMesh(mesh.vertices * unit, np.array(mesh.faces)) for mesh in (one, other)]
        expected = brute_distance(np.array(one.triangles), other.triangles @ turn.T + shift)
        found = meshes[0].distance(meshes[1], shift * unit, turn)
        assert found == pytest.approx(expected * unit, rel=1e-9)


@pytest.mark.parametrize(
    ("mesh", "pose", "gap"),
    [
        (creation.box((2, 2, 2)), at(7.5, 5, 5), 0.5),
        (creation.box((2, 2, 2)), at(7.3, 7.4, 5), 0.5),
        (creation.icosphere(subdivisions=1, radius=1), at(5, 5, 7.25), 0.25),
        (
            creation.box((1, 1, 1)),
            at(
                6 + 0.1 + math.sqrt(0.5),
                5,
                5,
                trimesh.transformations.rotation_matrix(math.pi / 4, (0, 0, 1))[:3, :3],
            ),
            0.1,
        ),
    ],
)
def test_a_clearance_is_a_distance_of_surfaces(mesh, pose, gap) -> None:
    cube = creation.box((2, 2, 2))
    for clearance in (0.5 * gap, 0.999 * gap, gap):
        assert packed((cube, at(5, 5, 5)), (mesh, pose), clearance=clearance).problems() == []
    (problem,) = packed((cube, at(5, 5, 5)), (mesh, pose), clearance=gap + 0.01).problems()
    assert problem == (
        f"item 1 ('item') is {gap:.3g} from item 0 ('item'): "
        f"less than the clearance of {gap + 0.01:.3g}"
    )
    touching = packed((cube, at(5, 5, 5)), (cube, at(7, 5, 5)), clearance=gap)
    assert "is 0 from item 0 ('item'): less than" in touching.problems()[0]


def test_a_clearance_counts_inside_a_hole_too() -> None:
    tube, ball = solids()[2], solids()[1]
    gap = brute_distance(np.array(tube.triangles), np.array(ball.triangles))
    assert 0.05 < gap < 0.11
    packing = lambda g: packed((tube, at(5, 5, 5)), (ball, at(5, 5, 5)), clearance=g)  # noqa: E731
    assert packing(gap).problems() == []
    assert len(packing(gap + 0.01).problems()) == 1


def test_walls_count_and_a_strip_has_no_top() -> None:
    cube = creation.box((2, 2, 2))
    assert packed((cube, at(1, 1, 100))).problems() == []
    for place, wall in (
        ((0.9, 1, 1), "left"),
        ((9.1, 1, 1), "right"),
        ((1, 0.9, 1), "back"),
        ((1, 9.1, 1), "front"),
        ((1, 1, 0.9), "bottom"),
    ):
        assert packed((cube, at(*place))).problems() == [
            f"item 0 ('item') reaches 0.1 beyond the box's {wall} wall"
        ]
    assert packed((cube, at(1 - 9e-4, 1, 1))).problems() == []
    box = Packing(
        (of(cube),),
        BoxContainer((2, 2, 2)),
        (Placement.from_matrix(0, at(1, 1, 1.1)),),
        objective="knapsack",
    )
    assert box.problems() == ["item 0 ('item') reaches 0.1 beyond the box's top wall"]


def test_items_in_different_boxes_never_conflict() -> None:
    cube = of(creation.box((2, 2, 2)), demand=3)
    places = tuple(Placement.from_matrix(0, at(1, 1, 1), box) for box in (0, 1, 1))
    packing = Packing((cube,), BoxContainer((2, 2, 2)), places, objective="bins")
    assert packing.problems() == ["item 2 ('item') crosses item 1 ('item')"]
    assert (packing.boxes, packing.left_out) == (2, (0,))
    assert packing.density == pytest.approx(1.5)


def test_many_detailed_items_are_checked_at_once() -> None:
    """A row of library shapes, boxes touching, with a clearance; then one is moved into another."""
    library = ShapeLibrary.open("everyday")
    shapes = [library[id] for id in library.ids[::60]][:10]
    types = tuple(ItemType.from_item(Item(shape, 0.02)) for shape in shapes)
    places, x = [], 0.0
    for n, kind in enumerate(types):
        places.append(Placement.from_matrix(n, at(*(np.array((x, 0, 0)) - kind.low))))
        x += kind.extents[0] + 0.01
    packing = Packing(types, BoxContainer((x, 1, 1)), tuple(places), 0.01, "knapsack")
    assert packing.problems() == []
    assert (
        len(Packing(types, packing.container, packing.placements, 0.02, "knapsack").problems()) > 0
    )
    close = (*places[:-1], Placement(len(types) - 1, places[0].pose))
    assert Packing(types, packing.container, close, 0.0, "knapsack").problems() != []


def test_a_packing_is_written_and_verified(tmp_path) -> None:
    cube = creation.box((2, 2, 2))
    cube.export(tmp_path / "cube.stl")
    ball = creation.icosphere(subdivisions=1, radius=1 / 3)
    types = ItemType.from_file(tmp_path / "cube.stl", 2), of(ball, "ball"), of(ball, "unused")
    places = [
        Placement.from_matrix(0, at(1, 1, 1)),
        Placement.from_matrix(0, at(3, 1, 1)),
        Placement.from_matrix(1, at(1, 1, 2.4)),
    ]
    packing = Packing(types, OPEN_STRIP, tuple(places), 0.0)
    packing.write(tmp_path / "packing.json")
    content = json.loads((tmp_path / "packing.json").read_text())
    assert content["box"] == [10, 10, None]
    assert content["items"][0]["mesh"] == "cube.stl"
    (written,) = (tmp_path / "packing-meshes").iterdir()
    again = ItemType.from_file(written)
    assert np.array_equal(np.sort(again.vertices, axis=0), np.sort(types[1].vertices, axis=0))
    report = verify_packing(tmp_path / "packing.json")
    assert report.is_valid, report.problems
    assert report.volume == pytest.approx(packing.volume)
    assert report.density == pytest.approx(packing.density)
    assert packing.height == pytest.approx(2.4 + 1 / 3, rel=1e-2)
    Packing(types, OPEN_STRIP, tuple(places), 0.1).write(tmp_path / "packing.json")
    sentences = [problem.sentence for problem in verify_packing(tmp_path / "packing.json").problems]
    assert len(sentences) == 2 and "clearance of 0.1" in sentences[0]


def test_a_mesh_in_another_folder_is_written_next_to_the_packing(tmp_path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "out").mkdir()
    creation.box((2, 2, 2)).export(tmp_path / "meshes" / "cube.stl")
    kind = ItemType.from_file(tmp_path / "meshes" / "cube.stl")
    Packing((kind,), OPEN_STRIP, (Placement.from_matrix(0, at(1, 1, 1)),)).write(
        tmp_path / "out" / "a.json"
    )
    (tmp_path / "meshes" / "cube.stl").unlink()
    assert verify_packing(tmp_path / "out" / "a.json").is_valid


@pytest.mark.parametrize("clearance", [-1, math.nan, math.inf])
def test_a_clearance_that_is_not_possible_is_refused(clearance) -> None:
    with pytest.raises(ArgumentError, match=r"clearance .* is not possible: at least 0, finite"):
        packed((solids()[0], at(5, 5, 5)), clearance=clearance)
