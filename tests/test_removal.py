"""Removal of parts at free poses: cases solved by hand, and routes replayed in small steps."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from trimesh import creation

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.handling.removal import Removal, removable
from packit_sim.parts.handling.sweeps import AXES, PartSweeps
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from tests.examples import examples
from tests.packed_parts import BAR, CAGE, bowl, cuboid, moved, packed, turned, u_profile


def test_a_ball_in_a_closed_cage_is_stuck_and_so_is_the_cage() -> None:
    ball = creation.icosphere(subdivisions=2, radius=12).apply_translation((50, 50, 50))
    found = removable(packed(ball, CAGE, cuboid((0, 0, 0), (10, 10, 10))))
    assert [(one.part, one.by) for one in found.stuck] == [(0, (1,)), (1, (0,))]
    assert found.order == (2,)


def test_nested_bowls_come_out_upwards_the_inner_one_first() -> None:
    bowls = [moved(bowl(), 50, 50, 8 * n) for n in range(3)]
    found = removable(packed(*bowls), moves=1)
    assert found.order == (2, 1, 0)
    assert found.packing_order == (0, 1, 2)
    assert [(route.moves, route.out) for route in found.routes] == [((), "up")] * 3
    assert found.stuck == ()


def test_only_parts_ahead_whose_boxes_overlap_across_are_in_the_way() -> None:
    packing = packed(
        cuboid((40, 40, 10), (50, 50, 20)),
        cuboid((45, 45, 60), (55, 55, 70)),
        cuboid((45, 45, 30), (55, 55, 40)),
        cuboid((60, 40, 30), (70, 50, 40)),  # beside its way along x
        cuboid((40, 60, 30), (50, 70, 40)),  # along y
        cuboid((40, 40, 0), (50, 50, 5)),  # behind
    )
    sweeps, still = PartSweeps(packing), np.zeros(3)
    found = sweeps.in_the_way(0, range(6), "up", still)
    assert found == [(2, pytest.approx(0.1)), (1, pytest.approx(0.4))]  # of the box's 100 mm
    assert sweeps.in_the_way(0, range(6), "down", still) == [(5, pytest.approx(0.05))]
    first, *_ = sweeps.in_the_way(0, range(6), "up", np.array((0, 0, 0.25)))
    assert first == (2, pytest.approx(-0.15))


def test_a_u_around_a_bar_slides_sideways() -> None:
    """The bar is held by both ends; the U lies around it, open towards +x."""
    packing = packed(u_profile(), BAR, cuboid((20, 20, 60), (30, 60, 70)))
    straight = removable(packing, moves=1)
    assert straight.order == (2,)
    assert {one.part: one.by for one in straight.stuck} == {0: (1,), 1: (0,)}
    found = removable(packing)
    assert found.stuck == ()
    assert found.order[0] == 2 and set(found.order) == {0, 1, 2}
    direction, length = found.routes[1].moves[0]
    assert direction == ("+x" if found.order[1] == 1 else "-x") and length > 0


def test_a_part_leaves_through_a_door_at_the_side() -> None:
    cube = cuboid((10, 10, 10), (30, 30, 30))
    beam = cuboid((0, 0, 80), (100, 100, 90))
    closed = removable(packed(cube, beam), fixed=(1,))
    assert [(one.part, one.by) for one in closed.stuck] == [(0, (1,))]
    opened = removable(packed(cube, beam), door="y-", fixed=(1,))
    assert opened.order == (0,) and opened.routes[0].out == "-y"
    with pytest.raises(ArgumentError, match=r"door 'z-' is not possible: choose from x-, x\+, "):
        removable(packed(cube), door="z-")


@pytest.mark.parametrize("door", ["x-", "x+", "y-", "y+"])
def test_moves_through_each_door_are_those_of_the_top_turned(door) -> None:
    """A shelf between a cube and the door: along the shelf, and out."""
    cube, shelf = cuboid((40, 40, 0), (70, 70, 30)), cuboid((30, 30, 50), (80, 80, 60))
    upright = removable(packed(cube, shelf), fixed=(1,))
    sign, axis = (1 if door[1] == "+" else -1), "xyz".index(door[0])
    turn = np.zeros((4, 4))
    turn[axis, 2], turn[(axis + 1) % 3, 0], turn[(axis + 2) % 3, 1], turn[3, 3] = sign, 1, sign, 1
    turn[:3, 3] = 50 - turn[:3, :3] @ (50, 50, 50)
    own = [each.copy().apply_transform(turn) for each in (cube, shelf)]
    found = removable(packed(*own), door=door, fixed=(1,))
    assert found.order == (0,) == upright.order
    assert found.routes[0].out == f"{door[1]}{door[0]}" and len(found.routes[0].moves) == 1
    assert removable(packed(*own), door=door, moves=1, fixed=(1,)).order == ()


def test_a_part_may_be_lowered_on_its_way_to_a_door() -> None:
    cube = cuboid((0, 0, 60), (30, 100, 90))
    lip = cuboid((60, 0, 50), (100, 100, 100))
    found = removable(packed(cube, lip), door="x+", fixed=(1,))
    assert [direction for direction, _ in found.routes[0].moves] == ["down"]


def test_a_part_below_an_overhang_is_lifted_slid_and_lifted() -> None:
    """A fixed shelf above, a fixed step beside: up a little, along, and out."""
    cube = cuboid((0, 0, 0), (30, 100, 30))
    shelf = cuboid((0, 0, 50), (50, 100, 60))
    step = cuboid((30, 0, 0), (100, 100, 15))
    found = removable(packed(cube, shelf, step), fixed=(1, 2))
    assert found.order == (0,)
    assert [direction for direction, _ in found.routes[0].moves] == ["up", "+x"]
    assert removable(packed(cube, shelf, step), moves=2, fixed=(1, 2)).order == ()


def test_a_part_that_slides_below_another_shelf_is_still_stuck() -> None:
    """Two fixed shelves at different heights leave no gap between them, seen from above."""
    cube = cuboid((0, 0, 0), (30, 100, 30))
    shelves = cuboid((0, 0, 50), (50, 100, 60)), cuboid((45, 0, 70), (100, 100, 80))
    found = removable(packed(cube, *shelves), fixed=(1, 2))
    assert [(one.part, one.by) for one in found.stuck] == [(0, (1,))]


def test_a_u_that_opens_towards_the_wrong_side_is_stuck() -> None:
    """It would have to move to +x, where the wall is; to -x its back meets the fixed bar."""
    bar = moved(BAR, 20, 0, 0)
    mirrored = u_profile()
    mirrored.apply_transform(np.diag((-1.0, -1.0, 1.0, 1.0)))
    mirrored.apply_translation((100, 80, 0))
    packing = packed(mirrored, bar)
    found = removable(packing, fixed=(1,))
    assert [(one.part, one.by) for one in found.stuck] == [(0, (1,))]
    wider = replace(packing, container=BoxContainer((150, 100, 100)))
    free = removable(wider, fixed=(1,))
    assert free.order == (0,) and free.routes[0].moves[0][0] == "+x"


def test_parts_that_touch_do_not_block_each_other() -> None:
    blocks = [
        cuboid((20 * x, 20 * y, 20 * z), (20 * (x + 1), 20 * (y + 1), 20 * (z + 1)))
        for x in range(5)
        for y in range(5)
        for z in range(2)
    ]
    found = removable(packed(*blocks), moves=1)
    assert found.stuck == ()
    heights = [blocks[n].bounds[0, 2] for n in found.order]
    assert heights == sorted(heights, reverse=True)


def test_boxes_do_not_see_each_other() -> None:
    cube = cuboid((0, 0, 0), (20, 20, 20))
    packing = packed(cube, cuboid((0, 0, 40), (100, 100, 50)))
    both = Packing(
        packing.types,
        BoxContainer((100, 100, 100)),
        (packing.placements[0], Placement(1, box=1)),
        objective="bins",
    )
    assert removable(both, fixed=(1,)).order == (0,)
    assert removable(packing, moves=1, fixed=(1,)).order == ()


def test_free_rotations_and_scales_are_swept_as_they_are() -> None:
    """A rod through a ring, both turned by the same odd angle: it slides only along its axis."""
    turn = turned((1, 2, 3), 0.7)
    item = ItemType("rod", *_arrays(creation.cylinder(radius=1, height=8)))
    ring = ItemType("ring", *_arrays(creation.annulus(r_min=1.5, r_max=4, height=2)))
    poses = []
    for _ in range(2):
        pose = np.eye(4)
        pose[:3, :3] = 2 * turn
        pose[:3, 3] = 50, 50, 50
        poses.append(pose)
    packing = Packing(
        (item, ring),
        BoxContainer((100, 100, math.inf)),
        tuple(Placement.from_matrix(n, pose) for n, pose in enumerate(poses)),
    )
    sweeps = PartSweeps(packing)
    assert all(sweeps.meets(0, 1, direction) for direction in AXES)
    gap = 2 * 0.5 / 100  # along the rod's normal: more along any other direction
    assert all(gap * 0.98 <= sweeps.distance(0, 1, direction) < 0.1 for direction in AXES)
    assert len(removable(packing).stuck) == 2


def test_moves_out_of_range_are_one_clear_error() -> None:
    with pytest.raises(ArgumentError, match="moves 4 is not possible: 1 to 3"):
        removable(packed(CAGE), moves=4)


@given(st.integers(0, 2**32 - 1))
@examples(2)
def test_routes_replayed_in_small_steps_cross_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = [
        bowl(),
        CAGE.copy().apply_scale(0.4),
        u_profile().apply_scale(0.4),
        BAR.copy().apply_scale(0.4),
    ]
    meshes: list[trimesh.Trimesh] = []
    manager = trimesh.collision.CollisionManager()
    for n in range(20):
        mesh = kinds[n % len(kinds)].copy()
        mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        mesh.apply_translation(-mesh.bounds[0])
        mesh.apply_translation(rng.random(3) * np.maximum(100 - mesh.extents, 0))
        if not manager.in_collision_single(mesh):
            manager.add_object(str(len(meshes)), mesh)
            meshes.append(mesh)
    _replay(meshes, removable(packed(*meshes)))


def _replay(meshes: list[trimesh.Trimesh], found: Removal) -> None:
    assert sorted([*found.order, *(one.part for one in found.stuck)]) == list(range(len(meshes)))
    manager = trimesh.collision.CollisionManager()
    for n, mesh in enumerate(meshes):
        manager.add_object(str(n), mesh)
    for part, route in zip(found.order, found.routes, strict=True):
        manager.remove_object(str(part))
        corners = [np.zeros(3)]
        for direction, length in (*route.moves, (route.out, 150.0)):
            axis, sign = AXES[direction]
            step = np.zeros(3)
            step[axis] = sign * length
            corners.append(corners[-1] + step)
        for start, stop in pairwise(corners):
            for share in np.linspace(0, 1, 20):
                pose = np.eye(4)
                pose[:3, 3] = start + share * (stop - start)
                assert not manager.in_collision_single(_smaller(meshes[part]), pose)
        inside = meshes[part].bounds + corners[-2]
        assert (inside[0] > -1e-6).all() and (inside[1, :2] < 100 + 1e-6).all()


def _smaller(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh that is smaller by three times the contact tolerance."""
    middle = mesh.bounds.mean(axis=0)
    vertices = middle + (mesh.vertices - middle) * (1 - 0.03 / mesh.extents)
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def _arrays(mesh: trimesh.Trimesh) -> tuple[Floats, np.ndarray]:
    return mesh.vertices, mesh.faces
