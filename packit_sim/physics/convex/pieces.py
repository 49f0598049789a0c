"""Convex pieces: hulls of points, hulls of what a surface has in a region, and cuts by a plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull
from trimesh import remesh

from packit_sim.core.caches import cached_property
from packit_sim.physics.convex.polytope_kernels import clip

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

SHEET = 1e-4
"""The least thickness of a piece: what is flat, or a line, is made so thick."""

MOST_CORNERS = 200
"""Corners that a hull may have; of more, those farthest out in so many directions stay, which takes
about 1% off a ball. The time of a simulation grows with them."""

_GRAIN = 1 / 64
"""The longest side of a part of a surface, as a share of the surface's own extent."""

_HALVINGS = 12
"""Of triangles' sides, at most: what is longer than 64 surfaces is none."""

_ROUNDING = 1e-9
"""How far a point may be beyond a plane, in units of about the diagonal, and count as on it."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A convex body with a volume.

    vertices: (n, 3), its corners. faces: (m, 3), triangles that run counter-clockwise when they are
    seen from outside. planes: (k, 4), of unit normals and offsets: a point p is in it where
    normal @ p + offset is 0 or less for all of them.
    """

    vertices: Floats
    faces: Ints

    @classmethod
    def around(cls, points: Floats) -> Piece:
        """The convex hull of points (n, 3), n > 0; see `SHEET` and `MOST_CORNERS`."""
        points = _thick(points)
        hull = _hull(points)
        if len(hull.vertices) > MOST_CORNERS:
            hull = _hull(_outermost(points[hull.vertices]))
        kept, faces = np.unique(hull.simplices, return_inverse=True)
        vertices, faces = hull.points[kept], faces.reshape(-1, 3)
        turned = np.einsum("ij,ij->i", _crosses(vertices[faces]), hull.equations[:, :3]) < 0
        faces[turned] = faces[turned][:, ::-1]
        return cls(vertices, faces)

    @cached_property
    def triangles(self) -> Floats:
        """(m, 3, 3) corners of its faces."""
        return self.vertices[self.faces]

    @cached_property
    def planes(self) -> Floats:
        crosses = _crosses(self.triangles)
        lengths = np.linalg.norm(crosses, axis=1)
        real = lengths > 0
        normals = crosses[real] / lengths[real, None]
        offsets = -np.einsum("ij,ij->i", normals, self.triangles[real, 0])
        return np.unique(np.column_stack((normals, offsets)).round(9), axis=0)

    @cached_property
    def volume(self) -> float:
        return MassProperties.of([self]).volume

    def moved(self, linear: Floats, shift: Floats) -> Piece:
        """The same turned and scaled by a (3, 3) matrix, then shifted by (3,)."""
        return Piece(self.vertices @ linear.T + shift, self.faces)

    def cut(self, normal: Floats, offset: float) -> Piece | None:
        """What is where normal (3,) @ p + offset is 0 or less; None where nothing is."""
        points = clipped(self.triangles, np.array([[*normal, offset]]))
        return Piece.around(points) if len(points) else None


@dataclass(frozen=True, eq=False)
class MassProperties:
    """What pieces are together, filled evenly; where they overlap they count twice.

    center: (3,) of mass. moments: (3,), of inertia about it for a mass of 1, and axes: (3, 3), the
    principal axes that they belong to, as columns; right-handed.
    """

    volume: float
    center: Floats
    moments: Floats
    axes: Floats

    @classmethod
    def of(cls, pieces: Sequence[Piece]) -> MassProperties:
        triangles = np.concatenate([piece.triangles for piece in pieces])
        origin = triangles.mean(axis=(0, 1))
        triangles = triangles - origin  # each makes a tetrahedron with the origin
        volumes = np.linalg.det(triangles) / 6
        total = float(volumes.sum())
        sums = triangles.sum(axis=1)
        first = volumes @ sums / 4 / total
        corners = np.einsum("t,tci,tcj->ij", volumes, triangles, triangles)
        second = (corners + np.einsum("t,ti,tj->ij", volumes, sums, sums)) / 20 / total
        spread = second - np.outer(first, first)
        values, axes = np.linalg.eigh(np.trace(spread) * np.eye(3) - spread)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        return cls(total, origin + first, values, axes)


def within(triangles: Floats, piece: Piece) -> Floats:
    """(n, 3) corners of what of a surface, triangles (m, 3, 3), is in a piece."""
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    return clipped(triangles[meets(triangles, low, high)], piece.planes)


def meets(triangles: Floats, low: Floats, high: Floats) -> npt.NDArray[np.bool_]:
    """Bool (m,): which triangles' (m, 3, 3) bounding boxes meet a box from low to high, (3,)."""
    found = (triangles.min(axis=1) <= high) & (triangles.max(axis=1) >= low)
    return np.asarray(found.all(axis=1))


def covering(pieces: Sequence[Piece], surface: Floats) -> list[Piece]:
    """Pieces that reach at least to a surface, triangles (m, 3, 3).

    What of it is in no piece, in parts of the size `_GRAIN`, is added to the one that is nearest.
    """
    size = float(np.ptp(surface, axis=(0, 1)).max()) * _GRAIN
    vertices, faces = remesh.subdivide_to_size(
        surface.reshape(-1, 3), np.arange(3 * len(surface)).reshape(-1, 3), size, max_iter=_HALVINGS
    )
    least, nearest = np.full(len(faces), np.inf), np.zeros(len(faces), dtype=int)
    missed = np.ones(len(vertices), dtype=bool)
    for n, piece in enumerate(pieces):
        beyond = (vertices @ piece.planes[:, :3].T + piece.planes[:, 3]).max(axis=1)
        missed &= beyond > SHEET
        farthest = beyond[faces].max(axis=1)
        nearest[farthest < least] = n
        least = np.minimum(least, farthest)
    grains = np.flatnonzero(missed[faces].any(axis=1))
    return [
        Piece.around(np.concatenate((piece.vertices, vertices[faces[own]].reshape(-1, 3))))
        if len(own := grains[nearest[grains] == n])
        else piece
        for n, piece in enumerate(pieces)
    ]


def clipped(triangles: Floats, planes: Floats) -> Floats:
    """(n, 3) corners of what of triangles (m, 3, 3) is behind all planes (k, 4)."""
    points: Floats = clip(np.ascontiguousarray(triangles), planes, _ROUNDING)
    return points


def _hull(points: Floats) -> ConvexHull:
    return ConvexHull(points, qhull_options="Q12")  # nearly flat: a wide facet is no error


def _crosses(triangles: Floats) -> Floats:
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _thick(points: Floats) -> Floats:
    """The points, doubled along each principal axis along which they have hardly an extent."""
    centered = points - points.mean(axis=0)
    for axis in np.linalg.eigh(centered.T @ centered)[1].T:
        if np.ptp(centered @ axis) < SHEET:
            points = np.concatenate((points + axis * (SHEET / 2), points - axis * (SHEET / 2)))
            centered = points - points.mean(axis=0)
    return points


def _outermost(points: Floats) -> Floats:
    """Of points (n, 3) those farthest out, in directions spread as their extents are."""
    heights = (np.arange(MOST_CORNERS) + 0.5) / MOST_CORNERS * 2 - 1
    angles = np.arange(MOST_CORNERS) * (np.pi * (3 - np.sqrt(5)))  # a spiral over the sphere
    around = np.sqrt(1 - heights**2)
    directions = np.column_stack((around * np.cos(angles), around * np.sin(angles), heights))
    return points[np.unique(np.argmax(points / np.ptp(points, axis=0) @ directions.T, axis=0))]
