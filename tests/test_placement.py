"""The exact mask compared with the oracle, for hard shapes in randomly filled boxes."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim import placement
from packit_sim.box import Box
from packit_sim.core import caches
from packit_sim.core.errors import InfeasibleError
from packit_sim.engine.collision import collides
from packit_sim.engine.occupancy import Occupancy
from packit_sim.engine.screening_kernels import open_pairs
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.placement import PlacedItem
from tests.examples import examples
from tests.zoo import BALL, BOWL, CUBE, HOLLOW, PLATE, RING, SOUP, ZOO, cube_of, fill, random_item

EVERYDAY = ShapeLibrary.open("everyday")
seeds = st.integers(0, 2**32 - 1)
box_sizes = st.tuples(*[st.integers(4, 13).map(lambda n: 4 * n)] * 3)


def assert_exact(box: Box, item: Item) -> None:
    mask = box.feasible(item)
    truth = placement.oracle(box, item)
    assert mask.shape == truth.shape and mask.dtype == bool
    assert (mask == truth).all(), f"{(mask != truth).sum()} locations differ for {item} in {box}"
    ranked = sorted(map(tuple, np.argwhere(truth).tolist()), key=lambda at: (at[2], at[0], at[1]))
    assert box.blbf(item) == (ranked[0] if ranked else None)


@given(seeds, box_sizes)
def test_mask_equals_oracle_on_hard_shapes(seed, cells) -> None:
    rng = np.random.default_rng(seed)
    box = Box(cells)
    size = min(cells) / 100
    fill(box, [random_item(ZOO, size, rng) for _ in range(5)], rng)
    assert_exact(box, random_item(ZOO, size, rng))


@given(seeds, box_sizes)
def test_mask_equals_oracle_on_library_meshes(seed, cells) -> None:
    rng = np.random.default_rng(seed)
    shapes = tuple(EVERYDAY[i] for i in rng.choice(EVERYDAY.ids, 4, replace=False))
    box = Box(cells)
    size = min(cells) / 100
    fill(box, [random_item(shapes, size, rng) for _ in range(5)], rng)
    assert_exact(box, random_item(shapes, size, rng))


@given(seeds, st.permutations((512, 12, 16)))
@examples(6)
def test_mask_equals_oracle_in_the_longest_boxes(seed, cells) -> None:
    rng = np.random.default_rng(seed)
    box = Box(cells)
    fill(box, [random_item(ZOO, 0.2, rng) for _ in range(12)], rng)
    assert box.placed
    assert_exact(box, random_item(ZOO, 0.15, rng))


@given(seeds)
@examples(10)
def test_all_rotations_at_once_are_the_masks_one_by_one(seed) -> None:
    rng = np.random.default_rng(seed)
    box = Box((40, 32, 36))
    fill(box, [random_item(ZOO, 0.3, rng) for _ in range(3)], rng)
    item = random_item(ZOO, 0.3, rng)
    together = box.feasible_rotations(item)
    assert together.shape == (24, 10, 8, 9)
    for rotation in rng.choice(24, size=8, replace=False).tolist():
        assert (together[rotation] == placement.oracle(box, item.turned(rotation))).all()
    caches.clear()
    union = box.feasible_in_any(item)
    assert (union == together.any(axis=0)).all()
    for at in np.argwhere(union)[::211].tolist():
        i, j, k = at
        assert (box.rotations_at(item, at) == together[:, i, j, k]).all()
    with pytest.raises(InfeasibleError):
        box.rotations_at(item, (25, 0, 0))


@given(seeds)
@examples(20)
def test_why_not_names_each_wall_and_each_item_that_is_in_the_way(seed) -> None:
    rng = np.random.default_rng(seed)
    box = Box((40, 48, 32))
    fill(box, [random_item(ZOO, 0.3, rng) for _ in range(4)], rng)
    item = random_item(ZOO, 0.35, rng)
    mask = box.feasible(item)
    for location in np.ndindex(mask.shape):
        candidate = PlacedItem(item, location)
        reason = box.why_not(item, location)
        assert bool(reason) is not bool(mask[location])
        assert reason.items == tuple(
            n for n, other in enumerate(box.placed) if placement.conflicts(other, candidate)
        )
        assert reason.walls == tuple(
            wall
            for wall, stop, size in zip(
                ("right", "front", "top"), candidate.stop, box.cells, strict=True
            )
            if stop > size
        )


@pytest.mark.slow
def test_more_items_leave_a_location_open_than_there_is_room_for_at_first() -> None:
    """All locations at once give what each gives alone."""
    box, ball = Box((40, 40, 40)), Item(BALL, 0.03)
    balls = [placement.PlacedItem(Item(BALL, 0.0012), (i, j, k)) for i, j, k in np.ndindex(6, 6, 6)]
    occupancy = Occupancy(box.cells)
    for small in balls:
        occupancy.add(small)
    voxels, placed = ball.voxels, occupancy.placed_arrays
    at = np.zeros((13, 3), np.int64)
    at[0] = 8  # open because of none
    found, expected = open_pairs(voxels.arrays, placed, voxels.number.shape, at), []
    for n in range(len(at)):
        alone = open_pairs(voxels.arrays, placed, voxels.number.shape, at[n : n + 1])
        expected += [(n, item) for _, item in alone.tolist()]
    assert len(found) > 32
    assert found.tolist() == [list(pair) for pair in expected]


def test_why_not_at_no_node_of_the_grid_is_refused() -> None:
    with pytest.raises(InfeasibleError, match="outside the grid"):
        Box().why_not(cube_of(4), (0, 25, 0))


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 3))])
def test_mask_equals_oracle_at_all_15625_locations(seed) -> None:
    """The benchmark's box, filled as agents fill it."""
    rng = np.random.default_rng(seed)
    shapes = tuple(EVERYDAY[i] for i in rng.choice(EVERYDAY.ids, 8, replace=False))
    box = Box()
    for _ in range(7):
        item = random_item(shapes, 0.6, rng)
        location = box.blbf(item)
        if location is not None:
            box.place(item, location)
    assert len(box.placed) >= 6
    assert_exact(box, random_item(shapes, 0.4, rng))


def feasible_at(box: Box, item: Item, location: tuple[int, int, int]) -> bool:
    """The mask's answer, agreed on by the oracle and by the single query."""
    candidate = PlacedItem(item, location)
    answers = {
        bool(box.feasible(item)[location]),
        placement.is_valid(box.cells, box.placed, candidate),
        box.is_feasible(item, location),
    }
    assert len(answers) == 1
    return answers.pop()


def test_a_ball_goes_through_a_ring_but_not_into_its_tube() -> None:
    box = Box()
    ring = Item(RING, 0.7**3)  # stands on its edge or lies: here it lies
    assert ring.cells[2] < ring.cells[0]
    box.place(ring, (2, 2, 2))
    small = Item(BALL, 0.15**3)
    in_the_hole = tuple(2 + (own - c) // 8 for own, c in zip(ring.cells, small.cells, strict=True))
    assert feasible_at(box, small, in_the_hole)
    tiny = Item(BALL, 0.02**3)
    steps = np.argwhere(ring.inner) // 4
    within = [at for at in np.unique(steps, axis=0) if ring.inner[_cells(at, tiny)].all()]
    assert within
    assert not any(feasible_at(box, tiny, tuple((at + 2).tolist())) for at in within)


def _cells(node: np.ndarray, item: Item) -> tuple[slice, ...]:
    return tuple(slice(4 * n, 4 * n + c) for n, c in zip(node, item.cells, strict=True))


def test_what_is_wholly_inside_a_solid_is_rejected_though_no_surfaces_meet() -> None:
    """FCL sees no contact there: only enclosed cells show it."""
    for outside in (cube_of(40), Item(BALL, 0.6**3), Item(HOLLOW, 0.7**3)):
        inside = Item(CUBE, 0.05**3)
        middle = tuple(1 + c // 8 for c in outside.cells)
        host, guest = PlacedItem(outside, (1, 1, 1)), PlacedItem(inside, middle)
        assert not collides(host, guest)
        box = Box()
        box.place(outside, (1, 1, 1))
        assert not feasible_at(box, inside, middle)
        box.clear()
        box.place(inside, middle)
        assert not feasible_at(box, outside, (1, 1, 1))


def test_a_ball_rests_in_an_open_bowl() -> None:
    box = Box()
    bowl = Item(BOWL, 0.8**3)
    box.place(bowl, (2, 2, 2))
    ball = Item(BALL, 0.2**3)
    free = box.feasible(ball)
    inside = [
        (i, j, k)
        for i, j, k in np.argwhere(free).tolist()
        if all(
            4 * n > 8 and 4 * n + own < 8 + c
            for n, own, c in zip((i, j, k), ball.cells, bowl.cells, strict=True)
        )
        and math.dist((4 * i, 4 * j), (8 + bowl.cells[0] / 2,) * 2) < bowl.cells[0] / 4
    ]
    assert inside, "the ball fits into the bowl, within its bounding box"
    assert all(feasible_at(box, ball, at) for at in inside)


def test_cubes_that_touch_face_to_face_are_no_conflict() -> None:
    box = Box()
    box.place(cube_of(20), (5, 5, 5))
    for axis in range(3):
        for step in (-5, 5):
            location = [5, 5, 5]
            location[axis] += step
            assert feasible_at(box, cube_of(20), tuple(location))
            location[axis] -= step // 5
            assert not feasible_at(box, cube_of(20), tuple(location))


def test_cubes_of_whole_grid_steps_fill_the_box_to_the_brim() -> None:
    box = Box((60, 80, 100))
    while (location := box.blbf(cube_of(20))) is not None:
        box.place(cube_of(20), location)
    assert len(box.placed) == 60
    assert box.density == pytest.approx(1)


def test_cubes_are_placed_one_behind_the_other_in_a_row_of_more_than_64_locations() -> None:
    box = Box((24, 300, 24))
    for j in range(0, 75, 5):
        assert box.blbf(cube_of(20)) == (0, j, 0)
        box.place(cube_of(20), (0, j, 0))
    assert box.blbf(cube_of(20)) is None


def test_overlap_up_to_the_tolerance_is_contact_and_beyond_it_a_conflict() -> None:
    """A cube of just over 24 cells is centred in a cell box of 25.

    So one on a node 24 cells further overlaps it by what each is larger than 24 cells.
    """
    for overlap, expected in ((0.9e-4, False), (1.1e-4, True)):
        cube = cube_of(24 + 100 * overlap)
        assert cube.cells == (25, 25, 25)
        neighbour = PlacedItem(cube, (6, 0, 0))
        assert placement.conflicts(PlacedItem(cube, (0, 0, 0)), neighbour) is expected


@pytest.mark.parametrize("shape", [PLATE, SOUP], ids=lambda s: s.id)
def test_thin_and_broken_meshes_keep_off_what_crosses_them(shape) -> None:
    box = Box()
    box.place(Item(shape, 0.8**3), (1, 1, 1))
    mask = box.feasible(Item(CUBE, 0.1**3))
    assert mask.any() and not mask.all()
    assert_exact(box, Item(CUBE, 0.1**3))


def test_what_is_larger_than_the_box_is_feasible_nowhere() -> None:
    box = Box()
    for item in (cube_of(101), Item(CUBE, 1e6), Item(CUBE, 1e300)):
        assert not box.feasible(item).any()
        assert box.blbf(item) is None


@given(seeds)
def test_placing_never_frees_a_location(seed) -> None:
    rng = np.random.default_rng(seed)
    box = Box((48, 48, 48))
    item = random_item(ZOO, 0.3, rng)
    before = box.feasible(item)
    for _ in range(4):
        fill(box, [random_item(ZOO, 0.4, rng)], rng)
        after = box.feasible(item)
        assert not (after & ~before).any()
        before = after


@given(seeds)
def test_collision_is_symmetric_and_the_same_everywhere(seed) -> None:
    rng = np.random.default_rng(seed)
    a, b = (random_item(ZOO, 0.4, rng) for _ in range(2))
    offset = rng.integers(-3, 4, size=3)
    answers = set()
    for _ in range(4):
        at = rng.integers(3, 9, size=3)
        first = PlacedItem(a, tuple(at.tolist()))
        second = PlacedItem(b, tuple((at + offset).tolist()))
        answers |= {placement.conflicts(first, second), placement.conflicts(second, first)}
    assert len(answers) == 1
