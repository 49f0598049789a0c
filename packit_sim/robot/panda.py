"""The panda: an arm with seven joints on a pedestal, whose flange always points straight down.

Its model comes with PyBullet. The third and the fifth joint stay at 0, and the sixth follows the
second and the fourth, so that the flange is vertical: joints of which this holds are level. A mean
of level joints is level too, so that what the tool holds keeps its rotation on every straight move.
At level 2 the tool has an eighth joint near its end, which tilts it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh
from lxml import etree
from trimesh import transformations

from packit_sim.core.caches import cached_property
from packit_sim.core.errors import ArgumentError
from packit_sim.core.extras import MissingPackageError, needed_for
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.robot.arm import CUP, STATION_REACH, Arm, Route, ToolPath, tool_rotation
from packit_sim.robot.cell import PANDA, TILTED_TOOL, TUBE, WALL, Cells, RobotCell
from packit_sim.robot.clearance import PADDING, Obstacles, PaddedBody, PosedBodies
from packit_sim.robot.motion import along
from packit_sim.robot.paths import find_path
from packit_sim.robot.urdf import TILT, tilting_tip

LEVEL = (0, 1, 3, 6)
"""The joints that are chosen, and the tool's; the others follow."""

TILT_SPEED = 2.61
"""Largest speed of the tool's joint, rad/s: that of the wrist."""

ADAPTER = (0.06, 0.06, 0.04)
"""The block that fixes the tube to the flange, m."""

HAND = 6
"""The number of links that can meet a held item at level 1: the others are above it."""

HOME = 0.40
"""Metres between the axis of the base and the cup, before and after."""

EDGE_POINTS = 50
"""Points of an edge between which joints are interpolated."""

PEDESTAL = 0.20
"""Side of the column on which the base stands, m."""

TUBE_MARGIN = 0.10
"""Metres by which the tube is longer than the box is high: the flange never enters the box."""

_MOVED = (np.array((1.0, 0.85, 0.6, 0.35)), np.array((1.1, 0.95, 0.7, 0.45, 0.45)))
"""Bounds, at levels 1 and 2, of how far a point of the arm or of what it holds moves, in m, by a
radian of a level joint."""

_LINE = 0.005
"""Metres between two points of a straight line of the tool that are checked."""


@dataclass(frozen=True, eq=False)
class PandaModel:
    """The panda as PyBullet's file describes it, without its hand.

    origins: (7, 4, 4), of the joints' frames in those of the links before. flange: m from the last
    link's origin. low, high, speeds: limits of the joints (7,), in radians and rad/s. links: convex
    meshes of the links, in m.
    """

    robot: Any
    origins: Floats
    flange: float
    low: Floats
    high: Floats
    speeds: Floats
    links: tuple[trimesh.Trimesh, ...]


@functools.cache
def panda_model() -> PandaModel:
    """Read the model, or raise MissingPackageError."""
    with needed_for("cells with the arm panda"):
        import pybullet_data
    folder = Path(pybullet_data.getDataPath()) / "franka_panda"
    if not folder.is_dir():
        raise MissingPackageError(
            f"cells with the arm panda need {folder}, which PyBullet installs, and which was "
            "removed: pip install --force-reinstall --no-deps pybullet"
        )
    robot = etree.parse(folder / "panda.urdf").getroot()
    names = [f"panda_link{n}" for n in range(9)]
    for one in robot.findall("link"):
        if one.get("name") not in names:
            robot.remove(one)
        for part in (*one.findall("visual"), *one.findall("collision")):
            one.remove(part)
    for one in robot.findall("joint"):
        if one.find("child").get("link") not in names:
            robot.remove(one)
    joints = robot.findall("joint")
    origins = [_origin(one) for one in joints]
    limits = [one.find("safety_controller") for one in joints[:7]]
    paths = [folder / "meshes" / "collision" / f"link{n}.obj" for n in range(8)]
    return PandaModel(
        robot,
        np.array(origins[:7]),
        float(origins[7][2, 3]),
        np.array([float(one.get("soft_lower_limit")) for one in limits]),
        np.array([float(one.get("soft_upper_limit")) for one in limits]),
        np.array([float(one.find("limit").get("velocity")) for one in joints[:7]]),
        tuple(trimesh.load_mesh(path).convex_hull for path in paths),
    )


def _box(mesh: trimesh.Trimesh) -> str:
    """Return a box of the tool as a URDF has it."""
    x, y, z = mesh.extents.tolist()
    origin = f'<origin xyz="0 0 {mesh.bounds[:, 2].mean()}"/>'
    return f'<collision>{origin}<geometry><box size="{x} {y} {z}"/></geometry></collision>'


def _origin(joint: Any) -> Floats:
    xyz, rpy = (
        [float(one) for one in joint.find("origin").get(name).split()] for name in ("xyz", "rpy")
    )
    matrix = transformations.euler_matrix(*rpy)
    matrix[:3, 3] = xyz
    return np.asarray(matrix)


@dataclass(frozen=True, eq=False)
class Panda(Arm):
    """The panda with a tube that carries the cup.

    Attributes
    ----------
    cell : RobotCell
        The cell.
    cells : Cells
        The cells of the box.
    length : float
        From the flange to the cup's face, m.
    """

    cell: RobotCell
    cells: Cells
    length: float
    base: Motion
    urdf: str
    bodies: tuple[trimesh.Trimesh, ...]

    @classmethod
    def of(cls, cell: RobotCell, cells: Cells) -> Panda:
        """Create the arm for a box.

        Returns
        -------
        Panda
            The arm.

        Raises
        ------
        MissingPackageError
            If its files, which come with PyBullet, are missing.
        """
        model = panda_model()
        length = float(cell.size(cells)[2]) + TUBE_MARGIN
        middle = float(cell.size(cells)[2]) + cell.clearance  # of the heights of the cup
        height = max(middle + length + model.flange - model.origins[0, 2, 3], 0.0)
        x, y = cell.foot(cells)
        adapter = trimesh.creation.box(ADAPTER)
        adapter.apply_translation((0, 0, length - ADAPTER[2] / 2))
        low = CUP if cell.level == 1 else TILTED_TOOL
        tube = trimesh.creation.box((TUBE, TUBE, length - low - ADAPTER[2]))
        tube.apply_translation((0, 0, (length + low - ADAPTER[2]) / 2))
        bodies = [*model.links, adapter, tube]
        name, tip = "tool", ""
        if cell.level == 2:
            name, tip = "head", tilting_tip(-TILT)
            end = trimesh.creation.box((TUBE, TUBE, TILTED_TOOL - CUP))
            end.apply_translation((0, 0, (TILTED_TOOL + CUP) / 2))
            bodies.append(end)
        tool = (
            f'<link name="{name}"><inertial><mass value="0.2"/><inertia ixx="1" iyy="1" izz="1" '
            f'ixy="0" ixz="0" iyz="0"/></inertial>{_box(tube)}{_box(adapter)}</link>'
            f'<joint name="flange" type="fixed"><parent link="panda_link8"/><child link="{name}"/>'
            f'<origin xyz="0 0 {length}" rpy="{math.pi} 0 0"/></joint>{tip}</robot>'
        )
        text = etree.tostring(model.robot, encoding="unicode").replace("</robot>", tool)
        base = Motion.shift((x, y, height))
        return cls(cell, cells, length, base, text, tuple(bodies))

    def matrices(self, joints: Floats) -> Floats:
        turns = np.tile(np.eye(4), (len(joints), 7, 1, 1))
        turns[..., 0, 0] = turns[..., 1, 1] = np.cos(joints[:, :7])
        turns[..., 1, 0] = np.sin(joints[:, :7])
        turns[..., 0, 1] = -turns[..., 1, 0]
        links = [np.tile(self.base.matrix, (len(joints), 1, 1))]
        for n, origin in enumerate(panda_model().origins):
            links.append(links[-1] @ origin @ turns[:, n])
        reach = panda_model().flange + self.length
        tool = links[-1] * np.array((1.0, -1.0, -1.0, 1.0))  # upside down
        tool[:, :3, 3] -= tool[:, :3, 2] * reach
        if self.cell.level == 1:
            return np.stack((*links, tool, tool, tool), axis=1)
        tip = tool.copy()
        tip[:, :3, :3] = tool[:, :3, :3] @ tool_rotation(0.0, joints[:, 7])
        tip[:, :3, 3] += TILTED_TOOL * (tool[:, :3, 2] - tip[:, :3, 2])
        return np.stack((*links, tool, tool, tip, tip), axis=1)

    def check(self, cells: Cells, longest: float) -> None:
        size, station = self.cell.size(cells), self.cell.station(cells)
        rim = float(size[2]) + self.cell.clearance
        x, y = size[:2].tolist()
        box = [(a, b) for a in (0, x / 2, x) for b in (0, y / 2, y)]
        turns = np.arange(8) * math.pi / 4
        around = station[:2] + STATION_REACH * np.column_stack((np.cos(turns), np.sin(turns)))
        low = 0.0 if self.cell.level == 1 else -TILTED_TOOL  # of a tool that is level there
        for name, spots, floor in (("box", box, 0.0), ("station", around.tolist(), low)):
            for height, what in ((floor, "down to"), (rim + longest, "above the rim to")):
                points = np.array([(*spot, height) for spot in spots])
                reached = self._is_possible(self._inverse(points))
                if not reached.all():
                    spot = ", ".join(f"{one:.3g}" for one in points[~reached][0])
                    raise ArgumentError(
                        f"arm {PANDA!r} can't reach the {name}: with an item {longest:.3g} m long "
                        f"in a box of {' x '.join(f'{one:.3g}' for one in size)} m its cup must "
                        f"come {what} the point ({spot}) m; choose a smaller edge, now "
                        f"{self.cell.edge:g} m, or arm gantry"
                    )

    def route(self, path: ToolPath, load: trimesh.Trimesh, seed: Sequence[int]) -> Route | None:
        """Plan straight lines to, with and without the item, and paths between them."""
        for turned in (False, True)[: self.cell.level]:
            route = self._route(path, load, seed, turned)
            if route is not None:
                return route
        return None

    def _route(
        self, path: ToolPath, load: trimesh.Trimesh, seed: Sequence[int], turned: bool
    ) -> Route | None:
        """Plan a route; at level 2 perhaps with a tool that is turned by 180 degrees."""

        def line(*points: Floats) -> Floats:
            return self._line([self._grip(path, turned, point) for point in points])

        is_tilted = path.pick[4] != 0
        first = path.approach[1] if is_tilted else path.lifted
        fetch = line(first, *(path.approach[2:] if is_tilted else (path.pick,)))
        up = line(path.pick, path.lifted)
        aside = line(path.lifted, first)
        insert = line(*path.insertion)
        retreat = line(path.place, path.retreat)
        lines = (fetch, up, aside, insert, retreat)
        if not all(self._is_possible(points).all() for points in lines):
            return None
        held = load.copy()
        held.apply_transform(self.poses(_level(up[0]))[-1].inverse().matrix)
        top = float(path.retreat[2]) - self.cell.clearance
        obstacles = self._obstacles(top)
        bodies = self._padded
        with_item = (*bodies, PaddedBody.of(held))
        links = bodies[: -self.cell.level]  # without the tubes: they come down where the item does
        nearby = self._obstacles(top, table=False)
        checks = [(fetch, bodies, nearby), (up, with_item, nearby), (aside, bodies, obstacles)]
        checks += [(one, links, obstacles) for one in (fetch, insert, retreat)]
        for points, moving, there in checks:
            if not self._are_clear(points, moving, there):
                return None
        home = self._inverse(self._home(top))[0]
        rng = np.random.default_rng(seed)
        reach = self._path(home, fetch[0], bodies, self._obstacles(top, load.bounds), rng)
        carry = self._path(up[-1], insert[0], with_item, obstacles, rng)
        back = self._path(retreat[-1], home, bodies, obstacles, rng)
        if reach is None or carry is None or back is None:
            return None
        lift = self._timed(up)
        approach = self._along_edges(reach)
        return Route(
            start=_level(home),
            approach=np.concatenate((approach, self._timed(fetch))),
            carry=np.concatenate((lift, self._along_edges(carry), self._timed(insert))),
            leave=np.concatenate((self._timed(retreat), self._along_edges(back))),
            lifted=len(lift),
            abandon=np.concatenate((self._timed(aside), approach[::-1], _level(home)[None])),
        )

    def _grip(self, path: ToolPath, turned: bool, point: Floats) -> Floats:
        """Return a point of a path with the angle about the vertical of the tool, not the item.

        At level 1 the tool grips the item so that its wrist turns equally far to both sides; at
        level 2 the tilt decides, so that there are two ways.
        """
        sign = -1.0 if turned else 1.0
        turn = math.pi if turned else 0.0
        if self.cell.level == 1:
            bearings = [self._bearing(one) - one[3] for one in (path.pick, path.place)]
            turn = bearings[0] - math.remainder(bearings[0] - bearings[1], 2 * math.pi) / 2
        return point * np.array((1.0, 1.0, 1.0, 1.0, sign)) + np.array((0.0, 0.0, 0.0, turn, 0.0))

    @cached_property
    def _padded(self) -> tuple[PaddedBody, ...]:
        return tuple(map(PaddedBody.of, self.bodies))

    @cached_property
    def _pairs(self) -> npt.NDArray[np.int64]:
        """Pairs of bodies that can meet, (n, 2): those that are apart at home.

        The number after those of the arm is that of the held item.
        """
        there = PosedBodies(self._padded, self.matrices(_level(self._inverse(self._home(0.0))))[0])
        pairs = np.array([*combinations(range(len(self._padded)), 2)])
        hand = HAND if self.cell.level == 1 else len(self.bodies) - self.cell.level
        held = [(n, len(self.bodies)) for n in range(hand)]
        return np.array([*(pair for pair in pairs if there.are_apart(pair[None])), *held])

    def _home(self, top: float) -> Floats:
        """Return where the cup is before and after, (1, 3): between the box and the station."""
        x, y = self.cell.foot(self.cells)
        spot = HOME / math.sqrt(2)
        least = float(self.cell.size(self.cells)[2])
        return np.array(((x + spot, y + spot, max(top, least) + 2 * self.cell.clearance),))

    def _obstacles(self, top: float, item: Floats | None = None, table: bool = True) -> Obstacles:
        """Return the box as a block up to a height, the pedestal, an item, and the table."""
        x, y, _ = self.cell.size(self.cells).tolist()
        wall, far = WALL * self.cell.edge, 5.0
        at, half = self.base.translation, np.array((PEDESTAL / 2, PEDESTAL / 2, 0.0))
        ends = [
            ((-wall, -wall, 0), (x + wall, y + wall, top)),
            (at * (1, 1, 0) - half, at + half),
        ]
        ends += [((-far, -far, -1), (far, far, 0))] if table else []
        return Obstacles.of([*ends, item] if item is not None else ends)

    def _are_clear(
        self, points: Floats, bodies: Sequence[PaddedBody], obstacles: Obstacles
    ) -> bool:
        """Decide whether the first bodies are clear of obstacles and of each other at all points.

        Body 0 is fixed. The tubes are clear of the held item at any tilt, by the choice of grasps.
        """
        pairs = self._pairs[(self._pairs < len(bodies)).all(axis=1)]
        each = (PosedBodies(bodies, poses) for poses in self.matrices(_level(points)))
        return all(there.are_clear(obstacles, first=1) and there.are_apart(pairs) for there in each)

    def _path(
        self,
        start: Floats,
        goal: Floats,
        bodies: Sequence[PaddedBody],
        obstacles: Obstacles,
        rng: np.random.Generator,
    ) -> Floats | None:
        """Find a path between level joints."""

        def is_free(one: Floats, other: Floats) -> bool:
            moved = float(np.abs(other - one) @ _MOVED[self.cell.level - 1])
            count = math.ceil(moved / (2 * PADDING)) + 1
            points = np.linspace(one, other, max(count, 2))
            return bool(self._is_possible(points).all()) and self._are_clear(
                points[_spread(len(points))], bodies, obstacles
            )

        model, tilt = panda_model(), (TILT,) * (self.cell.level - 1)
        low = np.append(model.low[list(LEVEL)], np.negative(tilt))
        high = np.append(model.high[list(LEVEL)], tilt)
        return find_path(start, goal, low, high, is_free, rng)

    def _bearing(self, point: Floats) -> float:
        x, y, _ = point[:3] - self.base.translation
        return math.atan2(y, x)

    def _line(self, points: Sequence[Floats]) -> Floats:
        """Return level joints along straight lines of the tool; nan out of reach."""
        found = [points[0][None]]
        for start, end in pairwise(points):
            count = math.ceil(float(np.linalg.norm(end[:3] - start[:3])) / _LINE) + 1
            found.append(np.linspace(start, end, count)[1:])
        along_it = np.concatenate(found)
        yaw, tilt = along_it[:, 3], along_it[:, 4]
        free = self._inverse(along_it[:, :3] + _aside(yaw, tilt))
        free[:, 3] = np.remainder(free[:, 0] - yaw + math.pi, 2 * math.pi) - math.pi
        free[:, 4:] = tilt[:, None]
        return free

    def _inverse(self, points: Floats) -> Floats:
        """Return level joints for places of the cup (n, 3) in m, 0 at the tool; nan out of reach.

        Returns
        -------
        ndarray of float64, shape (n, 4), or (n, 5) at level 2
            The joints of `LEVEL`, and the tilt.
        """
        x, y, z = (points - self.base.translation).T
        upper, lower, bend, fold, offset, shoulder = _lengths()
        away = np.hypot(x, y) - offset
        high = z + self.length + panda_model().flange - shoulder
        cosine = (away**2 + high**2 - upper**2 - lower**2) / (2 * upper * lower)
        angle = np.arccos(np.where(np.abs(cosine) <= 1, cosine, np.nan))
        lift = np.arctan2(away, high) - np.arctan2(
            lower * np.sin(angle), upper + lower * np.cos(angle)
        )
        rest = np.zeros((len(points), self.cell.level))
        return np.column_stack((np.arctan2(y, x), lift - bend, -angle - fold, rest))

    def _is_possible(self, free: Floats) -> npt.NDArray[np.bool_]:
        """Decide which level joints are within the limits."""
        joints, model = _level(free), panda_model()
        within = (joints[:, :7] >= model.low) & (joints[:, :7] <= model.high)
        return np.asarray(within.all(axis=1) & (np.abs(joints[:, 7:]) <= TILT).all(axis=1))

    def _along_edges(self, corners: Floats) -> Floats:
        """Time a path between level joints, with a stop at each corner."""
        edges = [np.linspace(one, other, EDGE_POINTS) for one, other in pairwise(corners)]
        return np.concatenate([self._timed(edge) for edge in edges])

    def _timed(self, free: Floats) -> Floats:
        """Time a path of level joints, within the limits of the tool and the joints."""
        joints = _level(free)
        speeds = np.append(panda_model().speeds, (TILT_SPEED,) * (self.cell.level - 1))
        seconds = (np.abs(np.diff(joints, axis=0)) / speeds).max(axis=1)
        moved = np.linalg.norm(np.diff(self._cups(free), axis=0), axis=1)
        return along(joints, np.maximum(seconds * self.cell.speed, moved), self.cell)

    def _cups(self, free: Floats) -> Floats:
        """Return where the cup is, (n, 3), at level joints."""
        upper, lower, bend, fold, offset, shoulder = _lengths()
        first = free[:, 1] + bend
        second = first - free[:, 2] - fold
        away = upper * np.sin(first) + lower * np.sin(second) + offset
        high = upper * np.cos(first) + lower * np.cos(second) + shoulder
        high -= self.length + panda_model().flange
        upright = self.base.translation + np.column_stack(
            (away * np.cos(free[:, 0]), away * np.sin(free[:, 0]), high)
        )
        if self.cell.level == 1:
            return upright
        return upright - _aside(free[:, 0] - free[:, 3], free[:, 4])


def _level(free: Floats) -> Floats:
    """Return all joints (..., 7 or 8) for level ones (..., 4 or 5)."""
    first, second, fourth, *last = np.moveaxis(free, -1, 0)
    none = np.zeros_like(first)
    return np.stack((first, second, none, fourth, none, second - fourth, *last), axis=-1)


def _aside(yaw: Floats, tilt: Floats) -> Floats:
    """Return how far from a tilted cup (n, 3) it would be if the tool were vertical, m."""
    sine = np.sin(tilt)
    away = np.column_stack((np.cos(yaw) * sine, np.sin(yaw) * sine, np.cos(tilt) - 1.0))
    return np.asarray(TILTED_TOOL * away)


@functools.cache
def _lengths() -> tuple[float, ...]:
    """Return the arm as two straight pieces in a vertical plane.

    Lengths of the upper and the lower piece in m, the angle between the upper one and the second
    joint, that of both and the fourth joint, the distance of the flange's axis from the wrist, and
    the height of the shoulder.
    """
    shifts = panda_model().origins[:, :3, 3]
    rise, side = -float(shifts[2, 1]), float(shifts[3, 0])
    reach, back = float(shifts[4, 1]), -float(shifts[4, 0])
    bend, fold = math.atan2(side, rise), math.atan2(back, reach)
    lengths = math.hypot(rise, side), math.hypot(reach, back)
    return (*lengths, bend, bend + fold, float(shifts[6, 0]), float(shifts[0, 2]))


def _spread(count: int) -> list[int]:
    """Order the points of an edge so that coarse steps come first, which find most collisions."""
    return sorted(range(count), key=lambda n: (n & -n) if n else count, reverse=True)
