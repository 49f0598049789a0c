"""Strip-packing instances of the literature: complete, right, and read with clear errors."""

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim.core.assets import assets_folder
from packit_sim.core.errors import MeshError, PackFormatError
from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Floats
from packit_sim.libraries.mesh_files import read
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.instances import (
    builtin_instances,
    read_instance,
    read_solution,
    write_solution,
)
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement

FOLDER = assets_folder() / "instances"
MESHES = sorted(file for file in FOLDER.rglob("*.*") if file.suffix in (".obj", ".stl"))
SOLUTION = FOLDER / "Stoyan et al. 2005" / "Solution1.json"

ITEMS = {
    "Egeblad et al. 2009/Merged1": 15,
    "Egeblad et al. 2009/Merged3": 45,
    "Egeblad et al. 2009/Merged5": 75,
    "Liu et al. 2015/Experiment1": 36,
    "Stoyan et al. 2004/Example1": 80,
    "Stoyan et al. 2004/Example2": 20,
    "Stoyan et al. 2004/Example3": 30,
    "Stoyan et al. 2005/Example1": 7,
    "Stoyan et al. 2005/Example2": 12,
    "Stoyan et al. 2005/Example3": 25,
}
"""The number of items of each instance with published heights."""


def test_the_bundled_instances_are_those_with_published_heights_and_small_ones() -> None:
    found = builtin_instances()
    assert {name for name in found if "Tollenaere" not in name} == set(ITEMS)
    assert len(found) == len(ITEMS) + 66
    with open(FOLDER / "published.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["instance"].removesuffix(".json") for row in rows} == set(ITEMS)
    for name, items in ITEMS.items():
        types, container = read_instance(found[name])
        assert sum(item_type.demand for item_type in types) == items
        assert container.is_strip
        heights = [float(row["best_10min"]) for row in rows if row["instance"] == f"{name}.json"]
        volume = sum(item_type.demand * item_type.volume for item_type in types)
        assert 0.3 < volume / (container.base * min(heights)) < 1


def test_small_instances_hold_as_many_items_as_their_names_say() -> None:
    for name, file in builtin_instances().items():
        if "Tollenaere" in name:
            content = json.loads(file.read_text())
            demands = [entry["demand"] for entry in content["item-types"]]
            assert sum(demands) == int(file.name[:2]), name
            assert all((FOLDER / entry["path"]).is_file() for entry in content["item-types"])


def polygons(file: Path) -> tuple[Floats, list[list[int]]]:
    lines = [line.split("#")[0].split() for line in file.read_text().splitlines()]
    vertices = [list(map(float, line[1:])) for line in lines if line[:1] == ["v"]]
    faces = [[int(n) - 1 for n in line[1:]] for line in lines if line[:1] == ["f"]]
    return np.array(vertices), faces


@pytest.mark.parametrize("file", MESHES, ids=lambda f: f.relative_to(FOLDER).as_posix())
def test_surfaces_are_those_of_the_polygons_in_the_file(file) -> None:
    mesh = read(file).mesh
    assert mesh.volume > 0
    if file.suffix == ".stl":
        return
    vertices, faces = polygons(file)
    normals = [np.cross(vertices[f], np.roll(vertices[f], -1, axis=0)).sum(axis=0) for f in faces]
    area = sum(np.linalg.norm(normal) for normal in normals) / 2
    centres = [vertices[f].mean(axis=0) for f in faces]
    volume = sum(c @ n for c, n in zip(centres, normals, strict=True)) / 6
    slack = 3e-3 if file.match("convex/polytope1.obj") else 1e-7  # it has a face that is not flat
    assert mesh.area == pytest.approx(area, rel=slack)
    assert mesh.volume == pytest.approx(volume, rel=slack)


@pytest.mark.parametrize(
    ("name", "volume"),
    [
        ("Stoyan et al. 2004/nonconvex/sanitized/polytope5.obj", 66),
        ("Stoyan et al. 2004/convex/polytope1.obj", 788),
        ("Liu et al. 2015/arrow.obj", 125),
        ("Liu et al. 2015/ring.obj", 132),
        ("Stoyan et al. 2005/polytope7.obj", 174.5),
        ("Egeblad et al. 2009/Merged/Block1.stl", 256),
    ],
)
def test_volumes(name, volume) -> None:
    assert read(FOLDER / name).mesh.volume == pytest.approx(volume)


def test_a_convex_polytope_is_convex_in_spite_of_its_spike() -> None:
    """A face of convex/polytope1 goes to a corner and back: a line without area."""
    mesh = read(FOLDER / "Stoyan et al. 2004/convex/polytope1.obj").mesh
    used = np.unique(mesh.faces[mesh.area_faces > 0])
    assert len(used) == 13
    assert trimesh.convex.convex_hull(mesh.vertices[used]).volume == pytest.approx(mesh.volume)


def test_a_published_solution_is_valid_and_as_high_as_it_says() -> None:
    packing = read_solution(SOLUTION, "fixed")
    assert packing.problems() == []
    assert packing.height == pytest.approx(17.46306801)
    assert packing.left_out == (0,) * 7
    assert packing.height == pytest.approx(json.loads(SOLUTION.read_text())["totalHeight"])


def instance(folder: Path, **changes: Any) -> Path:
    """Writes an instance of a brick and a ball, in a folder below that of the meshes."""
    (folder / "meshes").mkdir(exist_ok=True)
    (folder / "below").mkdir(exist_ok=True)
    creation.box((1, 2, 3)).export(folder / "meshes" / "brick.stl")
    creation.icosphere(subdivisions=1).export(folder / "meshes" / "ball.obj")
    content = {
        "name": "two",
        "container": {"size-x": 10, "size-y": 8.5, "size-w": 1},
        "item-types": [
            {"path": "meshes/brick.stl", "demand": 3, "colour": "red"},
            {"path": "meshes/ball.obj", "demand": 1},
        ],
        "more": None,
        **changes,
    }
    path = folder / "below" / "two.json"
    path.write_text(json.dumps(content))
    return path


def test_any_file_of_the_format_is_read(tmp_path) -> None:
    types, container = read_instance(instance(tmp_path), "axis-4")
    assert container == BoxContainer((10, 8.5, math.inf))
    assert [(t.name, t.demand, t.rotations) for t in types] == [
        ("brick.stl", 3, "axis-4"),
        ("ball.obj", 1, "axis-4"),
    ]
    assert types[0].file == tmp_path / "meshes" / "brick.stl"


def items_of(*entries: tuple[Any, Any]) -> dict[str, Any]:
    return {"item-types": [{"path": path, "demand": demand} for path, demand in entries]}


BRICK = ("meshes/brick.stl", 1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"container": {"size-x": 10}}, "field 'container.size-y' is missing"),
        ({"container": {"size-x": 0, "size-y": 1}}, "field 'container.size-x' is 0: expected"),
        ({"container": {"size-x": "1", "size-y": 1}}, "field 'container.size-x' is '1'"),
        ({"container": None}, "field 'container' is None"),
        ({"item-types": []}, r"field 'item-types' is \[\]"),
        (items_of(("meshes/brick.stl", 0)), r"field 'item-types\[0\].demand' is 0: expected"),
        (items_of(("meshes/brick.stl", 1.5)), r"field 'item-types\[0\].demand' is 1.5"),
        (items_of(("meshes/brick.stl", 10**9)), r"field 'item-types\[0\].demand' is 1000000000"),
        (items_of(*[("meshes/brick.stl", 10**5)] * 2), "200,000 items are too many: at most 100"),
        (items_of((3, 1)), r"field 'item-types\[0\].path' is 3"),
        (items_of(BRICK, ("../a.stl", 1)), r"field 'item-types\[1\].path' .* relative path"),
        (items_of(("/etc/a.stl", 1)), r"field 'item-types\[0\].path' .* relative path"),
        (items_of(("absent.stl", 1)), r"field 'item-types\[0\].path' .* no such file, from the"),
    ],
)
def test_a_file_that_is_no_instance_is_refused(changes, message, tmp_path) -> None:
    with pytest.raises(PackFormatError, match=rf"below/two\.json: {message}"):
        read_instance(instance(tmp_path, **changes))


def test_a_mesh_that_cannot_be_used_is_named(tmp_path) -> None:
    absent = items_of(BRICK, ("meshes/absent.stl", 1))
    with pytest.raises(MeshError, match=r"two\.json: field 'item-types\[1\]\.path': .*absent\.stl"):
        read_instance(instance(tmp_path, **absent))
    path = instance(tmp_path)
    (tmp_path / "meshes" / "ball.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(MeshError, match=r"item-types\[1\]\.path': .*no extent along z"):
        read_instance(path)
    with pytest.raises(PackFormatError, match=r"can't be read from .*absent\.json"):
        read_instance(tmp_path / "absent.json")


def solved(path: Path) -> Packing:
    """A packing of the instance, in all rotations of the cube and a free one."""
    types, container = read_instance(path)
    turns = [*rotations.MATRICES[:3], trimesh.transformations.euler_matrix(1, 2, 3)[:3, :3]]
    places = []
    for n, (number, turn) in enumerate(zip((0, 0, 0, 1), turns, strict=True)):
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = (1.5 + 2.3 * n, 2, 1.5)
        places.append(Placement.from_matrix(number, pose))
    return Packing(types, container, tuple(places))


def test_a_solution_is_written_and_read_again(tmp_path) -> None:
    packing = solved(instance(tmp_path))
    write_solution(packing, tmp_path / "solution.json", "below/two.json")
    again = read_solution(tmp_path / "solution.json")
    for one, other in zip(packing.placements, again.placements, strict=True):
        assert one.pose == other.pose and one.type == other.type
    assert again.height == packing.height
    content = json.loads((tmp_path / "solution.json").read_text())
    assert content["totalHeight"] == packing.height
    assert [item["name"] for item in content["items"]] == ["brick.stl"] * 3 + ["ball.obj"]


@pytest.mark.parametrize("turn", [*rotations.MATRICES, None])
def test_yaw_pitch_and_roll_are_turns_about_z_y_and_x(turn, tmp_path) -> None:
    path = instance(tmp_path)
    types, container = read_instance(path)
    pose = np.eye(4)
    pose[:3, :3] = trimesh.transformations.euler_matrix(1, 2, 3)[:3, :3] if turn is None else turn
    write_solution(
        Packing(types, container, (Placement.from_matrix(0, pose),)), tmp_path / "one.json"
    )
    found = json.loads((tmp_path / "one.json").read_text())["items"][0]["transformation"]
    turns = [
        trimesh.transformations.rotation_matrix(found[name], axis)
        for name, axis in (("roll", (1, 0, 0)), ("pitch", (0, 1, 0)), ("yaw", (0, 0, 1)))
    ]
    assert np.allclose(np.linalg.multi_dot(turns)[:3, :3], pose[:3, :3], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"instancePath": "below/absent.json"}, "field 'instancePath' .* no such file"),
        ({"instancePath": "../two.json"}, "field 'instancePath' .* relative path"),
        (
            {"itemOrigin": "Corner"},
            "field 'itemOrigin' is 'Corner': choose from AlignToCenter, Align",
        ),
        ({"items": []}, r"field 'items' is \[\]"),
        ({"name": "cube.stl"}, r"field 'items\[0\].name' is 'cube.stl': the instance has no such"),
        ({"name": "ball.obj"}, r"field 'items\[3\].name' is 'ball.obj': .* or not as many"),
        ({"matrix": [[2, 0, 0, 0]] + [[0, 1, 0, 0]] * 3}, r"field 'items\[0\].transformation'"),
        ({"matrix": [[1, 2], [3, 4]]}, r"field 'items\[0\].transformation.matrix\[0\]'"),
    ],
)
def test_a_file_that_is_no_solution_is_refused(change, message, tmp_path) -> None:
    path = tmp_path / "solution.json"
    write_solution(solved(instance(tmp_path)), path, "below/two.json")
    content = json.loads(path.read_text())
    if "name" in change:
        content["items"][0] |= change
    elif "matrix" in change:
        content["items"][0]["transformation"] |= change
    else:
        content |= change
    path.write_text(json.dumps(content))
    with pytest.raises(PackFormatError, match=rf"solution\.json: {message}"):
        read_solution(path)


def test_poses_may_refer_to_the_corner_or_the_centre_of_a_mesh(tmp_path) -> None:
    path = tmp_path / "solution.json"
    packing = solved(instance(tmp_path))
    write_solution(packing, path, "below/two.json")
    content = json.loads(path.read_text())
    for name, point in (("AlignToMinimum", (-0.5, -1, -1.5)), ("AlignToCenter", (0, 0, 0))):
        moved = json.loads(json.dumps(content)) | {"itemOrigin": name}
        matrix = np.array(moved["items"][0]["transformation"]["matrix"])
        matrix[3, :3] += point @ matrix[:3, :3]
        moved["items"][0]["transformation"]["matrix"] = matrix.tolist()
        path.write_text(json.dumps(moved))
        again = read_solution(path)
        assert np.allclose(again.placements[0].matrix, packing.placements[0].matrix)
