"""Proofs that surfaces cross, or that they don't, agree with FCL."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim.engine.collision import collides, contains, surfaces_conflict, surfaces_conflicts
from packit_sim.engine.collision_meshes import collision_mesh
from packit_sim.engine.crossing_kernels import APART, CROSSING, UNSURE, relation
from packit_sim.engine.pairs import Pair, canonical, matrix, relative_turn, shifts_at
from packit_sim.engine.region_kernels import relation_in, workspace
from packit_sim.engine.screening_kernels import shared_fine_cells
from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELL, FINE
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from tests.examples import examples
from tests.zoo import ZOO, cube_of, random_item

SEEDS = st.integers(0, 2**32 - 1)


def proof(one: PlacedItem, other: PlacedItem) -> int:
    pair = Pair.of(one, other)
    turn, to_first = relative_turn(pair.item.rotation, pair.other.rotation)
    trees = collision_mesh(pair.item).tree, collision_mesh(pair.other).tree
    everywhere = np.array([[-9.0] * 3, [9.0] * 3])
    return int(relation(*trees, turn, to_first @ pair.shift, everywhere))


@examples(150)
@given(seed=SEEDS)
def test_what_is_proved_is_what_fcl_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = random_item(ZOO, 0.3, rng), random_item(ZOO, 0.3, rng)
    for _ in range(10):
        i, j, k = rng.integers(0, 9, 3).tolist()
        pair = PlacedItem(one, (4, 4, 4)), PlacedItem(other, (i, j, k))
        assert proof(*pair) in (UNSURE, CROSSING if collides(*pair) else APART)


@examples(100)
@given(seed=SEEDS, same=st.booleans())
def test_many_offsets_are_decided_as_each_is_alone(seed: int, same: bool) -> None:
    rng = np.random.default_rng(seed)
    item = random_item(ZOO, 0.3, rng)
    other = PlacedItem(item if same else random_item(ZOO, 0.3, rng), (4, 4, 4))
    locations = rng.integers(0, 9, (10, 3))
    found = surfaces_conflicts(item, locations, other).tolist()
    for at, conflict in zip(locations.tolist(), found, strict=True):
        candidate = PlacedItem(item, tuple(at))
        assert surfaces_conflict(candidate, other) == conflict
        assert (collides(candidate, other) or contains(candidate, other)) == conflict


def test_real_meshes_are_nearly_always_decided_without_fcl() -> None:
    library = ShapeLibrary.open("everyday")
    rng = np.random.default_rng(0)
    shapes = tuple(library[library.ids[n]] for n in rng.integers(len(library.ids), size=6))
    found = []
    for _ in range(200):
        one, other = (random_item(shapes, 0.3, rng) for _ in range(2))
        i, j, k = rng.integers(0, 9, 3).tolist()
        pair = PlacedItem(one, (4, 4, 4)), PlacedItem(other, (i, j, k))
        found.append(proof(*pair))
        assert found[-1] in (UNSURE, CROSSING if collides(*pair) else APART)
    assert found.count(UNSURE) <= 2 and min(found.count(APART), found.count(CROSSING)) > 20


def test_surfaces_that_touch_or_coincide() -> None:
    cube = cube_of(20)
    beside = PlacedItem(cube, (0, 0, 0)), PlacedItem(cube, (5, 0, 0))
    assert proof(*beside) == APART  # collision meshes are shrunk
    same = PlacedItem(cube, (2, 2, 2)), PlacedItem(cube.turned(9), (2, 2, 2))
    assert proof(*same) == UNSURE  # no edge passes through the inside of a triangle
    assert surfaces_conflict(*same)
    corner = PlacedItem(cube, (0, 0, 0)), PlacedItem(cube_of(24), (2, 3, 1))
    assert proof(*corner) == CROSSING


@pytest.mark.parametrize("rotation", range(0, rotations.COUNT, 5))
@pytest.mark.parametrize("other", range(1, rotations.COUNT, 4))
def test_relative_rotations(rotation: int, other: int) -> None:
    turn, to_first = relative_turn(rotation, other)
    point = np.array([1.0, 2.0, 3.0])
    expected = matrix(rotation).T @ matrix(other) @ point
    assert (turn[1] * point[turn[0]] == expected).all()
    assert (to_first == matrix(rotation).T).all()


@pytest.mark.slow
def test_where_cells_are_shared_decides_as_everywhere() -> None:
    """By pairs of triangles there, by trees there, and by trees everywhere, with real meshes."""
    library = ShapeLibrary.open("everyday")
    rng = np.random.default_rng(1)
    shapes = tuple(library[library.ids[n]] for n in rng.integers(len(library.ids), size=8))
    everywhere = np.array([[-9.0] * 3, [9.0] * 3])
    cells, densest = np.empty((2, 2, 3), dtype=np.int64)
    found, crowded, at_once = [], 0, 0
    for _ in range(1000):
        one, other = (random_item(shapes, 0.4, rng) for _ in range(2))
        i, j, k = rng.integers(0, 12, 3).tolist()
        a, b, offset = canonical(PlacedItem(one, (4, 4, 4)), PlacedItem(other, (i, j, k)))
        turn, to_first = relative_turn(a.rotation, b.rotation)
        trees = collision_mesh(a).tree, collision_mesh(b).tree
        pose = turn, to_first @ shifts_at(a, b, np.array(offset))
        expected = relation(*trees, *pose, everywhere)
        bricks = a.voxels.fixed_arrays, b.voxels.arrays
        if not shared_fine_cells(*bricks, np.array(offset), cells, densest):
            assert expected == APART
            continue
        low, high = densest // 4 * 4
        assert (high == low + 4).all()
        assert ((low < cells[1]) & (high > cells[0])).all()
        small, region = (_bounds(part, a, to_first) for part in (densest, cells))
        in_cell = relation_in(*trees, *pose, small, workspace())
        assert in_cell in (APART, expected)
        at_once += in_cell == CROSSING
        assert relation(*trees, *pose, region) == expected
        by_pairs = relation_in(*trees, *pose, region, workspace())
        crowded += by_pairs == -1
        assert by_pairs in (-1, expected)
        found.append(expected)
    assert found.count(APART) > 5 and found.count(CROSSING) > 50 and 5 < crowded < 200
    assert found.count(CROSSING) / 2 < at_once < found.count(CROSSING)


def _bounds(cells: Ints, item: Item, to_first: Floats) -> Floats:
    """Return the box of fine cells of an item's cell box, in the frame of its shape."""
    corners = to_first @ (cells * FINE - np.array(item.cells) / 2 * CELL).T
    return np.stack((corners.min(axis=1), corners.max(axis=1)))
