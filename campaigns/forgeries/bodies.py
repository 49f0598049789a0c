"""Convex bodies in numpy alone: OBJ files, volumes, and what is between two of them.

Nothing here is of PackIt-Sim or trimesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from campaigns.packings import triangles
from campaigns.packings.shapes import Floats, Ints

MOST = 10_000
"""Results that are kept of each function: most trials have the same bodies at the same places."""


@dataclass(frozen=True, eq=False)
class Body:
    """A convex polyhedron at its place."""

    vertices: Floats
    faces: Ints

    @cached_property
    def corners(self) -> Floats:
        """Its triangles (n, 3, 3)."""
        return self.vertices[self.faces]

    @cached_property
    def low(self) -> Floats:
        """The lowest corner of its bounding box."""
        return self.vertices.min(axis=0)

    @cached_property
    def high(self) -> Floats:
        """The highest corner of its bounding box."""
        return self.vertices.max(axis=0)

    @cached_property
    def volume(self) -> float:
        """The volume, from the signed tetrahedra of its triangles."""
        return abs(float(np.linalg.det(self.corners - self.low).sum())) / 6

    @cached_property
    def centre(self) -> Floats:
        """The centre of its volume."""
        moved = self.corners - self.low
        weights = np.linalg.det(moved)
        middles = moved.sum(axis=1) / 4
        return np.asarray(self.low + (weights[:, None] * middles).sum(axis=0) / weights.sum())

    @cached_property
    def edges(self) -> Floats:
        """The directions (n, 3) of its edges, each once."""
        edges = np.vstack([self.corners[:, k] - self.corners[:, k - 1] for k in range(3)])
        return _directions(edges)

    @cached_property
    def normals(self) -> Floats:
        """The normals (n, 3) of its faces, each once."""
        a, b, c = self.corners.transpose(1, 0, 2)
        return _directions(np.cross(b - a, c - a))

    def moved(self, matrix: Floats) -> Body:
        """Return it moved by a matrix (4, 4)."""
        return _moved(self, tuple(matrix.ravel().tolist()))

    @lru_cache(MOST)  # noqa: B019
    def gap(self, other: Body) -> float:
        """Return the largest gap along a separating axis: below 0 if the bodies overlap."""
        cross = np.cross(self.edges[:, None], other.edges[None]).reshape(-1, 3)
        axes = np.vstack([self.normals, other.normals, _directions(cross)])
        own, theirs = self.vertices @ axes.T, other.vertices @ axes.T
        gaps = np.maximum(
            own.min(axis=0) - theirs.max(axis=0), theirs.min(axis=0) - own.max(axis=0)
        )
        return float(gaps.max())

    @lru_cache(MOST)  # noqa: B019
    def gap_on_way(self, other: Body, way: tuple[float, float, float]) -> float:
        """Return the same gap to all that this body passes on a straight way."""
        shift = np.array(way)
        edges = np.vstack([self.edges, shift / np.linalg.norm(shift)])
        cross = np.cross(edges[:, None], other.edges[None]).reshape(-1, 3)
        sides = np.cross(self.edges, shift)
        axes = np.vstack([self.normals, other.normals, _directions(np.vstack([sides, cross]))])
        own = np.vstack([self.vertices, self.vertices + shift]) @ axes.T
        theirs = other.vertices @ axes.T
        gaps = np.maximum(
            own.min(axis=0) - theirs.max(axis=0), theirs.min(axis=0) - own.max(axis=0)
        )
        return float(gaps.max())

    @lru_cache(MOST)  # noqa: B019
    def distance(self, other: Body) -> float:
        """Return the distance; 0 if the bodies overlap."""
        if self.gap(other) <= 0:
            return 0.0
        return triangles.distance(self.corners, other.corners, np.inf)


@lru_cache(MOST)
def _moved(body: Body, matrix: tuple[float, ...]) -> Body:
    rows = np.array(matrix).reshape(4, 4)
    return Body(body.vertices @ rows[:3, :3].T + rows[:3, 3], body.faces)


@lru_cache(MOST)
def read_obj(text: str) -> Body:
    """Read an OBJ file of triangles."""
    rows = [line.split() for line in text.splitlines()]
    vertices = [[float(each) for each in row[1:4]] for row in rows if row[:1] == ["v"]]
    faces = [[int(each) - 1 for each in row[1:4]] for row in rows if row[:1] == ["f"]]
    return Body(np.array(vertices), np.array(faces))


def _directions(vectors: Floats) -> Floats:
    """Return unit vectors, each once, whatever its sign, and none of those of length 0."""
    sizes = np.linalg.norm(vectors, axis=1)
    units = vectors[sizes > 1e-12 * sizes.max(initial=1e-300)]
    units = units / np.linalg.norm(units, axis=1)[:, None]
    first = np.abs(units).argmax(axis=1)
    signs = np.sign(units[np.arange(len(units)), first])
    return np.unique((units * signs[:, None]).round(12), axis=0)
