"""How deep an arm, its tool or a held item was in anything, by FCL along a trajectory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from packit_sim.core.caches import cached_property
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.physics.penetration import DEPTHS, DIRECTIONS
from packit_sim.placement import LooseMesh
from packit_sim.robot.arm import CUP
from packit_sim.robot.arms import arm_of
from packit_sim.robot.cell import RobotCell, walls
from packit_sim.robot.trajectory import Trajectory

_SIDES = 48
"""Sides of the prism around a cup."""


class _Body:
    """A mesh that moves as a whole: vertices (n, 3) in its own frame, in box units."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
        self.mesh = LooseMesh(vertices, faces)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        self._center, self._half = (low + high) / 2, (high - low) / 2

    def bounds(self, pose: Motion) -> Floats:
        """Return a box (2, 3) around it at a pose."""
        center, half = pose.apply(self._center), np.abs(pose.rotation) @ self._half
        return np.array((center - half, center + half))


@dataclass(frozen=True, eq=False)
class _There:
    """A body at a pose."""

    body: _Body
    pose: Motion

    @cached_property
    def bounds(self) -> Floats:
        return self.body.bounds(self.pose)

    def depth(self, other: _There, known: float) -> float:
        """Return an upper bound of the depth of an overlap, or of a known one if that is deeper."""
        between = other.pose.seen_from(self.pose)
        mesh, turn = self.body.mesh, np.ascontiguousarray(between.rotation)
        if not mesh.crosses(other.body.mesh, between.translation, turn):
            return known
        for depth in DEPTHS:
            if depth < known:
                continue
            shifts = (between.translation + depth * towards for towards in DIRECTIONS)
            if not all(mesh.crosses(other.body.mesh, shift, turn) for shift in shifts):
                return depth
        (low, high), (other_low, other_high) = self.bounds, other.bounds
        return max(known, float(min((high - other_low).min(), (other_high - low).min())))


def largest_penetration(trajectory: Trajectory) -> float:
    """Compute the largest penetration of the arm, its cup or the held item with anything.

    Parameters
    ----------
    trajectory : Trajectory
        The recorded trajectory.

    Returns
    -------
    float
        In box units; 0 if nothing crosses. Each step is tested. FCL decides on the exact meshes
        whether two cross, and the depth is the first of `penetration.DEPTHS` by which a shift in
        one of 26 directions separates them, or else the shift that separates their boxes.
    """
    cell = trajectory.cell
    surroundings = [_There(body, Motion()) for body in _surroundings(cell, trajectory)]
    arm = arm_of(cell, trajectory.cells)
    links = [_Body(_scaled(body, 1 / cell.edge)) for body in arm.bodies]
    bodies = [_Body(one.chosen.item.turned(0).mesh) for one in trajectory.attempts]
    known: dict[int, _There] = {}
    deepest = 0.0
    for number, attempt in enumerate(trajectory.attempts):
        own = attempt.recording
        if not len(own.joints):
            continue
        cup = _Body(_cup(own.radius / cell.edge, CUP / cell.edge))
        starts = np.searchsorted(own.rows[:, 0], np.arange(len(own.joints) + 1))
        tested: tuple[bytes, ...] = ()
        for step, joints in enumerate(own.joints):
            for row in range(starts[step], starts[step + 1]):
                item = int(own.rows[row, 1])
                known[item] = _There(bodies[item], _motion(own.poses[row]))
            state = (joints.tobytes(), own.poses[starts[step] : starts[step + 1]].tobytes())
            if state == tested or (tested and state[0] == tested[0] and not state[1]):
                continue
            tested = state
            moving = [
                _There(body, pose.at(pose.translation / cell.edge))
                for body, pose in zip((*links, cup), arm.poses(joints), strict=True)
            ]
            is_held = own.held[0] <= step < own.held[1]
            others = [there for n, there in known.items() if not (is_held and n == number)]
            if is_held:
                held = known[number]
                for one, other in _near([held], (*others, *surroundings)):
                    deepest = one.depth(other, deepest)
                others.append(held)
            for one, other in _near(moving, (*others, *surroundings)):
                deepest = one.depth(other, deepest)
    return deepest


def _near(moving: Sequence[_There], others: Sequence[_There]) -> Iterator[tuple[_There, _There]]:
    """Yield the pairs whose boxes overlap."""
    low, high = np.moveaxis(np.array([one.bounds for one in moving]), 1, 0)
    other_low, other_high = np.moveaxis(np.array([one.bounds for one in others]), 1, 0)
    overlap = (low[:, None] <= other_high).all(axis=2) & (other_low <= high[:, None]).all(axis=2)
    for i, j in np.argwhere(overlap).tolist():
        yield moving[i], others[j]


def _motion(row: Floats) -> Motion:
    w, x, y, z = row[3:].tolist()
    return Motion.from_wxyz((w, x, y, z), row[:3])


def _scaled(mesh: trimesh.Trimesh, scale: float) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)


def _cup(radius: float, height: float) -> trimesh.Trimesh:
    """Return a prism inside a cup, whose face is at the origin."""
    mesh = trimesh.creation.cylinder(radius, height, sections=_SIDES)
    mesh.apply_translation((0, 0, height / 2))
    return mesh


def _surroundings(cell: RobotCell, trajectory: Trajectory) -> list[_Body]:
    """Return the four walls, and the table with the floor of the box."""
    ends = [*walls(trajectory.cells).values(), ((-20, -20, -1), (20, 20, 0))]
    return [_Body(trimesh.creation.box(bounds=np.array(end, dtype=float))) for end in ends]
