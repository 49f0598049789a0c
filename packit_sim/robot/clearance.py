"""The distance that a moving arm keeps from boxes around it, and from itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry.arrays import Floats
from packit_sim.placement import LooseMesh

PADDING = 0.005
"""Metres by which convex bodies grow before they are tested: what moves by less than twice that
between two tests keeps clear of all obstacles."""


@dataclass(frozen=True, eq=False)
class PaddedBody:
    """The convex hull of a body, grown by `PADDING`, in m.

    center, radius: a ball around it.
    """

    mesh: LooseMesh
    center: Floats
    radius: float

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> PaddedBody:
        """Grow the hull of a mesh."""
        ball = trimesh.creation.icosphere(subdivisions=1, radius=1.0)
        inner = float(np.abs((ball.face_normals * ball.triangles_center).sum(axis=1)).min())
        offsets = ball.vertices * (PADDING / inner)  # a polyhedron around the ball
        corners = mesh.convex_hull.vertices
        points = (corners[:, None] + offsets[None]).reshape(-1, 3)
        hull = trimesh.convex.convex_hull(points)
        vertices = np.array(hull.vertices, dtype=np.float64)
        center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        radius = float(np.linalg.norm(vertices - center, axis=1).max())
        return cls(LooseMesh(vertices, np.array(hull.faces, dtype=np.int64)), center, radius)


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Boxes along the axes: corners (n, 3), in m."""

    low: Floats
    high: Floats
    meshes: tuple[LooseMesh, ...]

    @classmethod
    def of(cls, ends: Sequence[npt.ArrayLike]) -> Obstacles:
        """Create boxes from their low and high corners, (2, 3) each."""
        bounds = np.array(ends, dtype=np.float64)
        boxes = [trimesh.creation.box(bounds=one) for one in bounds]
        meshes = (LooseMesh(np.array(one.vertices), np.array(one.faces)) for one in boxes)
        return cls(bounds[:, 0], bounds[:, 1], tuple(meshes))


class PosedBodies:
    """Bodies at poses, matrices (n, 4, 4); a pose more than bodies is not looked at."""

    def __init__(self, bodies: Sequence[PaddedBody], poses: Floats) -> None:
        self._bodies = bodies
        self._turns, self._shifts = poses[:, :3, :3], poses[:, :3, 3]
        centers = np.array([body.center for body in bodies])[..., None]
        self._middles = (self._turns[: len(bodies)] @ centers)[..., 0] + self._shifts[: len(bodies)]
        self._radii = np.array([body.radius for body in bodies])

    def are_clear(self, obstacles: Obstacles, first: int = 0) -> bool:
        """Decide whether no body from a first one on is in an obstacle."""
        middles = self._middles[first:, None]
        gaps = np.maximum(np.maximum(obstacles.low - middles, middles - obstacles.high), 0.0)
        near = (gaps**2).sum(axis=2) <= self._radii[first:, None] ** 2
        if (near & ~gaps.any(axis=2)).any():
            return False
        for n, which in np.argwhere(near).tolist():
            body, turn = self._bodies[first + n].mesh, np.ascontiguousarray(self._turns[first + n])
            if obstacles.meshes[which].crosses(body, self._shifts[first + n], turn):
                return False
        return True

    def are_apart(self, pairs: npt.NDArray[np.int64]) -> bool:
        """Decide whether no two of these pairs (n, 2) of numbers cross."""
        one, other = pairs.T
        gaps = self._middles[other] - self._middles[one]
        near = (gaps**2).sum(axis=1) <= (self._radii[one] + self._radii[other]) ** 2
        return not any(self._cross(*pair) for pair in pairs[near].tolist())

    def _cross(self, one: int, other: int) -> bool:
        back = self._turns[one].T
        turn = np.ascontiguousarray(back @ self._turns[other])
        shift = back @ (self._shifts[other] - self._shifts[one])
        return self._bodies[one].mesh.crosses(self._bodies[other].mesh, shift, turn)
