"""The largest scale at which one part fits into a container."""

import json
import math
from pathlib import Path

import pytest
import trimesh
from trimesh import creation

from benchmarks import fit as benchmark
from benchmarks.common import RESULTS, table_in_page
from packit_sim import BoxContainer, CylinderContainer, PackSettings, Part, WallClearance, fit
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.packings.packing_files import verify_packing
from tests.runs import packit

CUBE = creation.box((1, 1, 1))
QUICK = ["tetrahedron in cube", "octahedron in cube", "block that may not turn", "ball in bracket"]


def pair(name: str) -> benchmark.Pair:
    return next(each for each in benchmark.pairs() if each.name == name)


@pytest.mark.parametrize("name", QUICK)
def test_known_scales_are_found(name: str) -> None:
    found = benchmark.measured(pair(name), 4.0)
    assert abs(found["difference"]) < 0.01
    assert found["problems"] == []


@pytest.mark.slow
@pytest.mark.parametrize("each", benchmark.pairs(), ids=lambda each: each.name)
def test_all_known_scales_are_found(each: benchmark.Pair) -> None:
    found = benchmark.measured(each, 20.0)
    assert abs(found["difference"]) < 0.01
    assert found["problems"] == []


@pytest.mark.parametrize(
    ("rotations", "scale"),
    [("fixed", 1.0), ("upright", 1.5), ("cube", 2.0), ("free", 2.0)],
)
def test_only_the_rotations_of_the_set_are_used(rotations: str, scale: float) -> None:
    """A bar of 2 x 1 x 1 in a box of 2 x 3 x 4."""
    part = Part("bar", creation.box((2, 1, 1)), rotations=rotations)
    found = fit(part, (2.0, 3.0, 4.0), time=1, settings=PackSettings(unit="mm"))
    assert found.scale >= scale * (1 - 1e-5)
    assert found.scale <= scale * (1 + 1e-3)
    assert found.size == pytest.approx((2 * found.scale, found.scale, found.scale))


def test_walls_keep_their_distances() -> None:
    walls = WallClearance(sides=5, floor=2)
    settings = PackSettings(wall_clearance=walls, unit="mm")
    part = Part("cube", CUBE, rotations="fixed")
    box = fit(part, BoxContainer((60, 70, 45)), settings=settings)
    assert box.scale == pytest.approx(43, rel=1e-5)
    vertices = box.packing.vertices(box.packing.placements[0])
    assert vertices[:, :2].min() >= 5 - 1e-6 and vertices[:, 2].min() >= 2 - 1e-6
    can = fit(part, CylinderContainer(60, 45), settings=settings)
    assert can.scale == pytest.approx(50 / math.sqrt(2), rel=1e-3)
    assert not can.packing.problems()


def test_in_a_convex_mesh_every_rotation_is_possible(tmp_path) -> None:
    """By the 24 rotations of a cube, a cube in a larger one that is turned has a scale of 14.6."""
    file = tmp_path / "turned.stl"
    turned = trimesh.transformations.rotation_matrix(math.pi / 6, (0, 0, 1))
    creation.box((20, 20, 20), transform=turned).export(file)
    part, settings = Part("cube", CUBE, rotations="free"), PackSettings(unit="mm")
    found = fit(part, str(file), settings=settings)
    assert found.scale == pytest.approx(20, rel=1e-3)


def test_a_mesh_that_is_not_convex_keeps_its_distance_and_has_a_valid_place() -> None:
    bracket = pair("bracket in itself").container
    settings = PackSettings(wall_clearance=0.1, unit="mm")
    found = fit(Part("cube", CUBE, rotations="fixed"), bracket, time=2, settings=settings)
    assert found.scale == pytest.approx(0.8, rel=0.01)
    vertices = found.packing.vertices(found.packing.placements[0])
    assert vertices.min() >= 0.1 - 1e-6 and vertices[:, 2].max() <= 0.9 + 1e-6


def test_the_page_has_the_table_of_the_results() -> None:
    results = json.loads((RESULTS / benchmark.FILE).read_text())["results"]
    assert table_in_page(benchmark.PAGE, "fit") == benchmark.table(results)
    assert [each["pair"] for each in results] == [each.name for each in benchmark.pairs()]
    assert len(results) == 20
    assert all(abs(each["difference"]) < 0.01 and not each["problems"] for each in results)


def test_the_command_writes_a_packing_that_is_verified(tmp_path: Path) -> None:
    creation.box((100, 60, 40)).export(tmp_path / "a.stl")
    file = tmp_path / "fit.json"
    text = packit("fit", tmp_path / "a.stl", "--box", "20x12x8cm", "--time", "1", "--packing", file)
    assert "scale      2\n" in text and "size       20 x 12 x 8 cm" in text
    assert verify_packing(file).is_valid


def test_what_is_not_one_part_or_one_container_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="container 'prusa-mk' is not known"):
        fit(Part("a", CUBE), "prusa-mk")
    scene = trimesh.Scene([CUBE, CUBE.copy().apply_translation((3, 0, 0)).apply_scale(2)])
    scene.export(tmp_path / "two.3mf")
    with pytest.raises(ArgumentError, match=r"has 2 parts .*: one is needed"):
        fit(tmp_path / "two.3mf", (9.0, 9.0, 9.0))
    (tmp_path / "bad.stl").write_bytes(b"no mesh")
    with pytest.raises(ArgumentError, match=r"bad\.stl: "):
        fit(tmp_path / "bad.stl", (9.0, 9.0, 9.0))
