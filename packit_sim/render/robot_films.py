"""Films of an arm that packs a box, from its recorded trajectory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import trimesh

from packit_sim.core.checks import POSITIVE, Range, check_range
from packit_sim.geometry.items import BoxState, PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.render.cameras import Camera
from packit_sim.render.coloring import UNKNOWN_COLOR, Colors, by_item
from packit_sim.render.films import Frame
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import Look
from packit_sim.robot.arm import CUP
from packit_sim.robot.arms import arm_of
from packit_sim.robot.trajectory import Trajectory

LOOK = Look(Camera(azimuth=-40.0, elevation=28.0))
"""The box in front, the station behind it."""

MARGIN = 1.0
"""Box units above the box that the picture shows."""

_SECOND = 240
"""Steps of a trajectory between two that choose what the picture shows."""

_ARM = "arm"
"""Category of the shapes of an arm's bodies."""


def executing(
    trajectory: Trajectory, look: Look = LOOK, *, fps: int = 12, speed: float = 4.0
) -> tuple[BoxState[PosedItem], Iterator[Frame]]:
    """Film how an arm packed a box.

    Parameters
    ----------
    trajectory : Trajectory
        What the arm and the items did.
    look : Look
        The look of the box; the arm is grey.
    fps : int
        Frames per second, 1 to 100.
    speed : float
        Simulated seconds in a second of the film.

    Returns
    -------
    box : BoxState
        The box, with all items and the bodies of the arm.
    frames : iterator of Frame
        The frames, for `films.shot`. An item appears once it is presented.

    Raises
    ------
    ArgumentError
        If a value is out of range.
    """
    check_range("fps", fps, Range(1, 100))
    check_range("speed", speed, POSITIVE)
    cell, cells = trajectory.cell, trajectory.cells
    arm = arm_of(cell, cells)
    bodies = [_body(mesh, f"body {n}", cell.edge) for n, mesh in enumerate(arm.bodies)]
    for radius in sorted({one.recording.radius for one in trajectory.attempts} - {0.0}):
        cup = trimesh.creation.cylinder(radius, CUP)
        cup.apply_translation((0, 0, CUP / 2))
        bodies.append(_body(cup, f"cup {radius:g}", cell.edge))
    items = [one.planned for one in trajectory.attempts]
    x, y, z = map(round, cells)  # parts may have boxes of fractions of a cell
    box = BoxState((x, y, z), (*items, *bodies))
    shown = replace(look, coloring=_with_grey_arm)
    return box, _frames(trajectory, bodies, shown, max(1, round(speed / fps / cell.world.step)))


def _frames(
    trajectory: Trajectory, bodies: Sequence[PosedItem], look: Look, stride: int
) -> Iterator[Frame]:
    cell = trajectory.cell
    arm = arm_of(cell, trajectory.cells)
    size = np.array(trajectory.cells) * CELL
    station = cell.station(trajectory.cells) / cell.edge
    around = station + np.array([(x, y, 0) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    points = np.concatenate((around, [(*size[:2] / 2, size[2] + MARGIN)]))
    if arm.base.translation.any():  # it stands next to the box: its joints are in the picture
        each = (one.recording.joints[::_SECOND] for one in trajectory.attempts)
        first = next((joints for joints in each if len(joints)), np.empty((0, cell.joints)))
        joints = [pose.translation for one in first for pose in arm.poses(one)]
        points = np.concatenate((around, np.reshape(joints, (-1, 3)) / cell.edge))
    poses: list[Motion | None] = [None] * len(trajectory.attempts)
    for number, attempt in enumerate(trajectory.attempts):
        own = attempt.recording
        starts = np.searchsorted(own.rows[:, 0], np.arange(len(own.joints) + 1))
        for step, joints in enumerate(own.joints):
            for row in range(starts[step], starts[step + 1]):
                w, x, y, z = own.poses[row, 3:].tolist()
                poses[int(own.rows[row, 1])] = Motion.from_wxyz((w, x, y, z), own.poses[row, :3])
            if step % stride:
                continue
            *moved, tool = arm.poses(joints)
            links = moved[: len(arm.bodies)]
            tip = f"{_ARM} cup {own.radius:g}"
            in_use = [*links, *(tool for _ in bodies[len(links) :])]
            drawn = [
                _in_box(body, pose, cell.edge)
                if n < len(links) or body.item.shape.id == tip
                else None
                for n, (body, pose) in enumerate(zip(bodies, in_use, strict=True))
            ]
            yield look, Layout((*poses, *drawn), points)
        if not len(own.joints):
            poses[number] = None


def _body(mesh: trimesh.Trimesh, name: str, edge: float) -> PosedItem:
    """Return a body of the arm, in m, as an item: at its place in the body's frame."""
    shape = Shape.from_mesh(mesh, f"{_ARM} {name}", _ARM)
    scale = float(np.linalg.norm(mesh.extents) / edge) ** 3
    middle = mesh.bounds.mean(axis=0) / edge
    return PosedItem.at(Item(shape, scale), Motion.shift(middle))


def _in_box(body: PosedItem, pose: Motion, edge: float) -> Motion:
    """Return the pose of a body's shape in box units, for a pose of its frame in m."""
    return pose.at(pose.translation / edge) @ body.pose


def _with_grey_arm(items: Sequence[Item]) -> Colors:
    grey = [item.shape.category == _ARM for item in items]
    colors = by_item(items).of
    return Colors(
        tuple(
            UNKNOWN_COLOR if is_arm else color for is_arm, color in zip(grey, colors, strict=True)
        )
    )
