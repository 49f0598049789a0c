"""The distance that a moving arm keeps from boxes around it, and from itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
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

    def is_clear(self, body: PaddedBody, pose: Motion) -> bool:
        """Decide whether a body at a pose is in none of them."""
        middle = pose.apply(body.center)
        gaps = np.maximum(np.maximum(self.low - middle, middle - self.high), 0.0)
        near = np.flatnonzero((gaps**2).sum(axis=1) <= body.radius**2)
        turn = np.ascontiguousarray(pose.rotation)
        for n in near.tolist():
            if not gaps[n].any() or self.meshes[n].crosses(body.mesh, pose.translation, turn):
                return False
        return True


def are_apart(one: PaddedBody, pose: Motion, other: PaddedBody, other_pose: Motion) -> bool:
    """Decide whether two bodies at poses do not cross."""
    gap = other_pose.apply(other.center) - pose.apply(one.center)
    if gap @ gap > (one.radius + other.radius) ** 2:
        return True
    between = other_pose.seen_from(pose)
    turn = np.ascontiguousarray(between.rotation)
    return not one.mesh.crosses(other.mesh, between.translation, turn)
