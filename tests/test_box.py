import itertools
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim import placement
from packit_sim.box import Box
from packit_sim.core.errors import InfeasibleError
from packit_sim.engine.occupancy import Occupancy
from packit_sim.engine.occupancy_kernels import BoxArrays
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import unpack
from packit_sim.placement import BoxState
from tests.zoo import BALL, CUBE, RING, ZOO, cube_of, fill, random_item

seeds = st.integers(0, 2**32 - 1)


def fine_cells(box: BoxArrays) -> np.ndarray:
    """Words (bricks, 64, 2) of the cells that are outer and not inner, 0 elsewhere."""
    bits = np.arange(64, dtype=np.uint64)
    outer, inner = ((words[:, None] >> bits) & 1 for words in box.bricks)
    surface = (outer == 1) & (inner == 0)
    assert ((box.page >= 0) | ~surface.any(axis=1)).all()
    return np.where(surface[..., None], box.fine[box.page], 0)


def fine_cells_by_place(box: BoxArrays) -> tuple[np.ndarray, np.ndarray]:
    """The outer and the inner fine cells of the whole box: bool [x, y, z]."""
    inner = unpack(box.bricks[1].reshape(-1, box.nx, box.ny).transpose(1, 2, 0))
    x, y, z = np.indices(inner.shape)
    brick = ((z >> 2) * box.nx + (x >> 2)) * box.ny + (y >> 2)
    fine = fine_cells(box)[brick, 16 * (x & 3) + 4 * (y & 3) + (z & 3)]
    fine[inner] = np.uint64(2**64 - 1)
    return unpack(fine[..., 0]), unpack(fine[..., 1])


def random_box(rng: np.random.Generator) -> Box:
    box = Box((64, 48, 56))
    fill(box, [random_item(ZOO, 0.4, rng) for _ in range(6)], rng)
    return box


@given(seeds)
def test_what_is_accepted_is_inside_disjoint_and_not_denser_than_1(seed) -> None:
    box = random_box(np.random.default_rng(seed))
    assert box.placed
    assert 0 < box.density <= 1
    for placed in box.placed:
        corners = placed.item.mesh.bounds + placed.center
        assert (corners >= -1e-8).all() and (corners <= box.size + 1e-8).all()
    for a, b in itertools.combinations(box.placed, 2):
        assert not placement.conflicts(a, b)


@given(seeds)
def test_pose_puts_the_canonical_mesh_in_its_place(seed) -> None:
    for placed in random_box(np.random.default_rng(seed)).placed:
        canonical = placed.item.shape.mesh.vertices
        there = canonical @ placed.matrix[:3, :3].T + placed.matrix[:3, 3]
        assert np.allclose(there, placed.item.mesh.vertices + placed.center, atol=1e-12)
        middle = np.array(placed.location) / 25 + np.array(placed.item.cells) / 200
        assert np.allclose((there.min(axis=0) + there.max(axis=0)) / 2, middle)


@given(seeds)
def test_snapshot_mutate_restore_is_the_identity(seed) -> None:
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    item = random_item(ZOO, 0.3, rng)
    before, mask, density = box.snapshot(), box.feasible(item), box.density
    for _ in range(rng.integers(1, 4)):
        if box.placed:
            box.undo()
    fill(box, [random_item(ZOO, 0.3, rng) for _ in range(3)], rng)
    box.restore(pickle.loads(pickle.dumps(before)))
    assert box.placed == before.placed == box.snapshot().placed
    assert box.density == density
    assert (box.feasible(item) == mask).all()


@given(seeds)
def test_undo_takes_out_the_last_item_and_only_it(seed) -> None:
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    states = [box.snapshot()]
    while box.placed:
        last = box.placed[-1]
        assert box.undo() == last
        states.append(box.snapshot())
    for state in reversed(states):
        box.restore(state)
        assert box.snapshot() == state
    with pytest.raises(IndexError, match="empty"):
        Box().undo()


def assert_fine_cells_are_those_of_the_items(occupancy: Box | Occupancy) -> None:
    outer, inner = np.zeros((2, *(4 * np.array(occupancy.cells))), dtype=bool)
    for placed in occupancy.placed:
        where = tuple(slice(4 * a, 4 * b) for a, b in zip(placed.start, placed.stop, strict=True))
        outer[where] |= placed.item.voxels.outer_fine
        inner[where] |= placed.item.voxels.inner_fine
    assert outer.any() and inner.any()
    found = fine_cells_by_place(BoxArrays(*occupancy.arrays))
    assert (found[0] == outer).all() and (found[1] == inner).all()


@pytest.mark.parametrize("seed", range(3))
def test_fine_cells_of_a_box_are_those_of_its_items(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    box.undo()
    fill(box, [random_item(ZOO, 0.3, rng) for _ in range(3)], rng)
    assert_fine_cells_are_those_of_the_items(box)


def test_fine_cells_of_items_in_the_same_bricks_are_joined() -> None:
    occupancy = Occupancy((24, 24, 24))
    for item in (Item(BALL, 0.0025), Item(RING, 0.004), cube_of(5.3)):
        occupancy.add(placement.PlacedItem(item, (1, 1, 1)))
        assert_fine_cells_are_those_of_the_items(occupancy)


def test_density_is_placed_volume_over_the_boxs() -> None:
    box = Box((80, 40, 40))
    box.place(cube_of(20), (0, 0, 0))
    assert box.density == pytest.approx(0.2**3 / (0.8 * 0.4 * 0.4))
    box.clear()
    assert box.density == 0 and box.placed == ()


@pytest.mark.parametrize(
    ("location", "message"),
    [
        ((25, 0, 0), r"\(25, 0, 0\) is outside the grid.*\(24, 24, 24\)"),
        ((0, -1, 0), "outside the grid"),
        ((0, 0), "three whole numbers"),
        ((0, 0, 0.5), "three whole numbers"),
        (None, "three whole numbers"),
        ((24, 24, 24), "not inside the box.*20"),
        ((1, 1, 1), r"in conflict with placed item 0 \('ring'\)"),
    ],
)
def test_where_an_item_cannot_be_placed_it_says_why_and_changes_nothing(location, message) -> None:
    box = Box()
    box.place(Item(RING, 0.5**3), (0, 0, 0))
    before = box.snapshot()
    with pytest.raises(InfeasibleError, match=message):
        box.place(cube_of(20), location)
    assert box.snapshot() == before
    box.restore(before)  # which compares the cells with those of the items


def test_a_mesh_larger_than_the_box_is_refused() -> None:
    box = Box()
    with pytest.raises(InfeasibleError, match=r"needs \(101, 101, 101\) cells"):
        box.place(cube_of(101), (0, 0, 0))
    with pytest.raises(InfeasibleError, match="not inside the box"):
        box.place(Item(CUBE, 1e9), (0, 0, 0))
    assert box.placed == ()


@pytest.mark.parametrize("cells", [(100, 100), (100, 100, 99), (0, 4, 4), (516, 4, 4), "box", 100])
def test_impossible_boxes_are_refused(cells) -> None:
    with pytest.raises(ValueError, match=r"multiple of 4|three whole numbers"):
        Box(cells)


def test_boxes_of_other_sizes_have_masks_of_their_grid() -> None:
    box = Box((8, 512, 20))
    mask = box.feasible(cube_of(8))
    assert mask.shape == box.nodes == (2, 128, 5)
    assert mask.sum() == 1 * 127 * 4
    assert box.place(cube_of(8), (0, 126, 3)).center == pytest.approx((0.04, 5.08, 0.16))


def test_a_snapshot_of_another_box_is_refused() -> None:
    with pytest.raises(ValueError, match="can't be restored"):
        Box().restore(BoxState((40, 40, 40), ()))


def test_locations_may_be_numpy_integers() -> None:
    box = Box()
    placed = box.place(Item(BALL, 0.2**3), np.array([1, 2, 3]))
    assert placed.location == (1, 2, 3)
    assert all(type(n) is int for n in placed.location)
    assert math.isclose(placed.center[0], 0.04 + placed.item.cells[0] / 200)


def test_a_kinematic_box_wants_a_free_way_down_whatever_it_is_asked() -> None:
    box = Box((40, 40, 40), kinematic=True)
    box.place(cube_of(8), (4, 4, 5))
    small = cube_of(4)
    mask = box.feasible(small)
    assert not mask[4, 4, 0] and mask[4, 4, 7] and mask[3, 4, 0]
    assert box.blbf(small) == (0, 0, 0)
    assert np.array_equal(box.feasible_in_any(small), mask)
    assert np.array_equal(box.feasible_rotations(small)[7], mask)
    assert not box.rotations_at(small, (4, 4, 0)).any() and box.rotations_at(small, (3, 4, 0)).all()
    assert box.why_not(small, (4, 4, 0)) == placement.Blockers((), (), above=(0,))
    assert box.why_not(small, (4, 4, 5)).items == (0,) and not box.why_not(small, (3, 4, 0))
    with pytest.raises(InfeasibleError, match=r"come down from above: placed item 0 \('cube'\) is"):
        box.place(small, (4, 4, 0))
    assert len(box.placed) == 1


def test_blbf_of_a_kinematic_box_is_the_first_of_its_mask() -> None:
    rng = np.random.default_rng(2)
    box = Box((32, 32, 32), kinematic=True)
    for _ in range(6):
        item = random_item(ZOO, 0.3, rng)
        mask = box.feasible(item)
        free = [(k, i, j) for i, j, k in np.argwhere(mask).tolist()]
        location = box.blbf(item)
        assert location == ((min(free)[1], min(free)[2], min(free)[0]) if free else None)
        if location:
            box.place(item, location)
    assert len(box.placed) >= 2


def test_a_search_may_begin_where_the_last_one_ended_when_less_was_in_the_box() -> None:
    rng = np.random.default_rng(7)
    box = Box((48, 40, 44))
    asked = [random_item(ZOO, 0.4, rng) for _ in range(6)]
    found: list[tuple[int, int, int] | None] = [(0, 0, 0)] * len(asked)
    gone = 0
    for _ in range(20):
        box.fill(random_item(ZOO, 0.25, rng))
        for n, item in enumerate(asked):
            start = found[n]
            whole = box.blbf(item)
            if start is not None:
                found[n] = box.blbf(item, start)
            assert found[n] == whole
            gone += whole is None
    assert gone


def test_fill_places_where_blbf_says_or_not_at_all() -> None:
    box = Box((8, 8, 8))
    assert box.fill(cube_of(8)) == box.placed[0] and box.placed[0].location == (0, 0, 0)
    assert box.fill(cube_of(4)) is None and len(box.placed) == 1
