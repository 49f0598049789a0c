"""Files of strip-packing instances and solutions: read with clear errors, written and found."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim.core.errors import ArgumentError, MeshError, PackFormatError
from packit_sim.geometry import rotations
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.instances import (
    instances_in,
    read_instance,
    read_solution,
    write_instance,
    write_solution,
)
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement


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


def test_the_instances_of_a_folder_are_found_among_other_files(tmp_path) -> None:
    file = instance(tmp_path)
    write_solution(solved(file), tmp_path / "solution.json", "below/two.json")
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "meshes" / "list.json").write_text("[]")
    assert instances_in(tmp_path) == [file]


def test_an_instance_is_written_and_read_again(tmp_path) -> None:
    types, container = read_instance(instance(tmp_path))
    write_instance(types, container, tmp_path / "out" / "again.json")
    again, strip = read_instance(tmp_path / "out" / "again.json")
    assert strip == container
    assert [t.name for t in again] == ["brick.obj", "ball.obj"]
    assert [t.demand for t in again] == [3, 1]
    for one, other in zip(types, again, strict=True):
        assert np.array_equal(one.vertices, other.vertices)
        assert np.array_equal(one.faces, other.faces)


def test_an_instance_that_cannot_be_written_is_refused(tmp_path) -> None:
    types, container = read_instance(instance(tmp_path))
    with pytest.raises(ArgumentError, match="again is not possible for an instance"):
        write_instance(types, container, tmp_path / "again")
    with pytest.raises(ArgumentError, match=r"are not different: brick\.obj, brick\.obj"):
        write_instance((types[0], types[0]), container, tmp_path / "again.json")
    path = tmp_path / "BRICK.obj"
    creation.box((1, 2, 3)).export(path)  # one file for both, where folders ignore case
    with pytest.raises(ArgumentError, match=r"are not different: brick\.obj, BRICK\.obj"):
        write_instance((types[0], ItemType.from_file(path)), container, tmp_path / "again.json")
    assert not (tmp_path / "again.json").exists()


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
