"""The kinematic rule: cases with a known answer, the oracle, and lifting in small steps."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_sim.box import Box
from packit_sim.engine import insertion
from packit_sim.engine.insertion import is_insertable
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.placement import PlacedItem
from tests.examples import examples
from tests.zoo import BALL, BOWL, RING, ZOO, cube_of

EVERYDAY = ShapeLibrary.open("everyday")


def packed(rng: np.random.Generator, items: list[Item], cells: tuple[int, int, int]) -> Box:
    """A box with each item that fits at any feasible location, by chance."""
    box = Box(cells)
    for item in items:
        locations = np.argwhere(box.feasible(item))
        if len(locations):
            box.place(item, locations[rng.integers(len(locations))])
    return box


def lifted_by_steps(box: Box, item: Item, location: tuple[int, int, int]) -> bool:
    """Decide whether all grid steps on the way up are feasible; for a clear item they are."""
    tall = Box((*box.cells[:2], 2 * box.cells[2] + 100))
    for placed in box.placed:
        tall.place(placed.item, placed.location)
    i, j, k = location
    return all(tall.feasible(item)[i, j, level] for level in range(k, box.nodes[2]))


def test_an_item_under_a_shelf_is_not_clear_and_one_next_to_it_is() -> None:
    box = Box((40, 40, 40))
    box.place(cube_of(8), (4, 4, 5))
    small = cube_of(4)
    mask = box.feasible(small)
    clear = insertion.insertable_mask(box.placed, small, mask)
    assert mask[4, 4, 0] and not clear[4, 4, 0] and not clear[5, 4, 3]
    assert clear[3, 4, 0] and clear[6, 4, 0]  # next to it: sides may touch on the way
    assert clear[4, 4, 7] and not mask[4, 4, 6]
    assert (mask & ~clear).sum() == 2 * 2 * 5  # under its 2 x 2 grid steps, on 5 levels


def test_a_ball_in_a_bowl_is_clear_and_under_one_turned_over_it_is_not() -> None:
    ball = Item(Shape.from_mesh(creation.icosphere(subdivisions=2), "ball"), 0.001)
    for rotation, expected in ((0, True), (4, False)):
        bowl = Item(BOWL, 0.2, rotation)
        box = Box()
        box.place(bowl, (0, 0, 0))
        inside = [
            tuple(at)
            for at in np.argwhere(box.feasible(ball)).tolist()
            if all(
                4 * n >= 0.3 * c and 4 * n + b <= 0.7 * c
                for n, c, b in zip(at[:2], bowl.cells[:2], ball.cells[:2], strict=True)
            )
            and 4 * at[2] + ball.cells[2] <= bowl.cells[2]
        ]
        if inside:
            found = insertion.insertable_mask(box.placed, ball, box.feasible(ball))
            assert any(found[at] for at in inside) == expected


def test_a_thin_plate_above_covers_a_thin_one_below() -> None:
    """Neither has inner cells: the meshes decide, and no surface crosses another."""
    plate = Item(Shape.from_mesh(creation.box((1, 1, 0.01)), "plate"), 0.02)
    box = Box()
    box.place(plate, (0, 0, 5))
    found = insertion.insertable_mask(box.placed, plate, box.feasible(plate))
    width = -(-plate.cells[0] // 4)
    assert not found[0, 0, 0] and not found[width - 1, 0, 3]
    assert found[width, 0, 0] and found[0, 0, 6]


def test_sheets_that_stand_upright_cover_what_is_straight_below_them() -> None:
    """All their triangles are lines when seen from above."""
    tube = creation.cylinder(radius=0.5, height=0.6, sections=12)
    walls = tube.submesh([np.flatnonzero(np.abs(tube.face_normals[:, 2]) < 0.5)], append=True)
    pipe = Item(Shape.from_mesh(walls, "pipe"), 0.02)
    box = Box()
    box.place(pipe, (0, 0, 12))
    found = insertion.insertable_mask(box.placed, pipe, box.feasible(pipe))
    width = -(-pipe.cells[0] // 4)
    assert not found[0, 0, 0] and not found[1, 0, 0] and found[width, 0, 0] and found[0, 0, 20]


def test_hooks_hold_each_other() -> None:
    """A ring through a ring can't be lifted out; the same next to it can."""
    ring = Item(RING, 0.05, 4)
    box = Box()
    box.place(ring, (5, 5, 0))
    other = Item(RING, 0.05, 8)
    mask = box.feasible(other)
    found = insertion.insertable_mask(box.placed, other, mask)
    assert found.any() and not found.all()
    for at in np.argwhere(mask & ~found)[::97].tolist():
        assert not insertion.is_insertable_oracle(box.placed, PlacedItem(other, tuple(at)))


@examples(8)
@given(st.integers(0, 2**32 - 1))
def test_every_location_is_as_the_oracle_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    items = [
        Item(ZOO[rng.integers(len(ZOO))], rng.uniform(0.06, 0.16) ** 3, int(rng.integers(24)))
        for _ in range(4)
    ]
    box = packed(rng, items[:3], (24, 24, 24))
    mask = box.feasible(items[3])
    found = insertion.insertable_mask(box.placed, items[3], mask)
    assert not (found & ~mask).any()
    locations = [tuple(at) for at in np.argwhere(mask).tolist()]
    for at in [locations[n] for n in rng.permutation(len(locations))[:4]]:
        candidate = PlacedItem(items[3], at)
        assert found[at] == insertion.is_insertable_oracle(box.placed, candidate)
        assert found[at] == is_insertable(box.placed, candidate)
        if found[at]:
            assert lifted_by_steps(box, items[3], at)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_everyday_shapes_as_the_oracle_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ids = [EVERYDAY.ids[n] for n in rng.integers(len(EVERYDAY), size=7)]
    items = [Item(EVERYDAY[id], 0.02, int(rng.integers(24))) for id in ids]
    box = packed(rng, items[:6], (40, 40, 40))
    mask = box.feasible(items[6])
    found = insertion.insertable_mask(box.placed, items[6], mask)
    locations = [tuple(at) for at in np.argwhere(mask).tolist()]
    for at in [locations[n] for n in rng.permutation(len(locations))[:2]]:
        assert found[at] == insertion.is_insertable_oracle(box.placed, PlacedItem(items[6], at))
        if found[at]:
            assert lifted_by_steps(box, items[6], at)


def test_the_answer_is_a_matter_of_the_two_items_alone() -> None:
    rng = np.random.default_rng(5)
    one, other = (Item(ZOO[n], 0.01, 3) for n in (1, 2))
    for _ in range(30):
        apart = rng.integers(-5, 6, size=3)
        answers = {
            is_insertable([PlacedItem(other, tuple(at + apart))], PlacedItem(one, tuple(at)))
            for at in (np.array((6, 6, 6)), np.array((9, 7, 12)))
        }
        assert len(answers) == 1


@pytest.mark.slow
def test_points_above_one_another_are_found() -> None:
    """A separate witness: points all over the one, triangles of the other seen from above."""
    rng = np.random.default_rng(1)
    ball, ring = Item(BALL, 0.05), Item(RING, 0.05)
    points = trimesh.sample.sample_surface(ring.mesh, 1000, seed=0)[0]
    found = missed = 0
    for _ in range(40):
        item, other = (
            PlacedItem(ball, (9, 9, 9)),
            PlacedItem(ring, tuple(rng.integers(5, 14, size=3))),
        )
        triangles = np.asarray(ball.mesh.triangles) + item.center
        below = (heights(points + other.center, triangles) < 0).any()
        answer = not is_insertable([other], item)
        assert answer or not below
        found += below
        missed += answer and not below
    assert found > 10 and missed <= 1


def heights(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """How far each triangle is above each point, seen from above; nan where not over it."""
    a, b, c = (triangles[:, n, :] for n in range(3))
    to = points[:, None, :2] - a[:, :2]
    u, v = (b - a)[:, :2], (c - a)[:, :2]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (to[..., 0] * v[:, 1] - to[..., 1] * v[:, 0]) / area
        t = (u[:, 0] * to[..., 1] - u[:, 1] * to[..., 0]) / area
        over = (s >= 0) & (t >= 0) & (s + t <= 1)
        z = a[:, 2] + s * (b - a)[:, 2] + t * (c - a)[:, 2]
    return np.where(over, z - points[:, None, 2], np.nan)
