"""The largest scale at which a body fits into a convex space, over its rotations and places.

For one rotation this is a linear program: each wall bounds the scaled body's farthest corner. Over
rotations, the program with small turns as further variables leads to a local optimum: sequential
linear programming in a trust region, from many rotations to begin with.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from packit_sim.geometry.arrays import Floats
from packit_sim.parts.packings.containers import BoxContainer, Container
from packit_sim.parts.packings.cylinders import CORNERS as SECTIONS
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.mesh_containers import MeshContainer

CORNERS = 8
"""Corners of the body that bound a small turn at each wall: the farthest ones."""

REFINED = 12
"""Rotations from which the best are found, of all to begin with."""

CONVEX = 1e-6
"""How much smaller than its convex hull a container may be, and still count as convex."""

STEPS = 60
"""Most steps from each."""

_TRUST = 0.3, 1e-7
"""Largest turn of a step in radians, at first and at last."""


@dataclass(frozen=True)
class Fitted:
    """A body at its largest scale.

    Attributes
    ----------
    scale : float
        The scale.
    rotation : ndarray of float64, shape (3, 3)
        The rotation of the body.
    place : ndarray of float64, shape (3,)
        Where its origin is then.
    """

    scale: float
    rotation: Floats
    place: Floats


class ConvexSpace:
    """A convex space, by its walls.

    Parameters
    ----------
    normals : ndarray of float64, shape (n, 3)
        The unit normals of the walls, outwards.
    distances : ndarray of float64, shape (n,)
        The distances of the walls from the origin along them.
    """

    def __init__(self, normals: Floats, distances: Floats) -> None:
        self.normals, self.distances = normals, distances

    def largest(self, corners: Floats, rotation: Floats) -> Fitted:
        """Return the largest scale of a body's corners (n, 3) in a rotation (3, 3)."""
        reach = (corners @ rotation.T @ self.normals.T).max(axis=0)
        table = np.column_stack((reach, self.normals))
        found = linprog((-1, 0, 0, 0), table, self.distances, bounds=_BOUNDS)
        scale = float(found.x[0]) if found.status == 0 else 0.0
        return Fitted(scale, rotation, found.x[1:] if found.status == 0 else np.zeros(3))

    def best(
        self, corners: Floats, rotations: Iterable[Floats], is_over: Callable[[], bool]
    ) -> Fitted:
        """Return the largest scale of a body in any rotation.

        Parameters
        ----------
        corners : ndarray of float64, shape (n, 3)
            The corners of its convex hull.
        rotations : iterable of ndarray of float64, shape (3, 3)
            The rotations to begin with.
        is_over : callable
            Whether to end before all are tried.

        Returns
        -------
        Fitted
            The largest that was found.
        """
        tried = []
        for rotation in rotations:
            tried.append(self.largest(corners, rotation))
            if is_over():
                break
        tried.sort(key=lambda each: -each.scale)
        best = tried[0]
        for each in tried[:REFINED]:
            if is_over():
                break
            found = self.refined(corners, each, is_over)
            best = found if found.scale > best.scale else best
        return best

    def refined(
        self, corners: Floats, best: Fitted, is_over: Callable[[], bool] = lambda: False
    ) -> Fitted:
        """Turn a body by small steps as long as its scale grows."""
        trust = _TRUST[0]
        for _ in range(STEPS):
            if trust < _TRUST[1] or is_over():
                break
            turn = self._turn(corners, best, trust)
            found = self.largest(corners, turn @ best.rotation)
            if found.scale > best.scale * (1 + 1e-9):
                best, trust = found, 2 * trust
            else:
                trust /= 4
        return best

    def _turn(self, corners: Floats, now: Fitted, trust: float) -> Floats:
        """Return the turn (3, 3), small along each axis, that promises the largest scale."""
        turned = corners @ now.rotation.T
        reach = turned @ self.normals.T
        count = min(CORNERS, len(corners))
        far = np.argpartition(-reach, count - 1, axis=0)[:count]  # (count, walls)
        points = turned[far]
        walls = np.broadcast_to(self.normals, points.shape)
        table = np.concatenate(
            ((points * walls).sum(axis=2)[..., None], walls, np.cross(points, walls)), axis=2
        ).reshape(-1, 7)
        most = trust * max(now.scale, 1e-30)
        found = linprog(
            (-1, 0, 0, 0, 0, 0, 0),
            table,
            np.tile(self.distances, count),
            bounds=[*_BOUNDS, *3 * [(-most, most)]],
        )
        if found.status != 0:
            return np.eye(3)
        return np.asarray(Rotation.from_rotvec(found.x[4:] / max(now.scale, 1e-30)).as_matrix())


_BOUNDS = [(0, None), (None, None), (None, None), (None, None)]
"""Bounds of a scale, which is not negative, and of a place."""


def convex_space(
    container: Container, walls: WallClearance, is_hull: bool = False
) -> ConvexSpace | None:
    """Return the space inside the walls of a container, or of its convex hull.

    Parameters
    ----------
    is_hull : bool
        Whether to take the hull of a container that is not convex.

    Returns
    -------
    ConvexSpace or None
        The space; None if the container is not convex.
    """
    if isinstance(container, BoxContainer):
        normals = np.concatenate((-np.eye(3), np.eye(3)))
        return ConvexSpace(normals, np.concatenate((-walls.lower, container.size - walls.upper)))
    if isinstance(container, CylinderContainer):
        radius = container.diameter / 2
        angles = 2 * math.pi * np.arange(SECTIONS) / SECTIONS
        across = np.column_stack((np.cos(angles), np.sin(angles), np.zeros(SECTIONS)))
        inner = (radius - walls.sides) * math.cos(math.pi / SECTIONS)  # of a polygon inside
        normals = np.concatenate((across, ((0, 0, -1), (0, 0, 1))))
        ends = (-walls.floor, container.height - walls.top)
        return ConvexSpace(normals, np.concatenate((across @ (radius, radius, 0) + inner, ends)))
    assert isinstance(container, MeshContainer)
    vertices = container.mesh.vertices - container.mesh.low
    hull = ConvexHull(vertices)
    if container.volume < hull.volume * (1 - CONVEX) and not is_hull:
        return None
    planes = np.unique(hull.equations.round(12), axis=0)
    return ConvexSpace(planes[:, :3], -planes[:, 3] - walls.largest)


def corners_of(vertices: Floats) -> Floats:
    """Return the corners (n, 3) of the convex hull of vertices."""
    return np.asarray(vertices[ConvexHull(vertices, qhull_options="QJ").vertices])
