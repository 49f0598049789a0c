"""Solids at their places: what is between two of them, and between one and the walls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import manifold3d
import numpy as np

from campaigns.packings import triangles
from campaigns.packings.shapes import Floats, Ints

TOLERANCE = 1e-4
"""How far parts without a clearance may overlap at most, relative to the box's longest side."""

PART_TOLERANCE = 1e-3
"""The same relative to the longest side of the smaller part: the smaller one of both counts."""

ROUNDING = 2e-6
"""Errors of distances of the whole product, relative to the box's longest side."""


def area(corners: Floats) -> float:
    """Return the area of triangles (n, 3, 3)."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(cross, axis=1).sum() / 2)


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed mesh in millimetres, and how far its file's may deviate by rounding."""

    vertices: Floats
    triangles: Ints
    rounding: float = 0.0

    @cached_property
    def corners(self) -> Floats:
        """Its triangles (n, 3, 3)."""
        return self.vertices[self.triangles]

    @cached_property
    def low(self) -> Floats:
        """The lowest corner of its bounding box."""
        return self.corners.min(axis=(0, 1))

    @cached_property
    def high(self) -> Floats:
        """The highest corner of its bounding box."""
        return self.corners.max(axis=(0, 1))

    @cached_property
    def manifold(self) -> manifold3d.Manifold:
        """It for boolean operations."""
        mesh = manifold3d.Mesh64(self.vertices, self.triangles.astype(np.uint64))
        found = manifold3d.Manifold(mesh)
        assert found.status() == manifold3d.Error.NoError, found.status()
        return found

    def drawn_in(self, width: float) -> Floats:
        """Return its triangles (n, 3, 3), shorter along each axis by a width."""
        middle, extents = (self.low + self.high) / 2, self.high - self.low
        return (self.corners - middle) * (1 - width / extents) + middle

    def depth(self, points: Floats) -> float:
        """Return the largest distance from its surface of the points (n, 3) that are inside it."""
        points = points[((points > self.low) & (points < self.high)).all(axis=1)]
        if not len(points):
            return 0.0
        points = points[np.abs(triangles.winding_numbers(points, self.corners)) > 0.5]
        return self.away(points)

    def away(self, points: Floats) -> float:
        """Return the largest distance of points (n, 3) from its surface."""
        if not len(points):
            return 0.0
        each = np.repeat(points, len(self.corners), axis=0)
        all_corners = np.tile(self.corners, (len(points), 1, 1))
        distances = triangles.point_triangle(each, all_corners)
        return float(distances.reshape(len(points), -1).min(axis=1).max())


@dataclass(frozen=True)
class Rules:
    """The distances that were asked for, and the sides of the box, in millimetres."""

    clearance: float
    wall_clearance: float
    size: tuple[float, float, float]

    def tolerance(self, *bodies: Solid) -> float:
        """Return how far solids without a clearance may overlap along each axis."""
        longest = min(float((body.high - body.low).max()) for body in bodies)
        return min(TOLERANCE * max(self.size), PART_TOLERANCE * longest)

    def slack(self, *bodies: Solid) -> float:
        """Return by how much distances may be wrong by rounding."""
        return ROUNDING * max(self.size) + 2 * sum(body.rounding for body in bodies)

    def depth_in_walls(self, body: Solid) -> float:
        """Return by how much a solid is too close to the walls; 0 if it is not."""
        inside = min(body.low.min(), (np.array(self.size) - body.high).min())
        slack = self.slack(body) + (0 if self.wall_clearance else self.tolerance(body))
        depth = self.wall_clearance - float(inside)
        return depth if depth > slack else 0.0

    def between(self, one: Solid, other: Solid) -> Iterator[str]:
        """Yield what is wrong between two solids."""
        gaps = np.maximum(one.low - other.high, other.low - one.high)
        slack = self.slack(one, other)
        if self.clearance and float(np.linalg.norm(np.maximum(gaps, 0))) < self.clearance:
            distance = triangles.distance(one.corners, other.corners, self.clearance)
            if distance < self.clearance - slack:
                yield f"are {distance:.6g} mm apart, not {self.clearance:.6g}"
        if (gaps >= 0).any():
            return
        if not self.clearance:
            slack += np.sqrt(3) * self.tolerance(one, other)
        middles = one.corners.mean(axis=1), other.corners.mean(axis=1)
        inside = max(other.depth(middles[0]), one.depth(middles[1]))
        inside = max(inside, other.depth(one.vertices), one.depth(other.vertices))
        if inside > slack:
            yield f"are inside each other by {inside:.4g} mm"
        shared = one.manifold ^ other.manifold
        if shared.is_empty():
            return
        corners = np.asarray(shared.to_mesh64().vert_properties)[:, :3]
        depth = max(one.away(corners), other.away(corners))
        for body in shared.decompose():  # a bar through a wall has all corners on both surfaces
            depth = max(depth, 2 * body.volume() / body.surface_area())
        if depth > slack:
            yield f"share {shared.volume():.4g} mm³, {depth:.4g} mm deep"

    def is_below(self, later: Solid, earlier: Solid) -> bool:
        """Return whether a solid can't come straight down because another is above it."""
        width = 2 * self.tolerance(later, earlier) + self.slack(later, earlier)
        rise = triangles.highest_above(later.drawn_in(width), earlier.drawn_in(width))
        return rise > width
