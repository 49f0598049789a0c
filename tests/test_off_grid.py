"""Masks among items that are off the grid: cases with a known answer, and the oracle."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from trimesh import transformations

from packit_sim import placement
from packit_sim.core.counters import counters
from packit_sim.engine.collision import collides
from packit_sim.engine.occupancy import Occupancy
from packit_sim.geometry.lattice import CELL, CONTACT_TOLERANCE, STEP, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import BoxState, ItemInBox, PlacedItem, PosedItem
from tests.zoo import BALL, HOLLOW, ZOO, cube_of, random_item

CELLS: Triple = (32, 32, 32)


def lying(item: Item, turn: np.ndarray, *center: float) -> PosedItem:
    """An item in any turn (4, 4), with its centre there."""
    pose = turn * np.cbrt(item.scale)
    pose[:3, 3], pose[3, 3] = center, 1.0
    return PosedItem(item, pose)


def filled(cells: Triple, inside: Sequence[ItemInBox]) -> Occupancy:
    occupancy = Occupancy(cells)
    for one in inside:
        occupancy.add(one)
    return occupancy


def anywhere(rng: np.random.Generator, size: float = 0.2) -> PosedItem:
    """A shape of the zoo in any turn, which may reach through the walls."""
    turn = transformations.random_rotation_matrix(rng.random(3))
    return lying(random_item(ZOO, size, rng), turn, *rng.uniform(0.0, 0.32, 3))


@pytest.mark.parametrize("seed", range(6))
def test_every_location_is_as_the_oracle_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inside = [anywhere(rng) for _ in range(4)]
    occupancy = filled(CELLS, inside)
    before = counters()
    for _ in range(2):
        item = random_item(ZOO, 0.15, rng)
        mask = placement.feasible(occupancy, item)
        assert np.array_equal(mask, placement.oracle(BoxState(CELLS, tuple(inside)), item))
        assert placement.blbf(occupancy, item) == placement.first(mask)
        for at in np.argwhere(np.ones(mask.shape))[rng.permutation(mask.size)[:20]].tolist():
            assert placement.is_feasible(occupancy, PlacedItem(item, tuple(at))) == mask[tuple(at)]
    assert counters().since(before).mesh_comparisons > 0


@pytest.mark.parametrize("seed", range(3))
def test_a_box_may_contain_items_on_the_grid_and_off_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    on_grid = [PlacedItem(random_item(ZOO, 0.15, rng), (0, 4 * n, n)) for n in range(2)]
    inside = [on_grid[0], anywhere(rng), on_grid[1], anywhere(rng)]
    occupancy = filled(CELLS, inside)
    item = random_item(ZOO, 0.12, rng)
    mask = placement.feasible(occupancy, item)
    assert np.array_equal(mask, placement.oracle(BoxState(CELLS, tuple(inside)), item))
    assert placement.blbf(occupancy, item) == placement.first(mask)


@pytest.mark.parametrize("seed", range(3))
def test_items_off_the_grid_can_be_removed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inside = [anywhere(rng) for _ in range(5)]
    occupancy, fewer = filled(CELLS, inside), filled(CELLS, inside[:2])
    occupancy.truncate(2)
    assert occupancy.placed == tuple(inside[:2])
    assert np.array_equal(occupancy.bricks, fewer.bricks)
    item = random_item(ZOO, 0.15, rng)
    assert np.array_equal(placement.feasible(occupancy, item), placement.feasible(fewer, item))
    occupancy.add(inside[2])
    assert np.array_equal(occupancy.bricks, filled(CELLS, inside[:3]).bricks)


@pytest.mark.parametrize("seed", range(2))
def test_bodies_on_the_grid_are_as_placed_items(seed: int) -> None:
    """Two engines, one answer: off the grid is no other rule."""
    rng = np.random.default_rng(seed)
    items = [random_item(ZOO, 0.2, rng) for _ in range(3)]
    placed = [PlacedItem(item, (0, 3 * n, n)) for n, item in enumerate(items)]
    occupancy = filled(CELLS, [PosedItem.of(one) for one in placed])
    item = random_item(ZOO, 0.12, rng)
    mask = placement.feasible(occupancy, item)
    for i, j, k in np.argwhere(np.ones(mask.shape)).tolist():
        assert mask[i, j, k] == placement.is_valid(CELLS, placed, PlacedItem(item, (i, j, k)))


def test_a_cube_on_its_edge_leaves_what_geometry_says() -> None:
    """A cube of 16 cells, turned by 45 degrees about z: of its corners, a square on its tip."""
    side, own = 0.16, 0.04
    upright = transformations.rotation_matrix(math.pi / 4, (0, 0, 1))
    occupancy = filled(CELLS, [lying(cube_of(16), upright, 0.16, 0.16, 0.08)])
    mask = placement.feasible(occupancy, cube_of(4))
    x, y, z = np.indices(mask.shape) * (STEP * CELL)
    across, along = abs(x + own / 2 - 0.16), abs(y + own / 2 - 0.16)
    tip = side / math.sqrt(2)
    apart = np.maximum(np.maximum(across, along) - tip - own / 2, across + along - tip - own)
    clear = np.maximum(apart, z - side)
    sure = abs(clear) > CONTACT_TOLERANCE
    assert np.array_equal(mask[sure], clear[sure] > 0)
    assert mask[~sure].all()  # on top of it: surfaces may touch
    assert 0 < mask[..., 0].sum() < mask[..., 4].sum() == 64


def test_what_is_enclosed_is_not_free_though_no_surface_is_crossed() -> None:
    turn = transformations.rotation_matrix(0.5, (1, 2, 3))
    hollow = lying(Item(HOLLOW, 0.1), turn, 0.16, 0.16, 0.16)
    small = cube_of(2)
    inside = PlacedItem(small, (4, 4, 4))
    assert not collides(inside, hollow)
    assert not placement.is_feasible(filled(CELLS, [hollow]), inside)
    assert placement.conflicts(inside, hollow)


def test_what_left_the_box_blocks_nothing_and_what_reaches_in_does() -> None:
    still = np.eye(4)
    ball = Item(BALL, 0.005)
    gone = [lying(ball, still, *at) for at in ((0.5, 0.1, 0.1), (0.1, -0.4, 0.1), (0.1, 0.1, 0.9))]
    occupancy = filled(CELLS, gone)
    assert len(occupancy.placed) == 3 and not occupancy.bricks.any()
    small = cube_of(4)
    assert placement.feasible(occupancy, small).all()
    through = filled(CELLS, [lying(ball, still, -0.02, 0.02, 0.02)])
    assert np.argwhere(~placement.feasible(through, small)).tolist() == [
        [0, j, k] for j in range(2) for k in range(2)
    ]


def test_too_large_an_item_fits_nowhere() -> None:
    occupancy = filled(CELLS, [])
    large = cube_of(33)
    assert not placement.feasible(occupancy, large).any()
    assert placement.blbf(occupancy, large) is None
    assert not placement.is_feasible(occupancy, PlacedItem(large, (0, 0, 0)))


def test_bodies_are_values() -> None:
    rng = np.random.default_rng(1)
    one = anywhere(rng)
    same, other = (
        PosedItem(one.item, one.matrix.copy()),
        PosedItem(one.item, one.matrix @ np.diag((1, 1, 1, 1.5))),
    )
    assert one == same and hash(one) == hash(same)
    assert one != other and one != one.item
    (kept,) = filled((64, 64, 64), [one]).placed
    assert kept is one
