"""How deep an arm, its tool or a held item was in anything, by FCL along a trajectory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.spatial.transform import Rotation

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.physics.penetration import DEPTHS, DIRECTIONS
from packit_sim.placement import LooseMesh
from packit_sim.robot.arm import CUP, Arm
from packit_sim.robot.arms import arm_of
from packit_sim.robot.cell import walls
from packit_sim.robot.recording import Recording
from packit_sim.robot.trajectory import Trajectory

_SIDES = 48
"""Sides of the prism around a cup."""

_SLACK = 1e-9
"""Box units by which boxes around bodies are larger."""

_BLOCK = 2_000
"""Poses that are computed together: those of a whole long recording would take gigabytes."""


class _Body:
    """A mesh that moves as a whole: vertices (n, 3) in its own frame, in box units."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
        self.mesh = LooseMesh(vertices, faces)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        self._center, self._half = (low + high) / 2, (high - low) / 2

    def bounds(self, poses: Floats) -> Floats:
        """Return boxes (..., 2, 3) around it, a little larger, at poses (..., 4, 4)."""
        centers = poses[..., :3, :3] @ self._center + poses[..., :3, 3]
        halves = np.abs(poses[..., :3, :3]) @ self._half + _SLACK
        return np.stack((centers - halves, centers + halves), axis=-2)


@dataclass(frozen=True, eq=False)
class _There:
    """A body at a pose."""

    body: _Body
    pose: Motion

    @property
    def bounds(self) -> Floats:
        return self.body.bounds(self.pose.matrix)

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


class _Surroundings:
    """Bodies around the arm: walls, floor and table, and the items where they are now."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._bodies = _fixed_bodies(trajectory)
        self._fixed = len(self._bodies)
        self._bodies += [_Body(one.chosen.item.turned(0).mesh) for one in trajectory.attempts]
        self._poses = np.tile((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (len(self._bodies), 1))
        nowhere = np.full((2, 3), np.inf) * ((1,), (-1,))
        self._bounds = np.tile(nowhere, (len(self._bodies), 1, 1))
        for n in range(self._fixed):
            self._bounds[n] = self._bodies[n].bounds(np.eye(4))

    def rows(self, recording: Recording) -> Floats:
        """Return boxes (n, 2, 3) around the recorded items at their recorded poses."""
        bounds = np.empty((len(recording.rows), 2, 3))
        for first in range(0, len(bounds), _BLOCK):
            block = slice(first, first + _BLOCK)
            items, recorded = recording.rows[block, 1], recording.poses[block]
            poses = np.tile(np.eye(4), (len(items), 1, 1))
            poses[:, :3, :3] = Rotation.from_quat(recorded[:, [4, 5, 6, 3]]).as_matrix()
            poses[:, :3, 3] = recorded[:, :3]
            for item in np.unique(items).tolist():
                mine = items == item
                bounds[block][mine] = self._bodies[self._fixed + item].bounds(poses[mine])
        return bounds

    def move(self, items: npt.NDArray[np.int64], poses: Floats, bounds: Floats) -> None:
        """Put items somewhere else."""
        self._poses[self._fixed + items], self._bounds[self._fixed + items] = poses, bounds

    def item(self, number: int) -> _There:
        """Return an item where it is."""
        return self._there(self._fixed + number)

    def near(self, moving: Floats, besides: int | None = None) -> Iterator[tuple[int, _There]]:
        """Yield what each of some moving boxes (n, 2, 3) may touch, besides an item."""
        low, high = moving[:, None, 0], moving[:, None, 1]
        overlap = (low <= self._bounds[:, 1]) & (self._bounds[:, 0] <= high)
        for n, other in np.argwhere(overlap.all(axis=2)).tolist():
            if besides is None or other != self._fixed + besides:
                yield n, self._there(other)

    def _there(self, number: int) -> _There:
        x, y, z, *wxyz = self._poses[number].tolist()
        return _There(self._bodies[number], Motion.from_wxyz(tuple(wxyz), np.array((x, y, z))))


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
    around = _Surroundings(trajectory)
    arm = arm_of(cell, trajectory.cells)
    links = [_Body(_scaled(body, 1 / cell.edge)) for body in arm.bodies]
    deepest = 0.0
    for number, attempt in enumerate(trajectory.attempts):
        own = attempt.recording
        if not len(own.joints):
            continue
        bodies = [*links, _Body(_cup(own.radius / cell.edge, CUP / cell.edge))]
        starts = np.searchsorted(own.rows[:, 0], np.arange(len(own.joints) + 1))
        bounds = around.rows(own)
        moving = _moving(arm, bodies, own.joints, cell.edge)
        tested = b""
        for step, (joints, (poses, boxes)) in enumerate(zip(own.joints, moving, strict=True)):
            rows = slice(starts[step], starts[step + 1])
            if rows.start == rows.stop and joints.tobytes() == tested:
                continue
            tested = joints.tobytes()
            around.move(own.rows[rows, 1], own.poses[rows], bounds[rows])
            if own.held[0] <= step < own.held[1]:
                held = around.item(number)
                for _, other in around.near(held.bounds[None], besides=number):
                    deepest = held.depth(other, deepest)
            for n, other in around.near(boxes):
                one = _There(bodies[n], Motion.from_matrix(poses[n]))
                deepest = one.depth(other, deepest)
    return deepest


def _moving(
    arm: Arm, bodies: Sequence[_Body], joints: Floats, edge: float
) -> Iterator[tuple[Floats, Floats]]:
    """Yield for each position of the joints the poses of bodies, and the boxes around them."""
    for first in range(0, len(joints), _BLOCK):
        poses = arm.matrices(joints[first : first + _BLOCK])
        poses[..., :3, 3] /= edge
        boxes = [body.bounds(poses[:, n]) for n, body in enumerate(bodies)]
        yield from zip(poses, np.stack(boxes, axis=1), strict=True)


def _scaled(mesh: trimesh.Trimesh, scale: float) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)


def _cup(radius: float, height: float) -> trimesh.Trimesh:
    """Return a prism inside a cup, whose face is at the origin."""
    mesh = trimesh.creation.cylinder(radius, height, sections=_SIDES)
    mesh.apply_translation((0, 0, height / 2))
    return mesh


def _fixed_bodies(trajectory: Trajectory) -> list[_Body]:
    """Return the four walls, and the table with the floor of the box."""
    ends = [*walls(trajectory.cells).values(), ((-20, -20, -1), (20, 20, 0))]
    return [_Body(trimesh.creation.box(bounds=np.array(end, dtype=float))) for end in ends]
