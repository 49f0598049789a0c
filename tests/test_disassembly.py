"""Insertion and removal, and the swept test: cases solved by hand, and small steps."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_sim.box import Box
from packit_sim.engine.collision_meshes import LooseMesh
from packit_sim.engine.disassembly import disassemble, find_route
from packit_sim.engine.sweeping import AxisNumber, cyclic, free_distance, least_rise_oracle, surface
from packit_sim.geometry.lattice import CONTACT_TOLERANCE, Triple
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import PlacedItem
from tests.examples import examples
from tests.zoo import BALL, BOWL, RING, ZOO, cube_of

SEEDS = st.integers(0, 2**32 - 1)


def of_blocks(name: str, *blocks: tuple[Triple, Triple]) -> Item:
    """Blocks from a low to a high corner, in cells, as one item of just that size."""
    meshes = [creation.box(bounds=np.array((low, high), dtype=float) / 100) for low, high in blocks]
    mesh = trimesh.util.concatenate(meshes)
    return Item(Shape.from_mesh(mesh, name), float(np.linalg.norm(mesh.extents)) ** 3)


def block(x: int, y: int, z: int) -> Item:
    return of_blocks(f"block-{x}-{y}-{z}", ((0, 0, 0), (x, y, z)))


def box_of(cells: Triple, *placed: tuple[Item, Triple]) -> Box:
    box = Box(cells)
    for item, location in placed:
        box.place(item, location)
    return box


BRIDGE = of_blocks(
    "bridge", ((0, 0, 0), (4, 20, 16)), ((24, 0, 0), (28, 20, 16)), ((0, 0, 16), (28, 20, 20))
)
FRAME = of_blocks(
    "frame",
    ((0, 0, 0), (20, 4, 4)),
    ((0, 16, 0), (20, 20, 4)),
    ((0, 4, 0), (4, 16, 4)),
    ((16, 4, 0), (20, 16, 4)),
)
POST = block(4, 4, 24)
DUMBBELL = of_blocks(
    "dumbbell",
    ((0, 0, 0), (20, 20, 4)),
    ((8, 8, 4), (12, 12, 20)),
    ((0, 0, 20), (20, 20, 24)),
)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_space_between_cubes(axis: AxisNumber) -> None:
    """Hand-solved: 10 cells wide each, their centres 25 apart; drawn in, they have a bit more."""
    cube = cube_of(10)
    offset = np.zeros(3)
    offset[axis] = 0.25
    offset[(axis + 1) % 3] = 0.05
    found = free_distance(cube, cube, offset, axis, forward=True)
    assert found == pytest.approx(0.15 + CONTACT_TOLERANCE, abs=1e-9)
    assert free_distance(cube, cube, -offset, axis, forward=False) == pytest.approx(found, abs=1e-9)
    assert free_distance(cube, cube, offset, axis, forward=False) == math.inf
    shifted = offset.copy()
    shifted[(axis + 1) % 3] = 0.1
    assert free_distance(cube, cube, shifted, axis, forward=True) == math.inf


def test_the_space_of_a_ball_in_a_bowl() -> None:
    """Its lowest point is over the lowest of the bowl: that is where they meet."""
    ball, bowl = Item(BALL, 0.001), Item(BOWL, 1.0)
    low, high = -bowl.extents[2] / 2, ball.extents[2] / 2
    found = free_distance(ball, bowl, np.array((0.0, 0.0, -0.2)), 2, forward=False)
    assert found == pytest.approx(-high - (low - 0.2), abs=0.002)


@examples(12)
@given(SEEDS)
def test_the_tree_says_what_all_pairs_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = (Item(ZOO[n], 0.1, int(rng.integers(24))) for n in rng.integers(len(ZOO), size=2))
    offset = rng.uniform(-0.4, 0.4, 3)
    axis: AxisNumber = rng.choice((0, 1, 2)).item()
    plain = least_rise_oracle(surface(one, axis), surface(other, axis), offset[cyclic(axis)])
    assert free_distance(one, other, offset, axis, forward=True) == pytest.approx(plain, abs=1e-12)


@examples(12)
@given(SEEDS)
def test_the_space_is_free_and_maximal(seed: int) -> None:
    """FCL's witness: no crossing on the way, and one just behind its end."""
    rng = np.random.default_rng(seed)
    one, other = (Item(ZOO[n], 0.1, int(rng.integers(24))) for n in rng.integers(len(ZOO), size=2))
    axis: AxisNumber = rng.choice((0, 1, 2)).item()
    offset = rng.uniform(-0.2, 0.2, 3)
    offset[axis] = 0.9
    found = free_distance(one, other, offset, axis, forward=True)
    along = np.zeros(3)
    along[axis] = 1.0
    meshes = [
        LooseMesh(
            surface(item).triangles.reshape(-1, 3),
            np.arange(3 * len(item.mesh.faces)).reshape(-1, 3),
        )
        for item in (one, other)
    ]
    end = min(found, 1.8)
    for share in np.linspace(0, 1, 30):
        assert not meshes[0].crosses(meshes[1], offset - along * share * (end - 1e-6))
    if found < math.inf:
        behind = [offset - along * (found + depth) for depth in (1e-6, 1e-5, 1e-4, 1e-3)]
        assert any(meshes[0].crosses(meshes[1], shift) for shift in behind)


def test_what_stands_alone_goes_straight_up() -> None:
    box = box_of((40, 40, 40), (cube_of(8), (2, 2, 0)), (cube_of(8), (2, 2, 2)))
    assert find_route([], box.placed[0], box.cells) == ((2, 2, 0),)
    assert find_route(box.placed[:1], box.placed[1], box.cells) == ((2, 2, 2),)


def test_what_is_under_a_bridge_comes_from_the_side() -> None:
    """Not from above; along the tunnel, which is along y, and up before it or behind it."""
    box = box_of((48, 60, 40), (BRIDGE, (2, 5, 0)), (cube_of(12), (4, 6, 0)))
    bridge, cube = box.placed
    assert find_route([bridge], cube, box.cells, moves=1) is None
    route = find_route([bridge], cube, box.cells, moves=2)
    assert route is not None and len(route) == 2
    assert route[0] == (4, 6, 0) and route[1][0] == 4 and route[1][2] == 0
    assert route[1][1] <= 2 or route[1][1] >= 10
    found = disassemble(box, moves=1)
    share = cube.item.volume / (cube.item.volume + bridge.item.volume)
    assert found.insertable == pytest.approx(1 - share)
    found = disassemble(box)
    assert found.insertable == 1.0 and found.insertable_from_above == pytest.approx(1 - share)
    assert (found.out[0], found.interlocked) == (((2, 5, 0),), ())


def test_a_tunnel_between_walls_has_no_way() -> None:
    """As long as the box: what is in it has no route until the bridge is removed."""
    box = box_of((48, 20, 40), (BRIDGE, (2, 0, 0)), (cube_of(12), (4, 1, 0)))
    found = disassemble(box)
    assert found.into == (((2, 0, 0),), None)
    assert found.out == (((2, 0, 0),), None)
    assert found.interlocked == ()
    assert found.removable == found.insertable < 1


def test_a_ring_on_a_post_comes_off_and_one_between_heads_is_locked() -> None:
    free = box_of((40, 40, 48), (POST, (4, 4, 0)), (FRAME, (2, 2, 2)))
    assert disassemble(free).out == (((4, 4, 0),), ((2, 2, 2),))
    locked = box_of((40, 40, 48), (DUMBBELL, (2, 2, 0)), (FRAME, (2, 2, 2)))
    found = disassemble(locked)
    assert found.out == (None, None)
    assert found.interlocked == (0, 1)
    assert found.into == (((2, 2, 0),), None)
    shifted = box_of((80, 40, 48), (DUMBBELL, (2, 2, 0)), (FRAME, (2, 2, 2)), (POST, (15, 2, 0)))
    assert disassemble(shifted).interlocked == (0, 1)


def test_rings_through_each_other_are_locked() -> None:
    """Linked is what has its centre about where the other's tube is, and crosses it nowhere."""
    ring, other = Item(RING, 0.05, 4), Item(RING, 0.05, 8)
    box = Box((48, 48, 40))
    middle = box.place(ring, (2, 2, 3)).center
    places = [tuple(at) for at in np.argwhere(box.feasible(other)).tolist()]
    away = np.array([PlacedItem(other, at).center - middle for at in places])
    off_axes = np.abs(away[:, [np.argmin(ring.extents), np.argmin(other.extents)]]).max(axis=1)
    tube = 0.5 / 1.3 * ring.extents.max()  # radii of 0.5 and 0.15: 1.3 wide
    linked = np.flatnonzero((off_axes < 0.03) & (np.linalg.norm(away, axis=1) < 1.3 * tube))
    assert len(linked) and _interlocked(box, other, places[linked[0]]) == (0, 1)
    apart = places[int(np.argmax(np.linalg.norm(away, axis=1)))]
    assert _interlocked(box, other, apart) == ()


def _interlocked(box: Box, other: Item, at: Triple) -> tuple[int, ...]:
    box.place(other, at)
    found = disassemble(box).interlocked
    box.undo()
    return found


def test_an_empty_box_and_no_moves() -> None:
    found = disassemble(Box())
    assert (found.insertable, found.removable, found.interlocked) == (1.0, 1.0, ())
    with pytest.raises(ValueError, match="moves 0 is not possible"):
        disassemble(Box(), moves=0)
