"""`packit nest` as a user runs it."""

import json
from pathlib import Path

import pytest

from packit_sim.cli import nest_command
from packit_sim.parts.packings.instances import read_solution
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
    assert "density 1.000, 0 problems" in packit("verify", "packing.json")


def test_a_built_in_instance_is_known_by_its_name(tmp_path) -> None:
    out = tmp_path / "solution.json"
    name = "Stoyan et al. 2005/Example1"
    packit("nest", name, "--time", "0.001s", "--workers", 1, "--rotations", "axis-4", "--out", out)
    assert json.loads(out.read_text())["instancePath"] == f"{name}.json"


def test_ctrl_c_before_the_first_packing_ends_the_command(instance, monkeypatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(nest_command, "nest", interrupted)
    with pytest.raises(AssertionError, match="stopped: nothing is written"):
        packit("nest", instance)
