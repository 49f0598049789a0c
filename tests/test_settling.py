"""Settling of scenes with known outcomes: stability, falls, and positions at rest."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pybullet
import pytest
from trimesh import creation, transformations

from packit_sim import ShapeLibrary, read_packs
from packit_sim.box import Box
from packit_sim.core.errors import PhysicsError
from packit_sim.game.datasets.pack_files import dataset_file
from packit_sim.geometry.lattice import STEP, Triple
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.physics import settling, world
from packit_sim.physics.convex import disk_cache
from packit_sim.physics.convex.pieces import Piece
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.penetration import penetrations, wall_penetrations
from packit_sim.physics.settings import INSIDE, PhysicsSettings
from packit_sim.physics.settling import Settled, SettledItem, settle, settle_each
from packit_sim.physics.stability import stability
from packit_sim.physics.world import World
from packit_sim.placement import BoxState
from packit_sim.render.layouts import Layout
from packit_sim.scene import Scene
from tests.zoo import BALL, BOWL, ZOO, cube_of, fill, random_item

SETTINGS = PhysicsSettings(decomposition=DecompositionSettings(method="bisection"))

STILL = 0.002
"""Box units: 1 mm of a box of half a metre."""


@pytest.fixture(autouse=True, scope="module")
def _store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Pieces are computed once for this module, in a temporary cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path_factory.mktemp("kept")))
        yield


def box_of(*placed: tuple[Item, Triple]) -> Box:
    box = Box()
    for item, location in placed:
        box.place(item, location)
    return box


def cubes(*locations: Triple) -> Box:
    """Cubes of 24 cells, which is 6 steps of the grid."""
    return box_of(*((cube_of(24), location) for location in locations))


def block(x: float, y: float, z: float) -> Item:
    """A block of so many cells."""
    shape = Shape.from_mesh(creation.box((x, y, z)), f"block-{x}-{y}-{z}")
    return Item(shape, (math.hypot(x, y, z) / 100) ** 3)


def piece_of(item: Item, *center: float) -> Piece:
    return Piece.around(item.mesh.vertices).moved(np.eye(3), np.array(center))


def test_a_cube_on_the_floor_does_not_move() -> None:
    found = settle(cubes((8, 8, 0)), SETTINGS)
    (cube,) = found.items
    assert found.at_rest and found.seconds < 1
    assert cube.farthest < STILL and cube.displacement < STILL and cube.rotation < 0.5
    assert (cube.items, cube.walls, cube.inside) == ((), ("floor",), True)


def test_a_cube_on_an_edge_topples() -> None:
    mesh = creation.box((1, 1, 1))
    mesh.apply_transform(transformations.rotation_matrix(math.pi / 4 + 0.02, (1, 0, 0)))
    found = settle(box_of((Item(Shape.from_mesh(mesh, "edge"), 0.1), (8, 8, 0))), SETTINGS)
    (cube,) = found.items
    assert found.at_rest and cube.inside
    assert cube.rotation == pytest.approx(45, abs=3)
    side = float(np.cbrt(0.1) / np.linalg.norm(mesh.extents))
    assert np.ptp(cube.vertices[:, 2]) == pytest.approx(side, abs=0.005)
    assert cube.vertices[:, 2].min() == pytest.approx(0, abs=STILL)


def test_a_stack_of_three_stands() -> None:
    found = settle(cubes((8, 8, 0), (8, 8, 6), (8, 8, 12)), SETTINGS)
    assert found.at_rest
    assert max(cube.farthest for cube in found.items) < STILL
    assert [cube.items for cube in found.items] == [(1,), (0, 2), (1,)]
    assert [cube.walls for cube in found.items] == [("floor",), (), ()]


def test_a_leaning_stack_falls() -> None:
    """The upper two overhang by two thirds of a side: their centre of mass is beyond the edge."""
    found = settle(cubes((4, 8, 0), (8, 8, 6), (12, 8, 12)), SETTINGS)
    assert found.at_rest
    assert found.items[0].farthest < 0.05
    assert all(cube.farthest > 0.2 and cube.inside for cube in found.items[1:])
    assert "floor" in found.items[2].walls


@pytest.mark.slow
def test_a_ball_in_a_bowl_comes_to_rest_at_the_bottom() -> None:
    bowl = Item(BOWL, 1.0)
    box = box_of((bowl, (0, 0, 0)))
    ball = Item(BALL, 0.02)
    mask = box.feasible(ball)
    inside = np.argwhere(mask) * STEP / 100
    away = np.linalg.norm(inside[:, :2] - (box.placed[0].center[:2] - ball.extents[0] / 2), axis=1)
    off_centre = np.argwhere(mask)[(away > 0.1) & (away < 0.2) & (inside[:, 2] < 0.3)][0]
    box.place(ball, off_centre)
    start = box.placed[1].center
    found = settle(box, SETTINGS)
    bowl_now, ball_now = found.items
    assert found.at_rest and bowl_now.inside
    assert ball_now.items == (0,) and not ball_now.walls
    middle, end = (item.pose.translation for item in (bowl_now, ball_now))
    assert np.linalg.norm(end[:2] - middle[:2]) < 0.05 < np.linalg.norm(start[:2] - middle[:2])
    assert end[2] < start[2]
    depth = bowl_now.vertices[:, 2].min()
    assert end[2] - ball.extents[2] / 2 == pytest.approx(depth, abs=0.03)


def test_a_fall_takes_its_time() -> None:
    """Hand-solved: in t seconds g t^2 / 2 metres, which is 0.098 box units of half a metre."""
    settings = replace(SETTINGS, damping=0.0)
    piece = piece_of(cube_of(10), 0.5, 0.5, 0.8)
    with World(np.ones(3), settings) as fallen:
        fallen.add([piece], 2.0)
        energy = fallen.energy
        assert energy == pytest.approx(2 * 9.81 * 0.8 * 0.5)
        for _ in range(24):
            fallen.step()
        (move,) = fallen.moves
        assert np.allclose(move.rotation, np.eye(3)) and np.allclose(move.translation[:2], 0)
        assert -move.translation[2] == pytest.approx(9.81 * 0.1**2 / 2 / 0.5, rel=0.05)
        assert fallen.speeds[0] == pytest.approx(9.81 * 0.1, rel=1e-3)
        assert fallen.energy == pytest.approx(energy, rel=0.01)


@pytest.mark.parametrize("restitution", [0.0, 0.25, 0.81])
def test_a_bounce_returns_what_restitution_says(restitution: float) -> None:
    """Hand-solved: a ball that falls from h comes back to restitution^2 h."""
    settings = replace(SETTINGS, damping=0.0, restitution=restitution)
    ball = Item(BALL, 0.001)
    start = np.array((0.5, 0.5, 0.5 + ball.extents[2] / 2))
    heights = []
    with World(np.ones(3), settings) as bounced:
        bounced.add([piece_of(ball, *start)], 1.0)
        for _ in range(100):
            bounced.step()
            heights.append(0.5 + (bounced.moves[0].apply(start) - start)[2])
    landed = int(np.argmin(heights))
    assert 40 < landed < 60  # sqrt(2 h / g) is 0.226 s
    assert max(heights[landed:]) == pytest.approx(restitution**2 * 0.5, abs=0.03)


def test_friction_prevents_or_allows_sliding() -> None:
    """A block on a slope of 15 degrees stays where friction is above tan(15), 0.27."""
    slope = transformations.rotation_matrix(math.radians(15), (0, 1, 0))[:3, :3]
    middle = np.array((0.5, 0.5, 0.5))
    plank, load = (
        piece_of(item, 0, 0, height).moved(slope, middle)
        for item, height in ((block(80, 20, 4), 0.0), (block(10, 10, 4), 0.04))
    )
    slid = {}
    for friction in (0.1, 0.5):
        with World(np.ones(3), replace(SETTINGS, friction=friction)) as tilted:
            tilted.add([plank], 0.0)
            tilted.add([load], 1.0)
            for _ in range(60):
                tilted.step()
            slid[friction] = float(np.linalg.norm(tilted.moves[1].translation))
    assert slid[0.5] < STILL
    expected = 9.81 * (math.sin(math.radians(15)) - 0.1 * math.cos(math.radians(15))) * 0.25**2 / 2
    assert slid[0.1] == pytest.approx(expected / 0.5, rel=0.1)


def test_energy_does_not_grow_at_rest() -> None:
    box = cubes((8, 8, 0), (8, 8, 6), (8, 8, 12))
    pieces = [[piece_of(p.item, *p.center)] for p in box.placed]
    with World(box.size, SETTINGS) as resting:
        for own in pieces:
            resting.add(own, 1.0)
        start = resting.energy
        assert start == pytest.approx(9.81 * 0.5 * (0.12 + 0.36 + 0.60))
        energies = []
        for _ in range(960):
            resting.step()
            energies.append(resting.energy)
    assert max(energies) < start * (1 + 1e-4)
    assert abs(energies[-1] - energies[240]) < 1e-3 * start


@pytest.fixture(scope="module")
def zoo_box() -> Box:
    rng = np.random.default_rng(3)
    box = Box()
    fill(box, [random_item(ZOO, 0.45, rng) for _ in range(12)], rng)
    return box


@pytest.fixture(scope="module")
def settled_zoo(zoo_box: Box) -> Settled:
    return settle(zoo_box, SETTINGS)


@pytest.mark.slow
def test_what_falls_loses_energy_and_ends_through_nothing(settled_zoo: Settled) -> None:
    found = settled_zoo
    assert found.energy[1] < found.energy[0]
    assert all(item.inside for item in found.items)
    assert max(wall_penetrations(found)) < INSIDE
    assert max(penetrations(found).values(), default=0.0) < 0.02


def as_tuples(found: Settled) -> list[tuple[object, ...]]:
    return [(found.seconds, found.energy)] + [
        (item.move.matrix.tobytes(), item.displacement, item.farthest, item.items, item.walls)
        for item in found.items
    ]


@pytest.mark.slow
def test_the_same_again_is_the_same(zoo_box: Box) -> None:
    """As far as the first second, in which everything falls and collides."""
    short = replace(SETTINGS, time_limit=1.0)
    first, again = (settle(zoo_box, short) for _ in range(2))
    assert as_tuples(first) == as_tuples(again)
    assert max(item.farthest for item in first.items) > 0.02 and any(i.items for i in first.items)


@pytest.mark.slow
def test_the_same_again_is_the_same_to_the_end(zoo_box: Box, settled_zoo: Settled) -> None:
    assert as_tuples(settle(zoo_box, SETTINGS)) == as_tuples(settled_zoo)


def test_what_is_light_is_not_pressed_through_the_floor() -> None:
    """A block on four feet of a thousandth of its weight: a solver alone gives way there."""
    corners = ((0, 0, 0), (8, 0, 0), (0, 8, 0), (8, 8, 0))
    box = box_of(*((block(4, 4, 4), at) for at in corners), (block(36, 36, 40), (0, 0, 1)))
    found = settle(box, SETTINGS)
    assert found.at_rest and max(item.farthest for item in found.items) < STILL
    assert max(wall_penetrations(found)) < 0.001
    assert max(wall_penetrations(settle(box, replace(SETTINGS, min_mass_ratio=0.0)))) > 0.005


def test_packed_items_are_not_driven_apart(zoo_box: Box) -> None:
    """Without gravity nothing moves, though pieces fill what is a little hollow."""
    weightless = replace(SETTINGS, gravity=0.0, time_limit=0.2)
    assert max(item.farthest for item in settle(zoo_box, weightless).items) < STILL


def test_time_runs_out() -> None:
    found = settle(box_of((cube_of(10), (10, 10, 20))), replace(SETTINGS, time_limit=0.1))
    assert not found.at_rest
    assert found.seconds == pytest.approx(0.1, abs=0.05)
    assert not found.items[0].walls


def test_an_empty_box_is_at_rest() -> None:
    found = settle(Box(), SETTINGS)
    assert (found.items, found.at_rest, found.energy) == ((), True, (0.0, 0.0))
    assert len(Layout.settled(found.items).points) == 0
    assert stability(Box(), SETTINGS).whole == 1.0


def test_each_by_itself_meets_only_those_before_it() -> None:
    """A plank that a load holds: without the load it tips; with the load both stay."""
    box = box_of((cube_of(24), (0, 0, 0)), (block(60, 24, 4), (0, 0, 6)), (cube_of(24), (0, 0, 7)))
    found = stability(box, SETTINGS)
    cube, plank, load = found.each.items
    assert plank.farthest > 0.1
    assert max(cube.farthest, load.farthest) < STILL
    assert (cube.items, load.items) == ((), (1,))
    volumes = [placed.item.volume for placed in box.placed]
    assert found.as_packed == pytest.approx(1 - volumes[1] / sum(volumes))
    assert found.whole == 1.0
    assert settle_each(box, SETTINGS).items[1].farthest == plank.farthest


def test_what_only_drops_a_step_is_stable() -> None:
    box = box_of((cube_of(20), (8, 8, 1)), (cube_of(20), (16, 16, 2)))
    found = stability(box, SETTINGS)
    near, far = found.settled.items
    assert near.farthest == pytest.approx(0.04, abs=STILL)
    assert far.farthest == pytest.approx(0.08, abs=STILL)
    assert (found.whole, found.as_packed) == (0.5, 0.5)
    assert stability(box, SETTINGS, distance=0.1).whole == 1.0
    with pytest.raises(ValueError, match="distance 0 is not possible"):
        stability(box, SETTINGS, distance=0)


def shifted(box: Box, *shifts: tuple[float, float, float]) -> Settled:
    """As if items had ended that far from their places."""
    items = []
    for placed, shift in zip(box.placed, shifts, strict=True):
        move = Motion.shift(shift)
        inside = settling.is_inside(placed, move, box.size)
        items.append(SettledItem(placed, (), move, (), (), inside))
    return Settled(tuple(items), box.size, 0.0, True, (0.0, 0.0))


def test_penetrations_of_cubes_moved_into_each_other() -> None:
    box = cubes((0, 8, 0), (6, 8, 0), (12, 8, 0))
    still = (0.0, 0.0, 0.0)
    apart = shifted(box, still, (0.01, 0, 0), (0.02, 0, 0))
    assert penetrations(apart) == {}
    pushed = shifted(box, still, (0.01, 0, 0), (0.007, 0.001, 0.001))
    assert penetrations(pushed) == {(1, 2): pytest.approx(0.0032)}
    assert penetrations(shifted(box, still, (-0.24, 0, 0), still))[0, 1] > 0.1


def test_one_inside_another_is_no_depth_at_all() -> None:
    box = box_of((cube_of(40), (0, 0, 0)), (cube_of(8), (12, 0, 0)))
    found = shifted(box, (0, 0, 0), (-0.32, 0.16, 0.16))
    assert penetrations(found) == {(0, 1): math.inf}


def test_walls_that_are_gone_through() -> None:
    box = cubes((0, 0, 0), (19, 19, 19))
    out = shifted(box, (0.02, 0.03, -0.01), (0.01, 0.004, 0.5))
    assert wall_penetrations(out) == pytest.approx([0.01, 0.01])
    assert [item.inside for item in out.items] == [False, False]
    assert [item.inside for item in shifted(box, (0, 0, 0), (0.004, 0, 0)).items] == [True, True]
    assert out.items[1].displacement == pytest.approx(math.hypot(0.01, 0.004, 0.5))


def test_settings_out_of_range() -> None:
    for name, value in (("side", 0.0), ("friction", -1.0), ("step", 1.0), ("time_limit", math.nan)):
        with pytest.raises(ValueError, match=f"{name} {value} is not possible"):
            PhysicsSettings(**{name: value})


def test_no_memory_for_another_world(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(world.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(pybullet, "connect", lambda mode: -1)
    with pytest.raises(PhysicsError, match="close other ones"):
        settle(cubes((0, 0, 0)), SETTINGS)
    assert not list(tmp_path.iterdir())


def test_a_world_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(world.tempfile, "tempdir", str(tmp_path))
    worlds = [World(np.ones(3), SETTINGS) for _ in range(3)]
    assert len(list(tmp_path.iterdir())) == 3
    for one in worlds:
        one.close()
        one.close()
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("software")
def test_a_scene_shows_how_its_box_settles() -> None:
    box = cubes((4, 8, 0), (8, 8, 6), (12, 8, 12))
    with Scene(box) as scene:
        before = scene.snapshot(120, 120)
        found = settle(box, SETTINGS)
        after = scene.snapshot(120, 120, layout=Layout.settled(found.items))
        again = scene.snapshot(120, 120)
    assert np.array_equal(before.image, again.image)
    assert set(np.unique(after.segmentation)) == {-1, 0, 1, 2}
    assert (before.segmentation != after.segmentation).mean() > 0.05
    top = np.argwhere(after.segmentation == 2)[:, 0].mean()
    assert top > np.argwhere(before.segmentation == 2)[:, 0].mean() + 10  # lower in the picture


@pytest.mark.slow
def test_a_pack_of_the_benchmark_ends_through_nothing() -> None:
    library = ShapeLibrary.open("everyday")
    pack = read_packs(dataset_file("starter"))[0]
    found = settle(BoxState(pack.cells, pack.placed(library)), SETTINGS)
    assert all(item.inside for item in found.items)
    assert max(wall_penetrations(found)) < INSIDE
    assert max(penetrations(found).values(), default=0.0) < 0.02
