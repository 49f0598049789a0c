"""An arm packs a box in physics: grasps, motions, execution, measures, and errors before it."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from gymnasium.utils.env_checker import check_env
from trimesh import creation

from packit_agents.placements.free_space import FreeSpace
from packit_sim import placement
from packit_sim.box import Box
from packit_sim.core.errors import ArgumentError, InfeasibleError, PackFormatError
from packit_sim.core.extras import MissingPackageError
from packit_sim.game.datasets.packs import LibraryRef, Pack, Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.episodes.episode import Episode
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import BoxState, PlacedItem, PosedItem
from packit_sim.geometry.lattice import STEP, Triple
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.rotations import MATRICES
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.physics.convex import disk_cache
from packit_sim.physics.convex.pieces import Piece
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.world import World, pybullet_module
from packit_sim.render import robot_films
from packit_sim.robot import penetration
from packit_sim.robot.arm import Route, ToolPath
from packit_sim.robot.arms import arm_of
from packit_sim.robot.cell import RobotCell, SuctionGripper
from packit_sim.robot.clearance import PADDING, Obstacles, PaddedBody, PosedBodies
from packit_sim.robot.executed_item import Outcome
from packit_sim.robot.gantry import GANTRY, Gantry
from packit_sim.robot.grasps import Grasp, best_grasp
from packit_sim.robot.height_kernels import highest_in_disc
from packit_sim.robot.insertion import insertion_shifts
from packit_sim.robot.measures import measures
from packit_sim.robot.motion import straight
from packit_sim.robot.panda import panda_model
from packit_sim.robot.paths import find_path
from packit_sim.robot.presentation import turn_at_pick
from packit_sim.robot.recording import Recording
from packit_sim.robot.robot_box import RobotBox
from packit_sim.robot.trajectory import Trajectory
from packit_sim.robot.world import ArmWorld
from packit_sim.rules import Rules
from tests.zoo import BALL, BOWL, CUBE, TILTED

CELL = RobotCell(decomposition=DecompositionSettings(method="bisection"), speed=2.0)
CELLS: Triple = (40, 40, 40)
NO_MODEL = "the slim environment has no model of the panda"


@pytest.fixture(autouse=True, scope="module")
def _store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Pieces are computed once for this module, in a temporary cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path_factory.mktemp("kept")))
        yield


def block(x: float, y: float, z: float) -> Item:
    """A block of so many cells."""
    shape = Shape.from_mesh(creation.box((x, y, z)), f"block-{x}-{y}-{z}")
    return Item(shape, (math.hypot(x, y, z) / 100) ** 3)


TURNED = (block(20, 12, 8), block(12, 16, 10))
ITEMS = (block(20, 12, 8), block(12, 16, 10), Item(BALL, 0.006))


def packed(cell: RobotCell = CELL, items: Sequence[Item] = ITEMS) -> RobotBox:
    box = RobotBox(CELLS, cell)
    for item in items:
        location = box.blbf(item)
        assert location is not None
        box.put(item, location)
    return box


@pytest.fixture(scope="module")
def box() -> RobotBox:
    return packed()


def test_items_end_where_they_were_planned(box: RobotBox) -> None:
    for one in box.placed:
        assert one.outcome is Outcome.PLACED and one.counts
        assert one.displacement[0] < 0.004 and one.displacement[1] < 2
        assert one.moved[0] < 0.002
    assert box.density == pytest.approx(sum(item.volume for item in ITEMS) / box.volume)


def test_the_same_seed_gives_the_same_trajectory_bit_for_bit(box: RobotBox) -> None:
    first = Trajectory.of(CELL, CELLS, box.placed)
    assert Trajectory.of(CELL, CELLS, packed().placed).digest == first.digest


def test_a_trajectory_is_read_as_it_was_written(box: RobotBox) -> None:
    written = Trajectory.of(CELL, CELLS, box.placed)
    shapes = {item.shape.id: item.shape for item in ITEMS}
    read = Trajectory.from_bytes(written.to_bytes(), shapes.__getitem__)
    assert read.digest == written.digest
    for data in (b"", b"PK", written.to_bytes()[:-100]):
        with pytest.raises(PackFormatError, match="not a trajectory"):
            Trajectory.from_bytes(data, shapes.__getitem__)


def test_an_item_moves_once_the_cup_has_risen(box: RobotBox) -> None:
    for number, one in enumerate(box.placed):
        own = one.recording
        mine = own.rows[:, 1] == number
        steps, poses = own.rows[mine, 0], own.poses[mine]
        released = poses[np.searchsorted(steps, own.held[1], side="right") - 1]
        after = (steps >= own.held[1]) & (steps < own.held[1] + 12)
        assert np.abs(poses[after] - released).max(initial=0) < 1e-5
        assert own.joints[own.held[1] + 12, 2] > own.joints[own.held[1], 2] + 0.001


def test_measures_follow_from_the_trajectory(box: RobotBox) -> None:
    written = Trajectory.of(CELL, CELLS, box.placed)
    shapes = {item.shape.id: item.shape for item in ITEMS}
    found = measures(Trajectory.from_bytes(written.to_bytes(), shapes.__getitem__), ITEMS)
    assert found["planned"] == pytest.approx(1)
    assert found["collapses"] == found["failed grasps"] == found["no path"] == 0
    assert found["penetration"] < 0.001
    assert 5 < found["robot seconds"] < 12


def test_a_film_shows_the_arm_and_each_item_once_it_is_presented(box: RobotBox) -> None:
    trajectory = Trajectory.of(CELL, CELLS, box.placed)
    shown, frames = robot_films.executing(trajectory, fps=2, speed=4.0)
    taken = list(frames)
    steps = sum(len(one.recording.joints) for one in box.placed)
    assert abs(len(taken) - steps / 480) <= 3
    visible = [sum(pose is not None for pose in layout.poses[:3]) for _, layout in taken]
    assert visible[0] == 1 and visible[-1] == 3 and visible == sorted(visible)
    _, last = taken[-1]
    end = last.poses[0]
    assert end is not None and np.allclose(end.matrix, box.placed[0].posed.pose.matrix, atol=1e-3)
    column = shown.placed[5]  # after the items, the bridge and the trolley
    high = last.poses[5]
    assert high is not None and column.item.shape.category == "arm"
    joints = box.placed[2].recording.joints
    assert np.allclose(high.translation[:2], joints[len(joints) // 480 * 480, :2] / CELL.edge)
    with pytest.raises(ArgumentError, match="fps 0 is not possible"):
        robot_films.executing(trajectory, fps=0)


@pytest.mark.parametrize("block", [7, 2_000])
def test_a_penetration_is_found(monkeypatch, block) -> None:
    monkeypatch.setattr(penetration, "_BLOCK", block)
    box = RobotBox(CELLS, CELL)
    box.put(ITEMS[0], (0, 0, 0))
    (one,) = box.placed
    joints = one.recording.joints.copy()
    joints[one.recording.held[1] :, 2] -= 0.006  # the cup is pressed into the released item
    wrong = replace(one, recording=replace(one.recording, joints=joints))
    depth = measures(Trajectory.of(CELL, CELLS, [wrong]), ITEMS)["penetration"]
    assert 0.005 < depth < 0.010


def test_a_penetration_that_no_small_shift_ends_is_finite() -> None:
    large = block(40, 40, 60)
    box = RobotBox((100, 100, 100), CELL)
    box.put(large, (0, 0, 0))
    (one,) = box.placed
    rows = one.recording.poses.copy()
    rows[len(rows) // 2, 2] = 0.0  # half of the held item is in the table
    wrong = replace(one, recording=replace(one.recording, poses=rows))
    depth = measures(Trajectory.of(CELL, (100, 100, 100), [wrong]), [large])["penetration"]
    assert depth / CELL.edge == pytest.approx(0.3)


def test_the_held_item_follows_the_tool_and_joints_keep_their_limits(box: RobotBox) -> None:
    for number, one in enumerate(box.placed):
        own = one.recording
        speeds = np.diff(own.joints, axis=0) / CELL.world.step
        assert np.abs(speeds[:, :3]).max() < CELL.speed * 1.01
        first, last = own.held
        mine = own.rows[:, 1] == number
        steps, heights = own.rows[mine, 0], own.poses[mine, 2] * CELL.edge
        held = (steps >= first) & (steps < last)
        gaps = heights[held] - own.joints[steps[held], 2]
        assert np.ptp(gaps) < 2e-4


def test_masks_have_what_is_graspable_and_reached_from_above_off_the_grid(box: RobotBox) -> None:
    item = block(8, 8, 4)
    mask = box.feasible(item)
    there = [one.posed for one in box.placed]
    everything = placement.oracle(placement.BoxState(CELLS, tuple(there)), item)
    for location in map(tuple, np.argwhere(everything)[::37].tolist()):
        clear = placement.is_insertable(there, PlacedItem(item, location))
        assert mask[location] == clear == box.is_feasible(item, location)


def test_off_the_grid_and_on_it_the_same_items_are_insertable() -> None:
    bowl = PlacedItem(Item(BOWL, 0.04), (2, 2, 0))
    item = Item(BALL, 0.001)
    mask = placement.feasible(_occupied(bowl), item)
    on_grid = placement.insertable_mask([bowl], item, mask)
    off_grid = placement.insertable_mask([PosedItem.of(bowl)], item, mask)
    assert np.array_equal(on_grid, off_grid) and (mask & ~on_grid).any()


def _occupied(placed: PlacedItem) -> placement.Occupancy[PlacedItem]:
    occupancy: placement.Occupancy[PlacedItem] = placement.Occupancy(CELLS)
    occupancy.add(placed)
    return occupancy


def test_a_cup_holds_where_it_is_flat_near_the_centre_of_mass() -> None:
    grasp = best_grasp(ITEMS[0], CELL)
    assert grasp is not None and grasp.radius == 0.016
    assert np.allclose(grasp.point, (0, 0, 0.04), atol=0.02)
    sloping = Item(Shape.from_mesh(creation.cone(0.2, 2.0), "cone"), 0.005)
    assert best_grasp(sloping, CELL) is None
    assert best_grasp(Item(BOWL, 0.04), replace(CELL, gripper=SuctionGripper(cups=(0.05,)))) is None
    for turn in range(24):
        found = best_grasp(Item(TILTED, 0.02, turn), CELL)
        if found is not None:
            top = Item(TILTED, 0.02, turn).mesh.vertices[:, 2].max()
            assert found.point[2] <= top + 1e-9


def test_a_tip_between_samples_is_found() -> None:
    spike = creation.cone(0.2, 2.5)
    spike.apply_translation((0.7, 0.7, 4.0))  # of its samples, the four around it miss it
    plate = creation.box((40, 40, 8))
    item = Item(Shape.from_mesh(trimesh.util.concatenate([plate, spike]), "plate"), 0.2)
    grasp = best_grasp(item, CELL)
    assert grasp is not None and math.hypot(grasp.point[0], grasp.point[1]) > 0.01
    surface = np.asarray(item.mesh.triangles)
    x, y, top = grasp.point
    assert top == highest_in_disc(surface, x, y, grasp.radius / CELL.edge)
    assert highest_in_disc(surface, 0.0, 0.0, 1.0) == pytest.approx(surface[..., 2].max())


@pytest.mark.parametrize("seed", range(3))
def test_the_highest_point_in_a_disc_is_that_of_many_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-1.0, 1.0, (6, 3, 3))
    weights = rng.dirichlet((0.4, 0.4, 0.4), 20_000)
    points = np.concatenate([weights @ triangle for triangle in triangles])
    near = points[np.linalg.norm(points[:, :2] - 0.1, axis=1) <= 0.3]
    top = highest_in_disc(triangles, 0.1, 0.1, 0.3)
    assert near[:, 2].max() <= top + 1e-12 and near[:, 2].max() == pytest.approx(top, abs=0.05)
    triangles[..., 2] = 0.5
    wide = np.array([[(-9.0, -9.0, 0.7), (9.0, -9.0, 0.7), (0.0, 9.0, 0.7)]])
    assert highest_in_disc(np.concatenate([triangles, wide]), 0.1, 0.1, 0.3) == 0.7


@pytest.fixture(scope="module", params=["gantry", pytest.param("panda", marks=pytest.mark.slow)])
def turned(request: pytest.FixtureRequest) -> RobotBox:
    """Blocks that lie on other sides than those on which they are placed."""
    if request.param == "panda":
        pytest.importorskip("pybullet_data", reason=NO_MODEL)
    return packed(replace(CELL, arm=request.param, level=2), TURNED)


def test_at_level_2_items_are_turned_in_the_air(turned: RobotBox) -> None:
    arm = arm_of(turned.cell, CELLS)
    for number, one in enumerate(turned.placed):
        assert one.outcome is Outcome.PLACED and one.counts
        assert one.displacement[0] < 0.004 and one.displacement[1] < 2
        own = one.recording
        first, last = (arm.poses(own.joints[step])[-1].rotation[:, 2] for step in own.held)
        assert first[2] < 0.1 and last[2] > 1 - 1e-9  # from the side, straight down
        mine = own.poses[own.rows[:, 1] == number]
        assert abs(2 * np.arccos(abs(mine[0, 3:] @ mine[-1, 3:]))) > 1


@pytest.mark.slow
def test_a_tilted_tool_touches_nothing_by_its_trajectory(turned: RobotBox) -> None:
    trajectory = Trajectory.of(turned.cell, CELLS, turned.placed)
    shapes = {item.shape.id: item.shape for item in TURNED}
    read = Trajectory.from_bytes(trajectory.to_bytes(), shapes.__getitem__)
    assert read.digest == trajectory.digest
    assert measures(read, TURNED)["penetration"] < 0.001


@pytest.mark.slow
@pytest.mark.parametrize("turned", ["panda"], indirect=True)
def test_the_panda_keeps_its_limits_with_a_tilting_tool(turned: RobotBox) -> None:
    arm = arm_of(turned.cell, CELLS)
    for one in turned.placed:
        joints = one.recording.joints
        assert joints.shape[1] == 8
        speeds = np.abs(np.diff(joints, axis=0)) / turned.cell.world.step
        assert (speeds < np.array((2.175,) * 4 + (2.61,) * 4) * 1.01).all()
        assert np.abs(joints).max() < 3.0718 and np.abs(joints[:, 7]).max() < 1.6
        moved = np.diff([arm.poses(row)[-1].translation for row in joints[::50]], axis=0)
        most = 50 * turned.cell.world.step * turned.cell.speed * 1.01
        assert np.linalg.norm(moved, axis=1).max() < most


def test_an_item_that_lies_on_its_head_is_not_gripped() -> None:
    cell = replace(CELL, level=2)
    item = block(20, 12, 8)
    up = [item.turned(turn) for turn in (0, 4, 8, 12, 16, 20)]
    tilts = [turn_at_pick(one, MATRICES[one.rotation], cell)[2, 2] for one in up]
    found = [best_grasp(one, cell) is not None for one in up]
    assert min(tilts) < -0.99 and max(tilts) > 0.99
    assert found == [tilt > -0.02 for tilt in tilts]


@pytest.fixture(scope="module")
def panda() -> RobotBox:
    pytest.importorskip("pybullet_data", reason=NO_MODEL)
    return packed(replace(CELL, arm="panda", speed=1.0), ITEMS[:2])


def test_the_panda_puts_items_where_they_were_planned(panda: RobotBox) -> None:
    for one in panda.placed:
        assert one.outcome is Outcome.PLACED and one.counts
        assert one.displacement[0] < 0.004 and one.displacement[1] < 2


@pytest.mark.slow
def test_the_panda_touches_nothing_by_its_trajectory(panda: RobotBox) -> None:
    trajectory = Trajectory.of(panda.cell, CELLS, panda.placed)
    shapes = {item.shape.id: item.shape for item in ITEMS}
    read = Trajectory.from_bytes(trajectory.to_bytes(), shapes.__getitem__)
    found = measures(read, ITEMS[:2])
    assert found["penetration"] < 0.001 and found["no path"] == found["collapses"] == 0


@pytest.mark.parametrize("level", [1, 2])
@pytest.mark.parametrize("far", ["pick", "place"])
def test_there_is_no_route_to_a_point_out_of_reach(level: int, far: str) -> None:
    pytest.importorskip("pybullet_data", reason=NO_MODEL)
    arm = arm_of(replace(CELL, arm="panda", level=level), CELLS)
    near = np.array((0.15, 0.15, 0.3, 0.0, 0.0))
    away = near + np.array((5.0, 0.0, 0.0, 0.0, 0.0))
    pick, place = (away, near) if far == "pick" else (near, away)
    path = ToolPath((near, pick), near, (near, place), near)
    load = trimesh.creation.box((0.01, 0.01, 0.01))
    assert arm.route(path, load, (0, 0)) is None


@pytest.mark.slow
def test_the_panda_moves_the_same_way_each_time(panda: RobotBox) -> None:
    first, again = (
        Trajectory.of(panda.cell, CELLS, box.placed)
        for box in (panda, packed(panda.cell, ITEMS[:2]))
    )
    assert first.digest == again.digest


def test_the_panda_keeps_its_limits_and_its_tool_vertical(panda: RobotBox) -> None:
    arm = arm_of(panda.cell, CELLS)
    last = None
    for one in panda.placed:
        joints = one.recording.joints
        assert last is None or np.allclose(joints[0], last, atol=1e-4)  # starts where it ended
        last = joints[-1]
        speeds = np.abs(np.diff(joints, axis=0)) / panda.cell.world.step
        assert (speeds < np.array((2.175,) * 4 + (2.61,) * 3) * 1.01).all()
        assert np.abs(joints).max() < 3.0718
        tools = [arm.poses(row)[-1] for row in joints[::50]]
        assert all(tool.rotation[2, 2] > 1 - 1e-6 for tool in tools)
        moved = np.diff([tool.translation for tool in tools], axis=0)
        assert np.linalg.norm(moved, axis=1).max() < 50 * panda.cell.world.step * 1.01


@pytest.mark.parametrize("is_first_moved", [True, False])
def test_a_film_of_the_panda_shows_its_base(panda: RobotBox, is_first_moved: bool) -> None:
    first, *others = panda.placed
    if not is_first_moved:
        still = Recording(np.empty((0, panda.cell.joints)))
        first = replace(first, outcome=Outcome.NO_PATH, recording=still)
    trajectory = Trajectory.of(panda.cell, CELLS, [first, *others])
    _, frames = robot_films.executing(trajectory, fps=1)
    _, layout = next(frames)
    base = arm_of(panda.cell, CELLS).base.translation / panda.cell.edge
    low, high = np.min(layout.points, axis=0), np.max(layout.points, axis=0)
    assert (low <= base + 1e-9).all() and (base <= high + 1e-9).all()


def test_the_panda_reports_what_it_cannot_reach_or_lift(panda: RobotBox) -> None:
    for edge in (0.2, 0.3):
        arm_of(replace(panda.cell, edge=edge), (100, 100, 100)).check((100, 100, 100), edge / 2)
    with pytest.raises(
        ArgumentError, match=r"can't reach the box: .* choose a smaller edge, now 0"
    ):
        RobotBox((100, 100, 100), replace(panda.cell, edge=0.5))
    with pytest.raises(ArgumentError, match=r"can't reach the box: with an item 0.9 m long"):
        arm_of(panda.cell, CELLS).check(CELLS, 0.9)
    strong = replace(panda.cell, gripper=SuctionGripper(cups=(0.05,)), density=8000.0)
    with pytest.raises(ArgumentError, match=r"lifts at most 2.8 kg"):
        RobotBox(CELLS, strong).check([block(40, 40, 10)])


def test_a_missing_model_of_the_panda_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    panda_model.cache_clear()
    monkeypatch.setitem(sys.modules, "pybullet_data", None)
    with pytest.raises(MissingPackageError, match="cells with the arm panda need pybullet_data"):
        RobotBox(CELLS, replace(CELL, arm="panda", edge=0.25))


@pytest.mark.parametrize("enabled", [False, True])
def test_a_cup_pushes_what_it_meets_after_the_release(enabled: bool) -> None:
    arm = arm_of(CELL, CELLS)
    corners = creation.box((0.1, 0.1, 0.1)).vertices + np.array((0.2, 0.2, 0.05))
    with ArmWorld(np.full(3, 0.4), CELL.world, arm, 0.01) as world:
        world.add([Piece.around(corners)], 0.1)
        middle = 0.2 * CELL.edge
        points = [np.array((middle - x, middle, 0.01, 0.0)) for x in (0.035, 0.015)]
        world.start_at(points[0])
        world.collide_arm(enabled)
        for joints in straight(*points, CELL):
            world.drive(joints)
        (move,) = world.moves
    assert (move.translation[0] * CELL.edge > 0.005) == enabled


def test_a_lost_item_sends_the_arm_back_the_way_it_came() -> None:
    way = np.arange(10.0)[:, None]
    route = Route(way[0], way[:1], way, way[:0], 4, np.array([[99.0]]))
    assert route.after_loss(2).ravel().tolist() == [2, 3, 99]
    assert route.after_loss(7).ravel().tolist() == [6, 5, 4, 99]


def test_a_path_leads_around_obstacles_and_repeats() -> None:
    def is_free(one: Floats, other: Floats) -> bool:
        points = np.linspace(one, other, 30)
        return not ((np.abs(points[:, 0]) < 0.2) & (points[:, 1] < 0.8)).any()

    ends = np.array((-0.7, -0.5)), np.array((0.7, -0.5))
    limits = np.full(2, -1.0), np.full(2, 1.0)
    found = [find_path(*ends, *limits, is_free, np.random.default_rng(3)) for _ in range(2)]
    assert found[0] is not None and np.array_equal(found[0], found[1])
    assert np.array_equal(found[0][[0, -1]], ends) and len(found[0]) > 2
    assert all(is_free(one, other) for one, other in pairwise(found[0]))
    free = find_path(*ends, *limits, lambda one, other: True, np.random.default_rng(3))
    assert free is not None and len(free) == 2
    blocked = find_path(*ends, *limits, lambda one, other: False, np.random.default_rng(3))
    assert blocked is None


def test_padded_bodies_keep_clear_of_boxes() -> None:
    body = PaddedBody.of(creation.box((0.1, 0.1, 0.1)))
    obstacles = Obstacles.of([((-1, -1, -1), (1, 1, 0))])
    for height, expected in ((0.05 + PADDING * 0.9, False), (0.05 + PADDING * 1.3, True)):
        poses = np.array([Motion.shift((0, 0, z)).matrix for z in (-0.05, height)])
        there = PosedBodies((body, body), poses)
        assert there.are_clear(obstacles, first=1) == expected
        assert not there.are_clear(obstacles)
        assert there.are_apart(np.array([(0, 1)])) == (height > 0.06)
    enclosed = PosedBodies((body,), Motion.shift((0, 0, -0.5)).matrix[None])
    assert not enclosed.are_clear(obstacles)


def test_an_item_without_a_grasp_is_set_aside() -> None:
    cone = Item(Shape.from_mesh(creation.cone(0.2, 2.0), "cone"), 0.005)
    box = RobotBox(CELLS, replace(CELL, reachable=False))
    assert box.put(cone, (0, 0, 0)) == 0
    assert box.placed[0].outcome is Outcome.NO_GRASP and not box.placed[0].counts
    assert box.is_feasible(ITEMS[0], (0, 0, 0)) and box.density == 0
    space = FreeSpace.empty([ITEMS[0]], CELLS)
    whole = space.rows(0, Box(CELLS)).copy()
    assert np.array_equal(space.rows(0, box), whole) and whole.any()
    with pytest.raises(InfeasibleError, match="can't be held or reached"):
        RobotBox(CELLS, CELL).put(cone, (0, 0, 0))


def test_an_item_without_a_way_from_above_is_set_aside() -> None:
    roof = RobotBox(CELLS, replace(CELL, reachable=False))
    roof.put(block(8, 8, 20), (0, 0, 0))
    roof.put(block(8, 8, 20), (6, 6, 0))
    roof.put(block(38, 38, 2), (0, 0, 5))
    low = block(8, 8, 4)
    assert roof.is_feasible(low, (0, 6, 0))
    roof.put(low, (0, 6, 0))
    assert [one.outcome for one in roof.placed][-1] is Outcome.NO_PATH


SHELF = [
    PlacedItem(block(16, 8, 12), (0, 0, 0)),
    PlacedItem(block(16, 8, 12), (0, 8, 0)),
    PlacedItem(block(18, 40, 2), (0, 0, 3)),
]
"""A board on two posts."""

BELOW = PlacedItem(block(20, 12, 4), (4, 3, 0))
"""A block of which 2 cells are below the board."""


def test_the_fewest_straight_moves_are_found_past_which_the_cup_fits() -> None:
    others, released = [PosedItem.of(one) for one in SHELF], PosedItem.of(BELOW)
    grasp = Grasp((0.0, 0.0, 0.02), 0.016)

    def shifts(grasp: Grasp, moves: int) -> list[list[float]] | None:
        agile = replace(CELL, moves=moves)
        found = insertion_shifts(others, released, grasp, cell=agile, cells=CELLS)
        return None if found is None else [shift.tolist() for shift in found]

    assert shifts(grasp, 1) is None
    first, last = shifts(grasp, 2) or ([], [])
    assert 0.02 <= first[0] <= 0.04 and first[1:] == [0, 0] and last == [0, 0, 0]
    below_the_board = Grasp((-0.06, 0.0, 0.02), 0.016)
    assert shifts(below_the_board, 3) is None
    lid = PosedItem.of(PlacedItem(block(40, 40, 2), (0, 0, 4)))
    others.append(lid)
    assert shifts(grasp, 3) is None
    others[3] = released.moved(Motion.shift((0.02, 0.0, 0.0)))  # crosses it
    assert shifts(grasp, 3) is None


@pytest.mark.slow
def test_several_straight_moves_insert_an_item_below_another() -> None:
    shelf = RobotBox(CELLS, replace(CELL, reachable=False))
    for one in SHELF:
        shelf.put(one.item, one.location)
    before, low, below = shelf.snapshot(), BELOW.item, BELOW.location
    shelf.put(low, below)
    assert shelf.placed[-1].outcome is Outcome.NO_PATH
    agile = RobotBox(CELLS, replace(shelf.cell, moves=2))
    agile.restore(before)
    agile.put(low, below)
    last = agile.placed[-1]
    assert last.outcome is Outcome.PLACED and last.counts
    assert last.displacement[0] < 0.004 and agile.placed[2].moved[0] < 0.002
    own = last.recording
    held = own.joints[own.held[0] : own.held[1]]
    inside = (held[:, 2] < CELL.edge * 0.1) & (held[:, 1] < CELL.edge * 0.4)
    assert 0.005 < np.ptp(held[inside, 0]) < 0.013  # near the floor of the box it moves along x
    trajectory = Trajectory.of(agile.cell, CELLS, agile.placed)
    assert measures(trajectory, [one.item for one in agile.placed])["penetration"] < 0.001


def test_a_weak_grasp_is_lost() -> None:
    weak = SuctionGripper(cups=(0.016,), pressure=5_000, safety=1.0)
    heavy = replace(CELL, gripper=weak, density=2700.0, acceleration=20.0)
    box = RobotBox(CELLS, heavy)
    box.put(block(20, 20, 12), (0, 0, 0))
    assert box.placed[0].outcome is Outcome.LOST and not box.placed[0].counts


SLAB = block(24, 8, 4)
"""It topples over a block of 8 cells on which it lies with one end."""


def test_an_open_loop_sees_the_plan_but_drives_through_nothing() -> None:
    box = RobotBox(CELLS, replace(CELL, open_loop=True))
    box.put(block(8, 8, 8), (0, 0, 0))
    box.put(SLAB, (0, 0, 2))
    assert box.placed[1].displacement[1] > 15
    small = block(4, 4, 4)
    assert not box.is_feasible(small, (4, 0, 2)) and box.is_feasible(small, (0, 0, 3))
    box.put(small, (0, 0, 3))  # now an end of the slab is there
    assert box.placed[2].outcome is Outcome.NO_PATH


def test_a_placement_that_topples_is_foreseen() -> None:
    box = RobotBox(CELLS, CELL)
    box.put(block(8, 8, 8), (1, 1, 0))
    before = box.snapshot()
    toppled = box.disturbance(SLAB, (1, 1, 2))
    assert toppled.own > 1 and toppled.others < 0.1
    beside = box.disturbance(SLAB, (0, 3, 0))
    assert max(beside.own, beside.others) < 0.1
    assert box.snapshot() == before


def test_the_pieces_of_items_stay_as_they_are() -> None:
    box = RobotBox(CELLS, CELL)
    box.put(Item(BOWL, 0.04), (2, 2, 0))
    ball = Item(BALL, 0.001)
    middle = np.round((box.placed[0].posed.center - ball.extents / 2) * 100 / STEP).astype(int)
    box.put(ball, (*middle[:2].tolist(), 3))
    before = [one.parts for one in box.placed]
    assert all(before)
    box.put(block(4, 4, 4), (9, 9, 0))  # meets none of them
    for old, new in zip(before, [one.parts for one in box.placed], strict=False):
        for (piece, out), (other, other_out) in zip(old, new, strict=True):
            assert out == other_out
            assert np.abs(piece.vertices - other.vertices).max() < 1e-12


def test_an_item_is_foreseen_as_the_kind_of_body_that_is_executed(monkeypatch) -> None:
    box, added = RobotBox(CELLS, CELL), []
    add = World.add

    def noted(world, pieces, mass, *, carried=False):
        added.append((carried, min(piece.vertices[:, 2].min() for piece in pieces)))
        return add(world, pieces, mass, carried=carried)

    box.put(block(8, 8, 8), (1, 1, 0))
    monkeypatch.setattr(World, "add", noted)
    box.disturbance(block(8, 8, 8), (1, 1, 2))
    (below, low), (above, high) = added
    assert (below, above) == (False, True)
    assert high - low == pytest.approx(0.08 + CELL.gap / CELL.edge, abs=2e-3)


def test_what_a_placement_does_to_other_items_is_foreseen_from_where_they_came_to_rest() -> None:
    box = RobotBox(CELLS, CELL)
    box.put(block(8, 8, 8), (1, 1, 0))
    box.put(block(14, 8, 2), (1, 1, 2))  # its right end is over nothing
    weight, (_, plank) = block(8, 8, 8), box.placed
    assert plank.moved[1] < 1
    tipped = box.disturbance(weight, (3, 1, 3))
    assert tipped.others > 1
    assert box.disturbance(weight, (1, 1, 3)).others < 0.2
    shifted = replace(plank, landed=plank.posed.moved(Motion.shift((0.03, 0.0, 0.0))))
    box.restore(BoxState(CELLS, (box.placed[0], shifted)))
    assert 0.3 < box.disturbance(weight, (1, 1, 3)).others < 0.6  # 9 of 20 mm
    gone = replace(plank, landed=plank.posed.moved(Motion.shift((0.1, 0.0, 0.0))))
    box.restore(BoxState(CELLS, (box.placed[0], gone)))
    assert gone.collapsed and box.disturbance(weight, (1, 1, 3)).others < 0.2


def test_snapshots_are_restored(box: RobotBox) -> None:
    saved = box.snapshot()
    before = box.feasible(block(8, 8, 4))
    other = RobotBox(CELLS, CELL)
    other.restore(saved)
    assert other.snapshot() == saved and np.array_equal(other.feasible(block(8, 8, 4)), before)
    with pytest.raises(ArgumentError, match="can't be restored"):
        RobotBox((40, 40, 44), CELL).restore(saved)


@pytest.mark.parametrize("length", [0.001, 0.1, 1.0])
def test_moves_are_timed_within_the_limits(length: float) -> None:
    end = np.array((length, 0.0, 0.0, 0.0))
    joints = straight(np.zeros(4), end, CELL)
    speeds = np.diff(joints[:, 0], prepend=0) * 240
    assert np.allclose(joints[-1], end) and speeds.min() >= 0
    assert speeds.max() <= CELL.speed + 1e-9
    assert np.abs(np.diff(speeds)).max() * 240 <= CELL.acceleration * 1.5
    assert len(straight(end, end, CELL)) == 0


def task_of(*items: Item, cells: Triple = CELLS) -> Task:
    return Task(items, Pack(LibraryRef("none", "1", ""), cells, (), 0.0), ())


LOW = GANTRY.replace('lower="0.0" upper="1.0"', 'lower="0.0" upper="0.2"')
NARROW = GANTRY.replace('upper="1.0"', 'upper="0.05"', 1)
ERRORS = [
    ("<robot/>", "has no joints that move"),
    ("nonsense", "can't be read"),
    (GANTRY.replace("revolute", "prismatic"), "this needs prismatic, prismatic, prismatic"),
    (LOW, "is higher than the reach of arm"),
    (NARROW, "can't reach the box and the station: along x"),
]


@pytest.mark.parametrize(("urdf", "message"), ERRORS)
def test_arms_that_do_not_do_are_refused(tmp_path: Path, urdf: str, message: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(urdf)
    with pytest.raises(ArgumentError, match=message) as raised:
        RobotBox(CELLS, replace(CELL, arm=str(path))).check([Item(CUBE, 0.05)])
    assert "\n" not in str(raised.value)


def test_an_arm_of_the_users_own_packs_too(tmp_path: Path) -> None:
    path = tmp_path / "own.urdf"
    path.write_text(GANTRY)
    own, ours = (Gantry.of(replace(CELL, arm=name)) for name in (str(path), "gantry"))
    assert np.array_equal(own.bodies[1].vertices, ours.bodies[1].vertices)
    with pytest.raises(ArgumentError, match="arm 'ur5' is not known: choose gantry, panda, or"):
        arm_of(replace(CELL, arm="ur5"), CELLS)


def test_items_and_boxes_that_do_not_go_are_refused_before_anything_is_simulated() -> None:
    heavy = Rules(robot=replace(CELL, density=8000.0))
    with pytest.raises(ArgumentError, match=r"weighs 5.18 kg: the largest cup lifts at most 2.46"):
        Episode(task_of(block(20, 20, 60), cells=(40, 40, 80)), heavy)
    with pytest.raises(ArgumentError, match="higher than the reach"):
        Episode(task_of(ITEMS[0], cells=(40, 40, 400)), Rules(robot=CELL))
    for wrong in ({"level": 3}, {"edge": 0}, {"gripper": {"cups": ()}}):
        with pytest.raises(ArgumentError, match="is not possible"):
            Rules.from_json({"robot": wrong})
    with pytest.raises(ArgumentError, match=r"level 2 is not possible for arm 'own\.urdf'"):
        replace(CELL, arm="own.urdf", level=2)
    with pytest.raises(ArgumentError, match="physics of its own"):
        Rules(robot=CELL, kinematic=True)


def test_a_missing_pybullet_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pybullet_module.cache_clear()
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(MissingPackageError, match="physics simulations need pybullet"):
        Episode(task_of(ITEMS[0]), Rules(robot=CELL))


def test_the_environment_rewards_what_the_arm_puts_in() -> None:
    env = PackItEnv([task_of(*ITEMS)], robot=CELL, observation="none", max_shapes=4)
    check_env(env, skip_render_check=True)
    env.reset(seed=0)
    total = 0.0
    for shape in range(3):
        env.step(shape)
        _, _, _, _, info = env.step(0)
        _, reward, over, _, info = env.step(int(np.argmax(info["action_mask"])))
        assert reward > 0 and info["outcome"] == "placed"
        total += reward
    assert over and total == pytest.approx(1)
