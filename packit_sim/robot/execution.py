"""One item at a time: pick it, carry it, insert it, release it, retreat, and let all items rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.motions import Motion
from packit_sim.physics.convex.pieces import Piece
from packit_sim.robot.arm import Arm, Route, ToolPath, tool_rotation
from packit_sim.robot.cell import PANDA, TILTED_TOOL, Cells, RobotCell
from packit_sim.robot.executed_item import Outcome
from packit_sim.robot.grasps import Grasp
from packit_sim.robot.recording import MOVED, Recording
from packit_sim.robot.world import ArmWorld

_RISING_STEPS = 12
"""Time steps for which an item stays where the cup lets it go: by then the cup has risen from the
item's convex pieces, which are thicker than its mesh."""

_DIP = 0.25 * TILTED_TOOL
"""Metres by which a cup goes down at most while the tool is turned on a straight move."""

_CHECK_STEPS = 10
"""Time steps between two checks whether everything rests."""


@dataclass(frozen=True, eq=False)
class Execution:
    """The result of a simulation in which the arm puts an item into the box.

    Attributes
    ----------
    outcome : Outcome
        Placed or lost.
    posed : tuple of PosedItem
        Where the items that were in the box are, and last the new one.
    recording : Recording
        Each step.
    """

    outcome: Outcome
    posed: tuple[PosedItem, ...]
    recording: Recording


def execute(
    before: Sequence[PosedItem],
    pieces: Sequence[Sequence[Piece]],
    numbers: Sequence[int],
    start: PosedItem,
    planned: PosedItem,
    radius: float,
    route: Route,
    *,
    cell: RobotCell,
    cells: Cells,
    arm: Arm,
) -> Execution:
    """Put one item into the box, in a new world in which everything starts at rest.

    The exact swept test must have proved that the item meets nothing on its way down: its convex
    pieces, which are thicker than its mesh, collide with nothing before the cup has risen from it.

    Parameters
    ----------
    before : sequence of PosedItem
        The items in the box.
    pieces : sequence of sequence of Piece
        Their convex pieces, and last those of the new item where it is released.
    numbers : sequence of int
        Their numbers among the items that were tried; the last is the new item's.
    start : PosedItem
        The new item at the station.
    planned : PosedItem
        Where the arm releases it.
    radius : float
        Radius of the cup, m.
    route : Route
        The motion of the arm.

    Returns
    -------
    Execution
        What happened.
    """
    settings = cell.world
    to_start = start.pose @ planned.pose.inverse()
    size = np.array(cells) / 100
    with ArmWorld(size, settings, arm, radius) as world:
        resting = [
            world.add(own, cell.mass(posed.item.volume))
            for posed, own in zip(before, pieces[:-1], strict=True)
        ]
        moved = [piece.moved(to_start.rotation, to_start.translation) for piece in pieces[-1]]
        item = world.present(moved, cell.mass(start.item.volume))
        world.start_at(route.start)
        run = _Run(world, cell, [*before, start], numbers)
        world.sleep(resting, True)
        run.drive(route.approach)
        world.grip(item)
        run.held_from()
        hold = cell.gripper.force(radius)
        lost = run.drive(route.carry, (hold, hold * radius))
        world.let_go(item)
        run.held_until()
        way = route.leave if lost is None else route.after_loss(lost)
        run.drive(way[:_RISING_STEPS])
        world.release()
        world.collide(item, True)
        world.sleep(resting, False)
        world.collide_arm(True)
        run.drive(way[_RISING_STEPS:])
        run.rest()
        outcome = Outcome.PLACED if lost is None else Outcome.LOST
        return Execution(outcome, run.posed, run.recording(radius))


def tool_path(
    before: Sequence[PosedItem],
    start: PosedItem,
    planned: PosedItem,
    grasp: Grasp,
    shifts: Sequence[Floats],
    *,
    cell: RobotCell,
    cells: Cells,
) -> ToolPath:
    """Compute where the tool passes: up, over the rim and what protrudes, and in by straight moves.

    At level 2 the tool comes along its axis, tilted, and is turned above the rim.

    Parameters
    ----------
    before : sequence of PosedItem
        The items in the box.
    start : PosedItem
        The new item at the station.
    planned : PosedItem
        Where the arm releases it.
    grasp : Grasp
        Where the cup holds it.
    shifts : sequence of ndarray of float64, shape (3,)
        The straight moves into the box (see `insertion_shifts`).

    Returns
    -------
    ToolPath
        Where the tool passes.
    """
    turn = start.pose.rotation @ planned.pose.rotation.T
    axis, tilt = turn[:, 2], math.acos(min(float(turn[2, 2]), 1.0)) if cell.level == 2 else 0.0
    yaw, released = math.atan2(turn[1, 0], turn[0, 0]), 0.0
    if tilt:
        yaw = math.atan2(axis[1], axis[0])
        left = turn.T @ tool_rotation(yaw, tilt)  # the yaw of the tool where it is vertical
        released = yaw + math.remainder(math.atan2(left[1, 0], left[0, 0]) - yaw, 2 * math.pi)
    point = np.array(grasp.point)
    pick = (start.center + turn @ point) * cell.edge
    place = (planned.center + point) * cell.edge
    place[2] += cell.gap
    turns = [place + shift * cell.edge for shift in shifts]
    tops = [float(posed.bounds[1, 2]) * cell.edge for posed in before]
    rim = max([float(cell.size(cells)[2]), *tops])
    height = float(start.bounds[1, 2]) * cell.edge
    surface = start.vertices * cell.edge - pick
    depth = place[2] - float(planned.bounds[0, 2]) * cell.edge
    carried = rim + cell.clearance + pick[2]
    over_pick = _raised(pick, height + cell.clearance)
    approach = [over_pick]
    if tilt:  # beside the item on the tool's axis, and from there along it
        ball = float(np.linalg.norm(surface, axis=1).max()) + _DIP
        carried = rim + cell.clearance + (max(depth, pick[2]) if cell.arm == PANDA else ball)
        beside = pick + axis * (float((surface @ axis).max()) + cell.clearance)
        approach = [_raised(beside, carried), beside]
    home = _raised(cell.station(cells), carried)
    return ToolPath(
        [np.append(one, (yaw, tilt)) for one in (home, *approach, pick)],
        np.append(_raised(pick, carried), (yaw, tilt)),
        [np.append(one, (released, 0.0)) for one in (_raised(turns[0], carried), *turns)],
        np.append(_raised(place, rim + cell.clearance), (released, 0.0)),
    )


def _raised(point: Floats, height: float) -> Floats:
    return np.array((point[0], point[1], height))


def composed(frames: Floats, motion: Motion) -> Floats:
    """Apply a motion before each of many.

    Parameters
    ----------
    frames : ndarray of float64, shape (n, 7)
        Translations and unit quaternions x, y, z, w.

    Returns
    -------
    ndarray of float64, shape (n, 7)
        Translations and unit quaternions w, x, y, z.
    """
    turns = Rotation.from_quat(frames[:, 3:])
    shifts = frames[:, :3] + turns.apply(np.array(motion.translation))
    x, y, z, w = (turns * Rotation.from_quat(motion.xyzw)).as_quat().T
    return np.column_stack((shifts, w, x, y, z))


class _Run:
    """The simulation of one attempt, and its recording."""

    def __init__(
        self,
        world: ArmWorld,
        cell: RobotCell,
        items: Sequence[PosedItem],
        numbers: Sequence[int],
    ) -> None:
        self._world = world
        self._cell = cell
        self._items = items
        self._numbers = numbers
        self._joints: list[Floats] = []
        self._rows: list[tuple[int, int]] = []
        self._raw: list[Floats] = []
        self._last = np.full((len(items), 7), np.inf)
        self._held = [0, 0]
        self._at: Floats | None = None
        self._record()

    @property
    def posed(self) -> tuple[PosedItem, ...]:
        """The items where they are."""
        moves = self._world.moves
        return tuple(item.moved(move) for item, move in zip(self._items, moves, strict=True))

    def held_from(self) -> None:
        """Note that the tool holds the item from the next step on."""
        self._held[0] = len(self._joints)

    def held_until(self) -> None:
        """Note that it does not any more."""
        self._held[1] = len(self._joints)

    def drive(self, way: Floats, most: tuple[float, float] = (math.inf, math.inf)) -> int | None:
        """Drive along joints (n, joints); return the step in which the load is above `most`."""
        for step, joints in enumerate(way):
            self._world.drive(joints)
            self._at = joints
            self._record()
            if math.isfinite(most[0]):
                force, moment = self._world.load
                if force > most[0] or moment > most[1]:
                    return step
        return None

    def rest(self) -> None:
        """Wait until everything is at rest, or the time limit of the world is over."""
        settings = self._cell.world
        assert self._at is not None
        rested = seconds = 0.0
        interval = _CHECK_STEPS * settings.step
        while rested < settings.rest_time and seconds < settings.time_limit:
            for _ in range(_CHECK_STEPS):
                self._world.drive(self._at)
                self._record()
            seconds += interval
            is_at_rest = (self._world.speeds < settings.rest_speed).all()
            rested = rested + interval if is_at_rest else 0.0

    def recording(self, radius: float) -> Recording:
        """Return the recording, with poses of the canonical shapes."""
        raw, own = np.array(self._raw), np.array([item for _, item in self._rows])
        poses = np.empty((len(raw), 7))
        for item, start in enumerate(self._items):
            mine = own == item
            poses[mine] = composed(raw[mine], self._world.axes_from(item, start.pose))
        rows = np.array([(step, self._numbers[item]) for step, item in self._rows])
        return Recording(
            np.array(self._joints), (self._held[0], self._held[1]), radius, rows, poses
        )

    def _record(self) -> None:
        """Note where the joints are, and which of the items that can move have moved."""
        step = len(self._joints)
        self._joints.append(self._world.joints)
        items = self._world.awake
        poses = self._world.poses(items)
        for row in np.flatnonzero(np.abs(poses - self._last[items]).max(axis=1) > MOVED).tolist():
            item = items[row]
            self._rows.append((step, item))
            self._raw.append(poses[row])
            self._last[item] = poses[row]
