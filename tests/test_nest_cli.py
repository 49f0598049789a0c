"""`packit nest` as a user runs it."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from trimesh import creation
from trimesh.transformations import rotation_matrix

from packit_sim.cli import nest_command
from packit_sim.core.errors import PackItError
from packit_sim.geometry.motions import Motion
from packit_sim.parts.packings.instances import read_solution
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from tests.runs import packit

INSTANCE = {
    "name": "cubes",
    "container": {"size-x": 2, "size-y": 2},
    "item-types": [{"path": "meshes/cube.obj", "demand": 4}],
}

CUBE = """v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1
f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\nf 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7
f 4 1 5\nf 4 5 8\n"""


@pytest.fixture(name="instance")
def _instance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "cube.obj").write_text(CUBE)
    (tmp_path / "cubes.json").write_text(json.dumps(INSTANCE))
    monkeypatch.chdir(tmp_path)
    return "cubes.json"


def test_an_instance_is_packed_written_and_verified(instance) -> None:
    output = packit(
        *("nest", instance, "--rotations", "fixed", "--iterations", 2000, "--workers", 1),
        *("--out", "out/solution.json", "--packing", "packing.json"),
    )
    row = next(line.split() for line in output.splitlines() if line.endswith("yes  "))
    assert [float(row[0]), float(row[1]), int(row[2])] == [1, 1, 4]
    found = read_solution("out/solution.json")
    assert found.problems() == [] and found.height == pytest.approx(1, abs=1e-3)
    assert json.loads(Path("out/solution.json").read_text())["instancePath"] == "cubes.json"
    assert "linked pairs: none" in output
    checked = packit("verify", "packing.json")
    assert "density 1.000, 0 problems" in checked and "linked pairs: none" in checked


def test_separable_items_are_placed_again_if_they_interlock(instance, monkeypatch) -> None:
    """Cubes never interlock: the packings that the search found are linked here by a double."""
    _, container = nest_command._read(instance, "fixed")
    ring = creation.torus(0.6, 0.1, major_sections=16, minor_sections=8)
    upright = ring.copy().apply_transform(rotation_matrix(np.pi / 2, (1, 0, 0)))
    rings = [ItemType(name, m.vertices, m.faces) for name, m in (("ring", ring), ("link", upright))]
    places = [Placement(0, Motion.shift((0.8, 1, 1))), Placement(1, Motion.shift((1.2, 1, 1)))]
    linked = Packing(tuple(rings), container, tuple(places))
    assert linked.problems() == []

    def found(
        *given: object, callback: Callable[[Packing, float], object], **more: object
    ) -> Packing:
        callback(linked, 0.0)
        return linked

    monkeypatch.setattr("packit_sim.nest", found)
    plain = packit("nest", instance, "--packing", "linked.json")
    assert "linked pairs: item 0 ('ring') and item 1 ('link')" in plain
    assert "linked pairs: none" in packit("nest", instance, "--separable", "--packing", "out.json")
    assert "linked pairs: none" in packit("verify", "out.json")


def test_a_built_in_instance_is_known_by_its_name_and_written_for_others(tmp_path) -> None:
    out, file = tmp_path / "solution.json", tmp_path / "files" / "rings-12.json"
    run = ("nest", "rings-12", "--iterations", 1, "--workers", 1, "--out", out)
    packit(*run)
    assert json.loads(out.read_text())["instancePath"] == "rings-12.json"
    packit(*run, "--instance-out", file)
    assert json.loads(out.read_text())["instancePath"] == "files/rings-12.json"
    assert read_solution(out).problems() == []
    packit("nest", file, "--iterations", 1, "--workers", 1)


def test_a_solution_has_the_names_of_the_instance_that_is_written(instance) -> None:
    creation.box((1, 1, 1)).export("meshes/a cube.stl")
    items = [{"path": "meshes/a cube.stl", "demand": 2}]
    Path(instance).write_text(json.dumps(INSTANCE | {"item-types": items}))
    packit(
        *("nest", instance, "--iterations", 1, "--workers", 1, "--instance-out", "new.json"),
        *("--out", "solution.json"),
    )
    assert read_solution("solution.json").problems() == []


def test_a_folder_lists_its_instances(instance, tmp_path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "more cubes.json").write_text(json.dumps(INSTANCE))
    (tmp_path / "below" / "notes.json").write_text("{}")
    with pytest.raises(PackItError, match=r"is a folder: choose an instance in it") as found:
        packit("nest", tmp_path)
    message = " ".join(str(found.value).split())
    assert "there are 2: 'below/more cubes.json', 'cubes.json'" in message
    packit("nest", tmp_path / "below" / "more cubes.json", "--iterations", 1, "--workers", 1)
    with pytest.raises(PackItError, match="is a folder without a strip-packing instance"):
        packit("nest", tmp_path / "meshes")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"path": "absent.obj"}, r"cubes.json: field 'item-types\[0\].path' .* no such file"),
        ({"path": "../cube.obj"}, r"cubes.json: field 'item-types\[0\].path' .* relative path"),
    ],
)
def test_a_mesh_that_is_missing_or_elsewhere_is_one_error(instance, change, message) -> None:
    item = INSTANCE["item-types"][0] | change
    Path(instance).write_text(json.dumps({**INSTANCE, "item-types": [item]}))
    with pytest.raises(PackItError, match=message):
        packit("nest", instance)


def test_what_is_no_instance_is_one_error(instance, tmp_path) -> None:
    Path(instance).write_text("no JSON")
    with pytest.raises(PackItError, match=r"cubes\.json: not JSON"):
        packit("nest", instance)
    with pytest.raises(PackItError, match=r".*absent\.json"):
        packit("nest", "absent.json")
    with pytest.raises(PackItError, match=r"no instance 'cubes': .* built-in .*: polytopes-20"):
        packit("nest", "cubes")
    with pytest.raises(PackItError, match=r"--instance-out folder is not possible"):
        packit("nest", "rings-12", "--instance-out", "folder")


def test_ctrl_c_before_the_first_packing_ends_the_command(instance, monkeypatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("packit_sim.nest", interrupted)
    with pytest.raises(AssertionError, match="stopped: nothing is written"):
        packit("nest", instance)
