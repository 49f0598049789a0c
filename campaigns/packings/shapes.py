"""Meshes by formulas: extruded polygons, and polylines that turn about an axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Shape:
    """A polyhedron in millimetres.

    Attributes
    ----------
    vertices : ndarray of float64, shape (n, 3)
        The corners.
    polygons : tuple of tuple of int
        The planar faces, anticlockwise from outside; those that are not convex are triangulated by
        `triangles` alone.
    triangles : ndarray of int64, shape (m, 3)
        The same faces in triangles.
    missing : int
        How many triangles, the last ones, its file lacks.
    inverted : bool
        Whether its file has all faces clockwise.
    """

    vertices: Floats
    polygons: tuple[tuple[int, ...], ...]
    triangles: Ints
    missing: int = 0
    inverted: bool = False

    @property
    def volume(self) -> float:
        """The volume, from the signed tetrahedra of its triangles."""
        corners = self.vertices[self.triangles] - self.vertices.mean(axis=0)
        return float(np.linalg.det(corners).sum() / 6)

    def moved(self, motion: Floats) -> Shape:
        """Return it moved by a matrix (4, 4)."""
        return replace(self, vertices=self.vertices @ motion[:3, :3].T + motion[:3, 3])


def polygon(sides: int, rx: float, ry: float, turn: float = 0.0) -> Floats:
    """Return the corners (sides, 2) of a polygon on an ellipse."""
    angles = turn + np.arange(sides) * 2 * np.pi / sides
    return np.stack([rx * np.cos(angles), ry * np.sin(angles)], axis=1)


def extruded(outline: npt.ArrayLike, height: float) -> Shape:
    """Return a prism over a simple polygon that is given anticlockwise."""
    flat = np.asarray(outline, float)
    n = len(flat)
    vertices = np.vstack([np.c_[flat, np.zeros(n)], np.c_[flat, np.full(n, height)]])
    sides = [(k, (k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)]
    caps = ears(flat)
    triangles = [(a, c, b) for a, b, c in caps] + [(n + a, n + b, n + c) for a, b, c in caps]
    for a, b, c, d in sides:
        triangles += [(a, b, c), (a, c, d)]
    polygons = (tuple(range(n))[::-1], tuple(range(n, 2 * n)), *sides)
    return Shape(vertices, polygons, np.array(triangles, dtype=np.int64))


def ears(flat: Floats) -> list[tuple[int, int, int]]:
    """Triangulate a simple polygon (n, 2), anticlockwise, by cutting off its ears."""
    left, found = list(range(len(flat))), []
    while len(left) > 3:
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            others = flat[[n for n in left if n not in (a, b, c)]]
            corners = flat[[a, b, c]]
            areas = [_turn(corners[i], corners[(i + 1) % 3], others) for i in range(3)]
            if _turn(*corners) > 1e-9 and not (np.min(areas, axis=0) >= -1e-9).any():
                found.append((a, b, c))
                del left[k]
                break
        else:
            raise AssertionError("the polygon is not simple")
    return [*found, (left[0], left[1], left[2])]


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return twice the signed area of triangles in the plane; `c` may be several points."""
    ab, ac = b - a, c - a
    area: Floats = ab[0] * ac[..., 1] - ab[1] * ac[..., 0]
    return area


def turned(profile: Sequence[tuple[float, float]], steps: int, closed: bool) -> Shape:
    """Return what a polyline of points (radius, height) encloses as it turns about z.

    Parameters
    ----------
    profile : sequence of (float, float)
        The polyline, with the solid on its left; it starts and ends on the axis unless `closed`.
    steps : int
        The number of sides.
    closed : bool
        Whether the polyline is a loop off the axis.

    Returns
    -------
    Shape
        The solid.
    """
    rings: list[list[int]] = []
    points: list[tuple[float, float, float]] = []
    for radius, height in profile:
        angles = np.arange(steps if radius else 1) * 2 * np.pi / steps
        rings.append(list(range(len(points), len(points) + len(angles))))
        points += [(radius * np.cos(t), radius * np.sin(t), height) for t in angles]
    polygons: list[tuple[int, ...]] = []
    following = [*rings[1:], rings[0]] if closed else rings[1:]
    for one, other in zip(rings, following, strict=False):
        for k in range(steps):
            after = (k + 1) % steps
            if len(one) == len(other) == 1:
                continue
            if len(one) == 1:
                polygons.append((one[0], other[after], other[k]))
            elif len(other) == 1:
                polygons.append((one[k], one[after], other[0]))
            else:
                polygons.append((one[k], one[after], other[after], other[k]))
    triangles = [(p[0], p[n], p[n + 1]) for p in polygons for n in range(1, len(p) - 1)]
    return Shape(np.array(points), tuple(polygons), np.array(triangles, dtype=np.int64))


def box(sides: Sequence[float]) -> Shape:
    """Return a block with a corner at the origin."""
    x, y, z = sides
    return extruded([(0, 0), (x, 0), (x, y), (0, y)], z)


def bracket(x: float, y: float, z: float, wall: float) -> Shape:
    """Return an L of a constant wall."""
    return extruded([(0, 0), (x, 0), (x, wall), (wall, wall), (wall, y), (0, y)], z)


def channel(x: float, y: float, z: float, wall: float) -> Shape:
    """Return a U of a constant wall."""
    inner = [(x - wall, y), (x - wall, wall), (wall, wall), (wall, y)]
    return extruded([(0, 0), (x, 0), (x, y), *inner, (0, y)], z)


def tube(outer: float, inner: float, height: float, steps: int) -> Shape:
    """Return a tube that is open at both ends."""
    profile = [(outer, 0.0), (outer, height), (inner, height), (inner, 0.0)]
    return turned(profile, steps, closed=True)


def cup(outer: float, inner: float, height: float, floor: float, steps: int) -> Shape:
    """Return a cup that is open at the top."""
    profile = [(0, 0), (outer, 0), (outer, height), (inner, height), (inner, floor), (0, floor)]
    return turned(profile, steps, closed=False)


def ball(radius: float, steps: int) -> Shape:
    """Return a sphere of few quadrangles."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, steps // 2 + 1)
    inner = [(radius * np.cos(t), radius * np.sin(t)) for t in angles[1:-1]]
    return turned([(0.0, -radius), *inner, (0.0, radius)], steps, closed=False)


def united(shapes: Sequence[Shape]) -> Shape:
    """Return several bodies, which must be apart, as one shape."""
    starts = np.cumsum([0, *(len(one.vertices) for one in shapes)])
    polygons = [
        tuple(int(start + k) for k in face)
        for one, start in zip(shapes, starts, strict=False)
        for face in one.polygons
    ]
    triangles = [one.triangles + start for one, start in zip(shapes, starts, strict=False)]
    return Shape(np.vstack([one.vertices for one in shapes]), tuple(polygons), np.vstack(triangles))


def pierced(shape: Shape, number: int, size: float) -> Shape:
    """Return a shape whose file lacks a small triangle of this size within one of its faces."""
    a, b, c = corners = shape.triangles[number]
    middle = shape.vertices[corners].mean(axis=0)
    spokes = shape.vertices[corners] - middle
    spokes *= size / np.linalg.norm(spokes, axis=1).max()
    n = len(shape.vertices)
    p, q, r = n, n + 1, n + 2
    ring = [(a, b, q), (a, q, p), (b, c, r), (b, r, q), (c, a, p), (c, p, r), (p, q, r)]
    triangles = np.vstack([np.delete(shape.triangles, number, axis=0), ring])
    vertices = np.vstack([shape.vertices, middle + spokes])
    polygons = tuple(tuple(int(k) for k in face) for face in triangles)
    return Shape(vertices, polygons, triangles.astype(np.int64), missing=1)
