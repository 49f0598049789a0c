"""Containers that are no boxes: cylinders and closed meshes. The judge here is numpy alone."""

import importlib
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
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
from packit_sim.core.extras import MissingPackageError
from packit_sim.geometry.arrays import Floats
from packit_sim.parts import check, film, removable, summary, write_instructions
from packit_sim.parts.filling.convex_fits import convex_space
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.nesting.rounds import Problems
from packit_sim.parts.nesting.settings import SearchSettings
from packit_sim.parts.packings import outlines
from packit_sim.parts.packings.outlines import outline, outline_body
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.files import ReadSettings
from packit_sim.parts.results import exports
from packit_sim.parts.results.verification import verify_record
from packit_sim.parts.workbench.scenes import box_scenes

QUICK = PackSettings(workers=1, iterations=5)

FEW = NestSettings(workers=1, iterations=6)

BEYOND = 0.01
"""Depth in mm to which parts may be in a wall here; the tolerance of the smallest is 0.01."""

Block = tuple[tuple[float, float, float], tuple[float, float, float]]

NOTCH: Block = ((100, 60, 0), (200, 150, 100))
"""What is missing in the L-shaped case of 200 x 150 x 100 mm."""

INNER_WALL: Block = ((50, 0, 30), (55, 100, 100))

PILLAR: Block = ((20, 20, 20), (30, 30, 60))
"""Inside the case, with space on all sides: a separate part of its surface."""


nest_module = importlib.import_module("packit_sim.parts.nesting.nest")


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))


def block(corners: Block) -> trimesh.Trimesh:
    return creation.box(bounds=np.array(corners, dtype=float))


def without(mesh: trimesh.Trimesh, *blocks: Block) -> trimesh.Trimesh:
    return trimesh.boolean.difference([mesh, *map(block, blocks)], engine="manifold")


@cache
def case(*blocks: Block) -> trimesh.Trimesh:
    """A case of 200 x 150 x 100 mm without some blocks."""
    return without(block(((0, 0, 0), (200, 150, 100))), *blocks)


def of(mesh: trimesh.Trimesh, name: str = "item", **settings: Any) -> ItemType:
    return ItemType(name, mesh.vertices, mesh.faces, **settings)


def meshes() -> dict[str, trimesh.Trimesh]:
    return {
        "brick": creation.box((60, 40, 25)),
        "can": creation.cylinder(18, 50, sections=16),
        "ball": creation.icosphere(1, 20),
    }


def types(demand: int = 4) -> list[ItemType]:
    each = meshes().items()
    return [of(mesh, name, demand=demand, rotations="fixed") for name, mesh in each]


def placed(packing: Packing) -> list[tuple[Floats, Floats]]:
    """Return the vertices and the triangles' corners of each item."""
    found = []
    for one in packing.placements:
        vertices = packing.vertices(one)
        found.append((vertices, vertices[packing.types[one.type].faces]))
    return found


def in_cylinder(packing: Packing, diameter: float, height: float, margin: float = 0.0) -> bool:
    """By numpy: no vertex is farther from the axis than the radius."""
    return all(
        np.hypot(*(v[:, :2] - diameter / 2).T).max() <= diameter / 2 - margin + BEYOND
        and v[:, 2].min() >= margin - BEYOND
        and v[:, 2].max() <= height - margin + BEYOND
        for v, _ in placed(packing)
    )


def apart(packing: Packing, blocks: Sequence[Block], margin: float = 0.0) -> bool:
    """By numpy: convex items are in the case, and the blocks are outside them, with a distance."""
    rng = np.random.default_rng(0)
    for vertices, triangles in placed(packing):
        if vertices.min() < margin - BEYOND:
            return False
        if (vertices.max(axis=0) > np.array((200, 150, 100)) - margin + BEYOND).any():
            return False
        shares = rng.dirichlet((1, 1, 1), (len(triangles), 64))
        points = np.concatenate(
            (vertices, np.einsum("nkc,ncd->nkd", shares, triangles).reshape(-1, 3))
        )
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        for low, high in np.array(blocks):
            ways = np.maximum(np.maximum(low - points, points - high), 0)
            inside = ((points > low + BEYOND) & (points < high - BEYOND)).all(axis=1)
            if inside.any() or np.linalg.norm(ways, axis=1).min() < margin - BEYOND:
                return False
            grid = low + (high - low) * np.indices((9, 9, 9)).reshape(3, -1).T / 8
            depths = np.einsum("gnd,nd->gn", grid[:, None] - triangles[:, 0], normals).max(axis=1)
            if depths.min() < -BEYOND:  # a point of the block is inside the item
                return False
    return True


@pytest.mark.parametrize("clearance", [0.0, 2.0])
def test_items_in_a_cylinder_are_inside_it(clearance: float) -> None:
    container = CylinderContainer(140, 100)
    packing = nest(types(), container, "knapsack", clearance=clearance, settings=FEW)
    assert len(packing.placements) >= 5
    assert packing.problems() == [] and in_cylinder(packing, 140, 100)
    assert packing.density == pytest.approx(packing.volume / (math.pi * 70**2 * 100))


def test_a_corner_of_the_bounding_box_is_not_in_the_cylinder() -> None:
    item = of(creation.box(bounds=((0, 0, 0), (10, 10, 10))))
    packing = Packing((item,), CylinderContainer(100, 50), (Placement(0),), objective="knapsack")
    assert packing.problems() == [
        f"item 0 ('item') reaches {50 * math.sqrt(2) - 50:.3g} beyond the cylinder's round wall"
    ]


def test_the_vertices_decide_up_to_the_tolerance() -> None:
    container = CylinderContainer(100, 50)
    for side, is_inside in ((100 / math.sqrt(2), True), (100 / math.sqrt(2) + 0.05, False)):
        square = of(creation.box(bounds=((0, 0, 0), (side, side, 10))))
        centred = Placement.from_matrix(0, moved(50 - side / 2, 50 - side / 2, 0))
        packing = Packing((square,), container, (centred,), objective="knapsack")
        assert (packing.problems() == []) == is_inside


def moved(x: float, y: float, z: float) -> Floats:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


@pytest.mark.parametrize(
    "blocks", [(NOTCH,), (NOTCH, INNER_WALL), (PILLAR,)], ids=["L", "inner wall", "pillar"]
)
def test_items_in_a_mesh_are_inside_it(blocks: tuple[Block, ...]) -> None:
    container = MeshContainer(of(case(*blocks)))
    packing = nest(types(), container, "knapsack", clearance=0.5, settings=FEW)
    assert len(packing.placements) >= 4
    assert packing.problems() == [] and apart(packing, blocks)


@pytest.mark.parametrize(
    ("low", "high", "fault"),
    [
        ((0, 60, 0), (100, 150, 100), None),
        ((-5, 60, 0), (95, 150, 100), "reaches 5 beyond the container's wall"),
        ((90, 40, 10), (110, 80, 20), "crosses the container's wall"),
        ((120, 80, 10), (150, 120, 60), "lies, in part or whole, beyond the container's wall"),
        ((15, 15, 15), (35, 35, 65), "is around a part of the container's wall"),
        ((21, 21, 25), (29, 29, 55), "lies, in part or whole, beyond the container's wall"),
    ],
)
def test_what_is_wrong_in_a_mesh_is_named(low: Any, high: Any, fault: str | None) -> None:
    container = MeshContainer(of(case(NOTCH, PILLAR)))
    if fault is None:
        container = MeshContainer(of(case(NOTCH)))
    packing = Packing((of(block((low, high))),), container, (Placement(0),), objective="knapsack")
    assert packing.problems() == ([f"item 0 ('item') {fault}"] if fault else [])


def test_a_shape_is_in_itself_but_not_if_it_is_larger() -> None:
    ball = creation.icosphere(2, 50).apply_translation((50, 50, 50))
    container = MeshContainer(of(ball))
    for scale, is_inside in ((1.0, True), (1.01, False)):
        own = of(ball.copy().apply_translation((-50, -50, -50)).apply_scale(scale))
        at = (Placement.from_matrix(0, moved(50, 50, 50)),)
        packing = Packing((own,), container, at, objective="knapsack")
        assert (packing.problems() == []) == is_inside


def open_box() -> trimesh.Trimesh:
    mesh = creation.box((10, 10, 10))
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:-2], process=False)


def two_boxes() -> trimesh.Trimesh:
    """Two boxes that overlap, or one inside the other if they are of different sizes."""
    one = creation.box((10, 10, 10))
    return trimesh.util.concatenate([one, one.copy().apply_translation((5, 1, 1))])


def test_a_mesh_that_is_no_solid_is_refused() -> None:
    with pytest.raises(ArgumentError, match="'item' is not closed: 4 of its edges"):
        MeshContainer(of(open_box()))
    twisted = creation.box((10, 10, 10))
    faces = np.array(twisted.faces)
    faces[0] = faces[0][::-1]
    with pytest.raises(ArgumentError, match="not closed: its triangles do not all face outwards"):
        MeshContainer(of(trimesh.Trimesh(twisted.vertices, faces, process=False)))
    with pytest.raises(ArgumentError, match="'item': its surface crosses itself"):
        MeshContainer(of(two_boxes()))
    inside_out = creation.box((10, 10, 10))
    inside_out.invert()
    assert MeshContainer(of(inside_out)).volume == pytest.approx(1000)


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    container = MeshContainer(of(creation.icosphere(1, 50)))
    with pytest.raises(MissingPackageError, match=r"pip install 'packit-sim\[containers\]'"):
        container.walls()


def test_walls_fill_the_bounding_box_around_a_mesh() -> None:
    container = MeshContainer(of(creation.icosphere(1, 50)))
    walls = container.walls()
    assert sum(each.volume for each in walls) == pytest.approx(1e6 - container.volume)
    for each in walls:
        mesh = trimesh.Trimesh(each.vertices, each.faces, process=False)
        assert mesh.is_watertight and all(part.volume > 0 for part in mesh.split())
    thick = sum(each.volume for each in container.walls(margin=3.0))
    share = (1e6 - thick) / container.volume
    assert (1 - 4 / 50) ** 3 < share < (1 - 3 / 50) ** 3
    assert MeshContainer(of(creation.box((10, 20, 30)))).walls(margin=1, gap=1) == ()


@pytest.mark.parametrize("objective", ["strip", "bins"])
def test_only_a_knapsack_may_be_no_box(objective: str) -> None:
    with pytest.raises(ArgumentError, match="needs a box"):
        nest(types(), CylinderContainer(140, 100), objective, settings=FEW)


def test_items_keep_their_clearance_from_each_other_not_from_the_wall() -> None:
    square = of(creation.box((98 / math.sqrt(2), 98 / math.sqrt(2), 10)))
    container = CylinderContainer(100, 50)
    packing = nest([square], container, "knapsack", clearance=5.0, settings=FEW)
    assert len(packing.placements) == 1 and packing.problems() == []


def test_the_convex_space_in_a_cylinder() -> None:
    walls = WallClearance(sides=5, floor=2, top=1)
    space = convex_space(CylinderContainer(100, 50), walls)
    assert space is not None
    for point, is_inside in (
        ((50, 50, 3), True),
        ((50, 50, 1), False),
        ((50, 50, 49.5), False),
        ((94, 50, 25), True),
        ((96, 50, 25), False),
        ((14, 14, 25), False),
    ):
        assert (space.normals @ point <= space.distances).all() == is_inside, point


def test_obstacles_in_a_cylinder_stay_free() -> None:
    pillar = of(block(((60, 60, 0), (80, 80, 100))))
    container = CylinderContainer(140, 100, (pillar,))
    packing = nest(types(), container, "knapsack", settings=FEW)
    assert packing.problems() == [] and in_cylinder(packing, 140, 100)


def test_obstacles_may_be_larger_than_items_on_a_grid_of_cells(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []

    def problems(*arguments: Any) -> Problems:
        asked.append(arguments[5])
        return Problems(*arguments)

    monkeypatch.setattr(nest_module, "Problems", problems)
    settings = replace(FEW, search=SearchSettings(most_fields=5))
    container = CylinderContainer(140, 100, (of(block(((-9, 60, -9), (150, 80, 200)))),))
    packing = nest(types(2), container, "knapsack", settings=settings)
    assert asked == [True]
    assert packing.problems() == [] and in_cylinder(packing, 140, 100)


def parts(count: int = 4, **settings: Any) -> list[Part]:
    each = meshes().items()
    return [Part(name, mesh, count=count, rotations="fixed", **settings) for name, mesh in each]


@pytest.mark.parametrize(("clearance", "wall"), [(1.0, 3.0), (3.0, 1.0)])
def test_parts_in_a_cylinder_keep_the_distances(clearance: float, wall: float) -> None:
    settings = PackSettings(clearance, wall, unit="mm", workers=1, iterations=5)
    packed = pack(parts(2), "bed:cylinder:12x10cm", settings=settings)
    packing = packed.packings[0]
    assert packed.count >= 3 and packing.container.name == "bed"
    assert check(packed).problems == () and in_cylinder(packing, 120, 100, wall)
    assert packed.density == pytest.approx(packed.volume / (math.pi * 60**2 * 100))


@cache
def packed_in_a_case(folder: Path) -> PackedParts:
    """Parts in the case with an inner wall, from a file; the wall clearance is the larger one."""
    case(NOTCH, INNER_WALL).export(folder / "case.stl")
    settings = PackSettings(1.0, 2.5, workers=1, iterations=5)
    return pack(parts(), str(folder / "case.stl"), out=folder / "out", settings=settings)


@pytest.fixture(name="folder", scope="module")
def _folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("case")


def test_parts_in_a_mesh_keep_the_distance_to_its_walls(folder: Path) -> None:
    packed = packed_in_a_case(folder)
    packing = packed.packings[0]
    assert packed.count >= 4 and apart(packing, (NOTCH, INNER_WALL), 2.5)
    assert check(packed).problems == ()
    volume = case(NOTCH, INNER_WALL).volume
    assert packed.density == pytest.approx(packed.volume / volume)
    assert summary(packed)["boxes"] == "case mesh of 200 x 150 x 100 mm"


def test_the_record_is_verified_with_its_container(folder: Path) -> None:
    packed_in_a_case(folder)
    report = verify_record(folder / "out" / "packing.json")
    assert report.is_valid and report.density == pytest.approx(packed_in_a_case(folder).density)


def set_in(record: Any, *path: Any, to: Any) -> None:
    for key in path[:-1]:
        record = record[key]
    record[path[-1]] = to


FORGERIES: dict[str, tuple[Callable[[Any], object], str]] = {
    "a part in the wall": (lambda r: in_the_wall(r), "crosses the container's wall"),
    "no container": (
        lambda r: r.update(containers=[None]),
        "the containers are not those that were asked for",
    ),
    "a cylinder": (
        lambda r: r.update(containers=[{"form": "cylinder"}]),
        "bounding box of 200 x 200 x 100, not of 200 x 150 x 100",
    ),
    "another pose": (
        lambda r: set_in(r, "containers", 0, "pose", 0, 3, to=1.0),
        "its bounding box does not begin at",
    ),
    "another mesh": (
        lambda r: set_in(r, "containers", 0, "mesh", to=r["items"][0]["mesh"]),
        "bounding box",
    ),
    "a box was asked for": (
        lambda r: r["request"]["boxes"][0].update(form="box"),
        "the containers are not those that were asked for",
    ),
    "no mesh was asked for": (
        lambda r: r["request"]["boxes"][0].update(outline=None),
        "what was asked for can't be checked: the container 'case' has no mesh",
    ),
}


def in_the_wall(record: Any) -> None:
    pose = np.array(record["items"][0]["pose"])
    pose[:3, 3] = 100, 60, 50
    record["items"][0]["pose"] = pose.tolist()


@pytest.mark.parametrize("what", FORGERIES)
def test_a_forged_container_is_found(what: str, folder: Path) -> None:
    packed_in_a_case(folder)
    change, message = FORGERIES[what]
    record = json.loads((folder / "out" / "packing.json").read_text())
    change(record)
    file = folder / "out" / "forged.json"
    file.write_text(json.dumps(record))
    try:
        found = [each.sentence for each in verify_record(file).problems]
    except PackFormatError as error:
        found = [str(error)]
    assert any(message in each for each in found), found


def test_the_search_resumes_in_a_container(folder: Path) -> None:
    packed = packed_in_a_case(folder)
    container = str(folder / "case.stl")
    again = pack(parts(), container, out=folder / "out", settings=packed.task.settings)
    assert again.searches == 2 and again.score >= packed.score


def test_bricks_fill_a_mesh_that_is_shaped_like_their_box() -> None:
    bricks = Part("brick", creation.box((20, 30, 40)), count=28)
    mesh = creation.box((60, 90, 120)).subdivide().apply_translation((7, 8, 9))
    packed = pack([bricks], MeshContainer(of(mesh), name="crate"), settings=QUICK)
    assert packed.count == 27 and check(packed).problems == ()
    assert packed.density == pytest.approx(1)


def test_several_containers_are_filled_together() -> None:
    boxes = ["A:cylinder:80x60mm", BoxType((70, 50, 40), "B"), CylinderContainer(60, 60, name="C")]
    packed = pack(parts(2), boxes, settings=QUICK)
    names = [packing.container.name for packing in packed.packings]
    assert len(names) >= 2 and set(names) <= {"A", "B", "C"}
    space = sum(packing.container.volume for packing in packed.packings)
    assert check(packed).problems == () and packed.density == pytest.approx(packed.volume / space)


@pytest.mark.parametrize("objective", ["count", "height", "boxes"])
def test_objectives_work_in_a_cylinder(objective: Any) -> None:
    packed = pack(parts(1), "cylinder:100x120mm", objective, settings=QUICK)
    assert packed.count == 3 and check(packed).problems == ()
    assert all(in_cylinder(packing, 100, 120) for packing in packed.packings)


def test_as_many_meshes_as_are_needed_are_filled_and_verified(tmp_path: Path) -> None:
    slab = Part("slab", creation.box((28, 28, 20)), count=3)
    crate = MeshContainer(of(creation.box((30, 30, 30))), name="crate")
    packed = pack([slab], crate, "boxes", out=tmp_path, settings=QUICK)
    assert len(packed.packings) == 3
    assert verify_record(tmp_path / "packing.json").is_valid


def test_a_packing_in_a_container_is_written_and_read(tmp_path: Path) -> None:
    mesh = case(NOTCH).copy().apply_translation((5, 5, 5))
    for container in (CylinderContainer(200, 100), MeshContainer(of(mesh))):
        packing = Packing(
            (of(block(((0, 0, 0), (30, 30, 30)))),),
            container,
            (Placement.from_matrix(0, moved(40, 80, 10)),),
            objective="knapsack",
        )
        file = tmp_path / "packing.json"
        packing.write(file)
        report = verify_packing(file)
        assert report.is_valid and report.density == pytest.approx(packing.density)
        again = Packing.read(file)
        assert again.container.size == pytest.approx(container.size)
        assert type(again.container) is type(container) and again.problems() == []
        record = json.loads(file.read_text())
        record["items"][0]["pose"][0][3] = 0 if isinstance(container, CylinderContainer) else 90
        record["items"][0]["pose"][1][3] = 0 if isinstance(container, CylinderContainer) else 70
        file.write_text(json.dumps(record))
        assert not verify_packing(file).is_valid


@pytest.mark.parametrize(
    ("box", "message"),
    [
        ("cylinder:220", "'220' is not 2 lengths with a unit, such as 220x300mm"),
        ("cylinder:220x300x4mm", "is not 2 lengths"),
        ("cylinder:0x300mm", "the cylinder's diameter 0.0 is not possible"),
        ("trunk.stl", "container 'trunk.stl': there is no such file"),
        ("trunk.txt", "such as 300x200x150mm, A:30x20x15cm, cylinder:220x300mm or a mesh file"),
        ("cylinder:50x50mm", "is larger than the cylinder of 50 x 50 mm"),
        (MeshContainer(of(creation.icosphere(2, 25))), "the bounding box of the mesh of 50 x"),
        (CylinderContainer(200, 200, (of(creation.box((1, 1, 1))),)), "has obstacles: choose"),
        (["A:cylinder:200x200mm", "A:cylinder:100x100mm"], "boxes A, A need different names"),
    ],
)
def test_a_container_that_is_not_possible_is_one_error(box: Any, message: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        pack([Part("slab", creation.box((60, 60, 4)))], box, settings=QUICK)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_container_of_two_chambers_is_one_container(tmp_path: Path) -> None:
    chambers = [creation.box((20, 20, 20)).apply_translation((40 * n, 0, 0)) for n in range(2)]
    trimesh.util.concatenate(chambers).export(tmp_path / "two.stl")
    cube = Part("cube", creation.box((19, 19, 19)), 3)
    packed = pack([cube], str(tmp_path / "two.stl"), settings=QUICK)
    assert packed.count == 2 and len(packed.packings) == 1


def test_a_file_that_is_not_closed_is_one_error(tmp_path: Path) -> None:
    bowl = creation.icosphere(2, 50)
    bowl.update_faces(bowl.triangles_center[:, 2] < 20)
    bowl.export(tmp_path / "bowl.stl")
    with pytest.raises(ArgumentError, match=r"container 'bowl' is not closed: \d+ of its edges"):
        pack(parts(), str(tmp_path / "bowl.stl"), settings=QUICK)


@pytest.mark.parametrize(
    ("settings", "box", "message"),
    [
        ({"removable": True}, "cylinder:100x100mm", "removable is not possible in 'cylinder'"),
        ({"stable": 1.0}, "cylinder:100x100mm", "choose straight moves through the top"),
        ({"insertable": True}, "mesh", "insertable is not possible in 'container', a mesh"),
        ({"removable": True}, "mesh", "choose a box"),
    ],
)
def test_constraints_that_need_walls_are_refused(settings: Any, box: Any, message: str) -> None:
    box = MeshContainer(of(case(NOTCH))) if box == "mesh" else box
    with pytest.raises(ArgumentError, match=message):
        pack(parts(1), box, settings=PackSettings(workers=1, iterations=5, **settings))


@pytest.mark.parametrize(
    ("low", "high", "problem"),
    [
        ((0, 62, 0), (100, 150, 100), None),
        ((90, 40, 10), (110, 80, 20), "crosses the container's wall"),
        ((120, 80, 10), (150, 120, 60), "is not inside the container, in part or whole"),
        ((15, 15, 15), (35, 35, 65), "is around a part of the container's wall"),
    ],
)
def test_the_check_of_the_files_finds_the_same(low: Any, high: Any, problem: str | None) -> None:
    container = MeshContainer(of(case(NOTCH, PILLAR)), name="case")
    settings = PackSettings(unit="mm", reading=ReadSettings("mm"))
    task = prepared_task([Part("part", block((low, high)))], container, "volume", settings)
    packing = Packing(task.types, task.container(task.boxes[0]), (Placement(0),), 0.0, "knapsack")
    found = check(PackedParts(task, (packing,))).problems
    assert found == ((f"part (part 0 of box 1) {problem}",) if problem else ())


def test_parts_come_straight_down_into_a_cylinder(tmp_path: Path) -> None:
    settings = PackSettings(workers=1, iterations=5, insertable=True, separable=True)
    packed = pack(parts(2), "cylinder:100x100mm", settings=settings)
    assert packed.count >= 3
    assert removable(packed.packings[0], moves=1).stuck == ()
    with pytest.raises(
        ArgumentError, match="the removal from 'cylinder', a cylinder, is not known"
    ):
        removable(packed.packings[0])


def test_instructions_and_films_need_to_know_the_opening(folder: Path, tmp_path: Path) -> None:
    packed = packed_in_a_case(folder)
    with pytest.raises(ArgumentError, match="instructions are not possible for 'Box', a mesh"):
        write_instructions(packed, tmp_path / "steps.html")
    with pytest.raises(ArgumentError, match="films are not possible for 'case', a mesh"):
        film(packed, tmp_path / "film.gif")
    with pytest.raises(ArgumentError, match="instructions are not possible for 'case', a mesh"):
        pack(parts(), str(folder / "case.stl"), instructions=True, settings=QUICK)


def test_fixed_parts_must_be_inside_the_container() -> None:
    post = Part("post", block(((0, 0, 0), (5, 5, 50))))
    settings = PackSettings(workers=1, iterations=5, fixed=[post])
    with pytest.raises(ArgumentError, match=r"'post' reaches 20\.7 mm beyond the cylinder's"):
        pack(parts(1), "cylinder:100x100mm", settings=settings)


def test_pages_and_models_show_the_container(folder: Path) -> None:
    packed_in_a_case(folder)
    lines = outline(packed_in_a_case(folder).packings[0].container)
    assert len(lines) >= 12 and lines.min() >= 0 and lines.max() <= 200
    scene = trimesh.load_scene(folder / "out" / "packing.glb")
    path = scene.geometry["container case"]
    assert np.ptp(path.vertices, axis=0) == pytest.approx((0.2, 0.15, 0.1))
    page = (folder / "out" / "packing.html").read_text()
    assert '"outline": []' not in page and '"outline":[]' not in page
    (shown,) = box_scenes(packed_in_a_case(folder))["models"]["boxes"]
    corners = np.reshape(shown["outline"], (-1, 3))
    assert corners.max(axis=0) == pytest.approx(shown["size"])
    round_lines = outline(CylinderContainer(10, 5))
    from_axis = np.linalg.norm(round_lines[..., :2] - 5, axis=-1)
    assert from_axis == pytest.approx(5.0)
    assert len(outline(BoxContainer((1, 2, 3)))) == 0


def test_the_rims_of_a_cylinder_are_closed() -> None:
    lengths = np.linalg.norm(np.diff(outline(CylinderContainer(10, 5)), axis=1)[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(2 * math.pi * 10 + 4 * 5, rel=1e-3)


def test_of_too_many_lines_the_longest_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outlines, "MAX_LINES", 4)
    block = creation.box(bounds=((0, 0, 0), (10, 20, 30)))
    shown = outline(MeshContainer(of(block)))
    assert np.ptp(shown, axis=1) == pytest.approx(np.tile((0, 0, 30), (4, 1)))


def test_the_bars_of_an_outline_are_closed_bodies() -> None:
    body = outline_body(CylinderContainer(10, 5))
    assert body is not None
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume > 0
