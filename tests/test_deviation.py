"""The bound on the distance of two surfaces: never too small, and as tight as promised."""

import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_sim.core.errors import MeshError
from packit_sim.geometry.deviation import DIAGONAL_SLACK, RELATIVE_SLACK, Surface, deviation
from packit_sim.geometry.deviation_kernels import distances

ROUNDING = 1e-9


def soup(corners: npt.ArrayLike) -> trimesh.Trimesh:
    """The mesh of triangles (n, 3, 3) that share nothing."""
    points = np.asarray(corners, dtype=float).reshape(-1, 3)
    return trimesh.Trimesh(points, np.arange(len(points)).reshape(-1, 3), process=False)


def random_soup(seed: int, count: int, size: float = 0.3, stretch: float = 1.0) -> trimesh.Trimesh:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.uniform(-size, size, (count, 3, 3))
    return soup(corners * (1, 1, stretch))


def sheet(at: float, side: float = 1.0) -> trimesh.Trimesh:
    """A square in the plane z = at."""
    corners = np.array([(0, 0), (side, 0), (side, side), (0, side)])
    return trimesh.Trimesh(np.column_stack([corners, np.full(4, at)]), [(0, 1, 2), (0, 2, 3)])


def samples(mesh: trimesh.Trimesh, divisions: int) -> np.ndarray:
    """(n, 3) points of all triangles, on a regular lattice that has their corners."""
    weights = np.array(
        [(i, j, divisions - i - j) for i in range(divisions + 1) for j in range(divisions + 1 - i)]
    )
    return np.einsum("wk,nkd->nwd", weights / divisions, mesh.triangles).reshape(-1, 3)


def by_brute_force(points: np.ndarray, mesh: trimesh.Trimesh) -> np.ndarray:
    """(n,) the distances of points from a surface, asking every triangle."""
    closest = np.inf * np.ones(len(points))
    for triangle in mesh.triangles:
        repeated = np.repeat(triangle[None], len(points), axis=0)
        foot = trimesh.triangles.closest_point(repeated, points)
        closest = np.minimum(closest, np.linalg.norm(points - foot, axis=1))
    return closest


def allowed(distance: float, a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """The most that the bound may be."""
    slack = DIAGONAL_SLACK * max(np.linalg.norm(mesh.extents) for mesh in (a, b))
    return distance * (1 + RELATIVE_SLACK) + slack + ROUNDING


def check_known(a: trimesh.Trimesh, b: trimesh.Trimesh, distance: float) -> None:
    for bound in (deviation(a, b), deviation(b, a)):
        assert distance - ROUNDING <= bound <= allowed(distance, a, b)


CUBE = creation.box((1, 1, 1))
BALL = creation.icosphere(subdivisions=3)


@pytest.mark.parametrize("mesh", [CUBE, BALL, random_soup(0, 50), sheet(0)])
def test_a_surface_is_at_no_distance_from_itself(mesh: trimesh.Trimesh) -> None:
    assert deviation(mesh, mesh.copy()) == 0


def test_nor_from_itself_in_other_triangles() -> None:
    fine = CUBE.subdivide().subdivide().subdivide()
    assert deviation(CUBE, fine) < 1e-9
    assert deviation(creation.box((1, 1, 1)), creation.box((1, 1, 1)).subdivide_to_size(0.1)) < 1e-9


def test_a_moved_corner() -> None:
    moved = CUBE.copy()
    out = moved.vertices[7] / np.linalg.norm(moved.vertices[7])
    moved.vertices[7] += 0.1 * out
    check_known(CUBE, moved, 0.1)


def test_a_lost_sheet_counts_whichever_side_has_it() -> None:
    two = trimesh.util.concatenate([sheet(0), sheet(0.3)])
    check_known(sheet(0), two, 0.3)


def test_a_bridge_between_two_walls() -> None:
    """It is farthest in its middle, where it has no corner, and no triangle is near all of it."""
    walls = soup([[(x, -9, -9), (x, 9, -9), (x, 0, 18)] for x in (0, 1)])
    bridge = soup([[(0, 0, 0), (1, 0, 0), (1, 0.1, 0)]])
    check_known(trimesh.util.concatenate([walls, bridge]), walls, 0.5)


def test_sizes_that_have_nothing_to_do_with_each_other() -> None:
    speck = creation.box((1e-6, 1e-6, 1e-6))
    check_known(CUBE, speck, 0.5 * 3**0.5 - 0.5e-6 * 3**0.5)


def test_a_spike_that_is_lost() -> None:
    spike = soup([[(0.5, 0.01, 0), (0.5, -0.01, 0), (2.5, 0, 0)]])
    check_known(CUBE, trimesh.util.concatenate([CUBE, spike]), 2.0)


def test_thin_and_huge_triangles() -> None:
    needle = soup([[(0, 0, 0), (1000, 0, 0), (1000, 1e-9, 0)]])
    line = soup([[(0, 0, 1), (1000, 0, 1), (500, 0, 1)]])  # it has no area
    check_known(needle, line, 1.0)
    check_known(line, soup([[(0, 0, 0), (1000, 0, 0), (500, 0, 0)]]), 1.0)
    point = soup([[(3, 4, 0)] * 3])
    check_known(point, soup([[(0, 0, 0)] * 3]), 5.0)


def test_a_simplified_ball() -> None:
    coarse = creation.icosphere(subdivisions=2)
    check_known(BALL, coarse, by_brute_force(coarse.triangles_center, BALL).max())


def test_it_does_not_depend_on_the_frame() -> None:
    a, b = random_soup(1, 30), random_soup(2, 40)
    first = deviation(a, b)
    turn = trimesh.transformations.rotation_matrix(1.1, (1, 2, 3), (5, -4, 2))
    second = deviation(a.copy().apply_transform(turn), b.copy().apply_transform(turn))
    assert abs(first - second) <= RELATIVE_SLACK * min(first, second) + 10 * DIAGONAL_SLACK
    large = deviation(a.copy().apply_scale(1024), b.copy().apply_scale(1024))
    assert large == 1024 * first


def test_it_is_the_same_each_time() -> None:
    a, b = random_soup(3, 60), random_soup(4, 60)
    assert len({deviation(a, b) for _ in range(3)}) == 1


@given(
    seed=st.integers(0, 10**6),
    counts=st.tuples(st.integers(1, 12), st.integers(1, 12)),
    size=st.sampled_from([1e-3, 0.1, 1.0]),
    stretch=st.sampled_from([1e-12, 1e-3, 1.0]),
)
def test_no_sample_is_beyond_it_and_some_sample_is_near_it(
    seed: int, counts: tuple[int, int], size: float, stretch: float
) -> None:
    a = random_soup(seed, counts[0], size, stretch)
    b = random_soup(seed + 1, counts[1], 0.5, stretch)
    divisions = 24
    sampled = max(by_brute_force(samples(one, divisions), to).max() for one, to in ((a, b), (b, a)))
    edge = max(
        np.linalg.norm(np.diff(mesh.triangles[:, [0, 1, 2, 0]], axis=1), axis=2).max()
        for mesh in (a, b)
    )
    between = edge / divisions  # no point of a surface is farther from its samples
    for bound in (deviation(a, b), deviation(b, a)):
        assert sampled - ROUNDING <= bound <= allowed(sampled + between, a, b)


def test_distances_of_points() -> None:
    mesh = random_soup(5, 80)
    points = np.random.default_rng(6).uniform(-2, 2, (200, 3))
    found = distances(points, Surface.of(mesh), np.inf)
    expected = by_brute_force(points, mesh)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(
        distances(points, Surface.of(mesh), 0.5), np.minimum(expected, 0.5), atol=1e-9
    )


def test_meshes_without_a_surface_are_refused() -> None:
    with pytest.raises(MeshError, match="without triangles"):
        deviation(CUBE, trimesh.Trimesh())
    broken = CUBE.copy()
    broken.vertices[3, 1] = np.nan
    with pytest.raises(MeshError, match="not finite"):
        deviation(broken, CUBE)
