"""Convex pieces: hulls of points, hulls of a surface inside a region, and cuts by a plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull
from trimesh import remesh

from packit_sim.core.caches import cached_property
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.physics.convex.polytope_kernels import clip

SHEET = 1e-4
"""Minimum thickness of a piece: flat and linear ones are thickened to it."""

MAX_CORNERS = 200
"""Largest number of a hull's corners; of more, only the extreme ones in as many directions are
kept, which removes about 1% of a ball. A simulation's time grows with the number of corners."""

_GRAIN = 1 / 64
"""Longest side of a grain of a surface, relative to the surface's extent."""

_HALVINGS = 12
"""Largest number of halvings of a triangle's sides into grains."""

_ROUNDING = 1e-9
"""Distance beyond a plane at which a point counts as on it, relative to about the diagonal."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A convex body with a volume.

    Attributes
    ----------
    vertices : ndarray
        (n, 3) float64, its corners.
    faces : ndarray
        (m, 3) int64, triangles, counter-clockwise seen from outside.
    """

    vertices: Floats
    faces: Ints

    @classmethod
    def around(cls, points: Floats) -> Piece:
        """Compute the convex hull of points (n, 3), n > 0; see `SHEET` and `MAX_CORNERS`."""
        points = _thick(points)
        hull = _hull(points)
        if len(hull.vertices) > MAX_CORNERS:
            hull = _hull(_outermost(points[hull.vertices]))
        kept, faces = np.unique(hull.simplices, return_inverse=True)
        vertices, faces = hull.points[kept], faces.reshape(-1, 3)
        turned = np.einsum("ij,ij->i", _crosses(vertices[faces]), hull.equations[:, :3]) < 0
        faces[turned] = faces[turned][:, ::-1]
        return cls(vertices, faces)

    @cached_property
    def triangles(self) -> Floats:
        """Corners (m, 3, 3) of its faces."""
        return self.vertices[self.faces]

    @cached_property
    def ends(self) -> tuple[Floats, Floats]:
        """The low and the high corner of its bounding box, (3,) each."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    @cached_property
    def planes(self) -> Floats:
        """Planes (k, 4) of the faces: unit normal and offset; normal @ p + offset <= 0 inside."""
        crosses = _crosses(self.triangles)
        lengths = np.linalg.norm(crosses, axis=1)
        real = lengths > 0
        normals = crosses[real] / lengths[real, None]
        offsets = -np.einsum("ij,ij->i", normals, self.triangles[real, 0])
        return np.unique(np.column_stack((normals, offsets)).round(9), axis=0)

    @cached_property
    def volume(self) -> float:
        """Volume, in the cubed unit of the vertices."""
        return MassProperties.of([self]).volume

    def moved(self, linear: Floats, shift: Floats) -> Piece:
        """Return the piece turned and scaled by a (3, 3) matrix, then shifted by (3,)."""
        return Piece(self.vertices @ linear.T + shift, self.faces)

    def cut(self, normal: Floats, offset: float) -> Piece | None:
        """Return the part with normal (3,) @ p + offset <= 0, or None if it is empty."""
        points = clipped(self.triangles, np.array([[*normal, offset]]))
        return Piece.around(points) if len(points) else None


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass properties of pieces of uniform density; overlaps count twice.

    Attributes
    ----------
    volume : float
        Total volume.
    center : ndarray
        (3,) centre of mass.
    moments : ndarray
        (3,) principal moments of inertia for a mass of 1, ascending.
    axes : ndarray
        (3, 3) principal axes as columns, right-handed.
    """

    volume: float
    center: Floats
    moments: Floats
    axes: Floats

    @classmethod
    def of(cls, pieces: Sequence[Piece]) -> MassProperties:
        """Compute the mass properties of pieces.

        Returns
        -------
        MassProperties
            Their mass properties, in the unit of the vertices.

        Notes
        -----
        trimesh rounds moments differently, and settling amplifies differences in the last bit.
        """
        triangles = np.concatenate([piece.triangles for piece in pieces])
        origin = triangles.mean(axis=(0, 1))
        triangles = triangles - origin  # each is a tetrahedron with the origin
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
    """Return corners (n, 3) of the part of a surface, triangles (m, 3, 3), inside a piece."""
    return clipped(triangles[meets(triangles, *piece.ends)], piece.planes)


def meets(triangles: Floats, low: Floats, high: Floats) -> npt.NDArray[np.bool_]:
    """Return bool (m,): whether triangles' (m, 3, 3) bounding boxes meet a box from low to high."""
    found = (triangles.min(axis=1) <= high) & (triangles.max(axis=1) >= low)
    return np.asarray(found.all(axis=1))


def covering(pieces: Sequence[Piece], surface: Floats) -> list[Piece]:
    """Extend pieces until they cover a surface.

    Parameters
    ----------
    surface : ndarray
        Triangles (m, 3, 3). Grains of it (see `_GRAIN`) that are in no piece are added to the
        nearest one.

    Returns
    -------
    list[Piece]
        The pieces in their order, those without additions unchanged.
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
    """Return corners (n, 3) of the parts of triangles (m, 3, 3) behind all planes (k, 4)."""
    points: Floats = clip(np.ascontiguousarray(triangles), planes, _ROUNDING)
    return points


def _hull(points: Floats) -> ConvexHull:
    return ConvexHull(points, qhull_options="Q12")  # allow wide facets of nearly flat hulls


def _crosses(triangles: Floats) -> Floats:
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _thick(points: Floats) -> Floats:
    """Thicken points along each principal axis along which they are flatter than `SHEET`."""
    centered = points - points.mean(axis=0)
    for axis in np.linalg.eigh(centered.T @ centered)[1].T:
        if np.ptp(centered @ axis) < SHEET:
            points = np.concatenate((points + axis * (SHEET / 2), points - axis * (SHEET / 2)))
            centered = points - points.mean(axis=0)
    return points


def _outermost(points: Floats) -> Floats:
    """Return the extreme ones of points (n, 3), in directions that follow their extents."""
    heights = (np.arange(MAX_CORNERS) + 0.5) / MAX_CORNERS * 2 - 1
    angles = np.arange(MAX_CORNERS) * (np.pi * (3 - np.sqrt(5)))  # a spiral over the sphere
    around = np.sqrt(1 - heights**2)
    directions = np.column_stack((around * np.cos(angles), around * np.sin(angles), heights))
    return points[np.unique(np.argmax(points / np.ptp(points, axis=0) @ directions.T, axis=0))]
