"""The benchmark of luggage volume: its grid and its check are right, and the page has its table."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import litres
from benchmarks.common import RESULTS, table_in_page
from benchmarks.litres import Arch, Trunk, deepest, grid_count
from packit_sim import ItemType, MeshContainer, PackSettings, Part, pack
from tests.packed_parts import cuboid


def trunk(*arches: Arch) -> Trunk:
    """A block of 410 x 210 x 110 mm: a grid of eight bricks fits into it."""
    corners = [(x, y, z) for x in (0, 410) for y in (0, 210) for z in (0, 110)]
    return Trunk("block", tuple(corners), arches)


def test_the_grid_counts_bricks_of_one_lattice() -> None:
    assert grid_count(trunk()) == 8
    assert grid_count(trunk(Arch(0, 0, 40, -10, 90))) == 7
    assert grid_count(trunk(Arch(0, 0, 9, -10, 300))) == 8  # the lattice moves aside


def pose(x: float, y: float, z: float, angle: float = 0.0) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3] = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    found[:3, 3] = x, y, z
    return found


@pytest.mark.parametrize(
    ("poses", "depth"),
    [
        ([pose(100, 50, 25), pose(300, 50, 25), pose(100, 50, 75)], 0),
        ([pose(100, 50, 25), pose(298, 52, 25)], 2),
        ([pose(97, 50, 25)], 3),
        ([pose(200, 105, 25), pose(200, 105, 70, 45)], 5),
        ([pose(204, 105, 25, 30)], 0),
    ],
)
def test_the_check_finds_the_deepest_overlap(poses, depth: float) -> None:
    assert deepest(trunk(), poses) == pytest.approx(depth, abs=1e-6)


def test_the_check_knows_arches() -> None:
    assert deepest(trunk(Arch(0, 0, 40, -10, 90)), [pose(100, 50, 25)]) > 30
    assert deepest(trunk(Arch(0, 0, 40, -10, 90)), [pose(240, 50, 25)]) == 0


def test_lattices_fill_a_case_without_a_quarter() -> None:
    whole, quarter = cuboid((0, 0, 0), (40, 40, 20)), cuboid((20, 20, -1), (50, 50, 30))
    case = whole.difference(quarter, engine="manifold")
    container = MeshContainer(ItemType("case", case.vertices, case.faces))
    brick = Part("brick", cuboid((0, 0, 0), (20, 10, 10)), 12)
    packed = pack([brick], container, settings=PackSettings(workers=1, iterations=1))
    assert packed.count == 12
    assert not packed.packings[0].problems()


def test_the_page_has_the_results() -> None:
    content = json.loads((RESULTS / litres.FILE).read_text())
    assert table_in_page(litres.PAGE, "litres") == litres.table(content)
    for each in content["results"]:
        assert each["problems"] == 0
        assert each["deepest"] < 0.2
        assert each["litres"] >= 0.9 * content["grids"][each["trunk"]]
