"""How far two surfaces are apart at most: a bound of their Hausdorff distance, not an estimate.

The distance from a convex set is a convex function: no point of a piece of one surface is farther
from a triangle of the other than the farthest of its corners is. Pieces are cut until the best
triangle for each says enough: branch and bound, as by Tang, Lee and Kim ("Interactive Hausdorff
distance computation for general polygonal models", 2009).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.spatial import cKDTree

from packit_sim.core.compilation import kernel
from packit_sim.core.errors import MeshError

RELATIVE_SLACK = 0.02
"""How much more than the distance its bound may be, as a share of it."""

SLACK = 1e-5
"""How much more it may be beside that, as a share of the larger bounding box's diagonal: a tenth of
the contact tolerance for an item as long as the box."""

_PER_LEAF = 4
"""Triangles in a leaf of a tree, at most."""

_CUTS_TO_FIT = 64
"""Of a triangle, one inside the other: beyond these, pieces are only halved."""

_HALVED = 4
"""Before that, every so many cuts."""

_SLIVER = 1e-3
"""Share of an edge below which a part is not cut off."""

_BISECTIONS = 40
"""To find where an edge leaves the neighbourhood of a triangle."""

_STACK = 512
"""Pieces that wait, at most one for each cut: halving makes any piece as small as the slack in far
fewer."""


def deviation(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """A bound of the Hausdorff distance of two surfaces: no point of either is farther from the
    other, in their unit of length.

    It is more than that distance by at most `RELATIVE_SLACK` of it and `SLACK` of the larger
    diagonal. Both hold but for the rounding of 64-bit arithmetic, for any triangles: open surfaces,
    crossing ones, triangles without area. Raises MeshError where a mesh has no triangles, or
    vertices that are not finite.
    """
    one, other = sorted((Surface.of(a), Surface.of(b)), key=lambda surface: -len(surface.triangles))
    slack = SLACK * max(one.diagonal, other.diagonal)
    low = _farthest(one.triangles.reshape(-1, 3), other, 0.0)
    low = _farthest(other.triangles.reshape(-1, 3), one, low)
    low, high = _bound(one.triangles, other, low, low, slack)
    low, high = _bound(other.triangles, one, low, high, slack)
    return float(high)


class Surface(NamedTuple):
    """Triangles in a complete binary tree of boxes; the children of node n are 2 n and 2 n + 1.

    triangles: (n, 3, 3), those of a leaf together. boxes: (2 leaves, 2, 3), lowest and highest
    corners, from the root at 1 to the leaves at the end. starts: (leaves + 1,), where each leaf's
    triangles start.
    """

    triangles: npt.NDArray[np.float64]
    boxes: npt.NDArray[np.float64]
    starts: npt.NDArray[np.int64]

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> Surface:
        """Raises MeshError where there are no triangles, or vertices that are not finite."""
        triangles = np.array(mesh.triangles, dtype=np.float64)
        if len(triangles) == 0:
            raise MeshError("a mesh without triangles is at no distance from anything")
        if not np.isfinite(triangles).all():
            raise MeshError("a mesh whose vertices are not finite is at no distance from anything")
        tree = cKDTree(triangles.mean(axis=1), leafsize=_PER_LEAF)  # halves it, and so on
        triangles = triangles[tree.indices]
        leaves = 1
        while leaves * _PER_LEAF < len(triangles):
            leaves *= 2
        starts = np.arange(leaves + 1) * len(triangles) // leaves
        boxes = np.empty((2 * leaves, 2, 3))
        boxes[leaves:, 0] = np.minimum.reduceat(triangles.min(axis=1), starts[:-1])
        boxes[leaves:, 1] = np.maximum.reduceat(triangles.max(axis=1), starts[:-1])
        while leaves > 1:
            children = boxes[leaves : 2 * leaves]
            leaves //= 2
            boxes[leaves : 2 * leaves, 0] = np.minimum(children[::2, 0], children[1::2, 0])
            boxes[leaves : 2 * leaves, 1] = np.maximum(children[::2, 1], children[1::2, 1])
        return cls(triangles, boxes, starts)

    @property
    def diagonal(self) -> float:
        """Of the bounding box."""
        return float(np.linalg.norm(self.boxes[1, 1] - self.boxes[1, 0]))


@kernel
def distances(points, surface, most):
    """(n,) distances of points (n, 3) from a surface, or `most` where they are more."""
    found = np.empty(len(points))
    best = 0
    for n in range(len(points)):
        found[n], best = _nearest(points[n : n + 1], surface, best, 0.0, most)
    return found


@kernel
def _farthest(points, surface, low):
    """The largest distance of points (n, 3) from a surface, or `low` where that is more."""
    best = 0
    for n in range(len(points)):
        distance, best = _nearest(points[n : n + 1], surface, best, low, np.inf)
        low = max(low, distance)
    return low


@kernel
def _bound(triangles, surface, low, high, slack):
    """The largest distance found, and a bound of it, for all points of triangles (n, 3, 3).

    low, high: what they are already; all corners are within `low`.
    """
    pieces = np.empty((_STACK, 3, 3))
    cuts = np.empty(_STACK, np.int64)
    cut = np.empty((1, 3))
    best = 0
    for n in range(len(triangles)):
        pieces[0], cuts[0] = triangles[n], 0
        top = 1
        while top:
            top -= 1
            piece, made = pieces[top], cuts[top] + 1
            distance, best = _nearest(piece, surface, best, high, np.inf)
            if distance <= high:
                continue
            if distance <= low * (1 + RELATIVE_SLACK) + slack or top + 2 > _STACK:
                high = distance
                continue
            start, end = _cut(piece, surface.triangles[best], high, made, cut[0])
            low = max(low, _nearest(cut, surface, best, low, np.inf)[0])
            high = max(high, low)
            pieces[top + 1] = piece
            pieces[top, end] = cut[0]
            pieces[top + 1, start] = cut[0]
            cuts[top] = cuts[top + 1] = made
            top += 2
    return low, high


@kernel
def _cut(piece, triangle, high, made, cut):
    """Where to cut a piece: the edge from which corner to which, and the point, put into `cut`.

    Where the edge leaves what is near the triangle, so that of surfaces that agree only their
    overlay is left, or else at the middle of the longest edge.
    """
    start = end = 0
    least, most = np.inf, -1.0
    for i in range(3):
        distance = np.sqrt(_from_triangle(piece[i], triangle))
        if distance < least:
            start, least = i, distance
        if distance > most:
            end, most = i, distance
    if least <= high and made % _HALVED and made < _CUTS_TO_FIT:
        near, far = 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = (near + far) / 2
            for axis in range(3):
                cut[axis] = piece[start, axis] + middle * (piece[end, axis] - piece[start, axis])
            if np.sqrt(_from_triangle(cut, triangle)) <= high:
                near = middle
            else:
                far = middle
        if _SLIVER < near < 1 - _SLIVER:
            return start, end
    longest = -1.0
    for i in range(3):
        length = 0.0
        for axis in range(3):
            length += (piece[i, axis] - piece[i - 1, axis]) ** 2
        if length > longest:
            start, end, longest = i, i - 1, length
    for axis in range(3):
        cut[axis] = (piece[start, axis] + piece[end, axis]) / 2
    return start, end


@kernel
def _nearest(points, surface, guess, enough, most):
    """The triangle from which the farthest of points (n, 3) is least far: how far, and its number.

    Or any triangle for which that is near enough; `guess` is asked first. Where it is more than
    `most` for all, that, and a triangle that means nothing.
    """
    enough = enough * enough
    best, least = guess, min(_farthest_corner(points, surface.triangles[guess]), most * most)
    leaves = len(surface.starts) - 1
    stack = np.empty(64, np.int64)
    bounds = np.empty(64)
    stack[0], bounds[0] = 1, 0.0
    top = 1
    while top and least > enough:
        top -= 1
        node = stack[top]
        if bounds[top] >= least:
            continue
        if node >= leaves:
            for n in range(surface.starts[node - leaves], surface.starts[node - leaves + 1]):
                distance = _farthest_corner(points, surface.triangles[n])
                if distance < least:
                    best, least = n, distance
            continue
        near, far = 2 * node, 2 * node + 1
        to_near, to_far = (
            _from_box(points, surface.boxes[near]),
            _from_box(points, surface.boxes[far]),
        )
        if to_far < to_near:
            near, far, to_near, to_far = far, near, to_far, to_near
        stack[top], bounds[top] = far, to_far
        stack[top + 1], bounds[top + 1] = near, to_near
        top += 2
    return np.sqrt(least), best


@kernel
def _farthest_corner(points, triangle):
    """Squared, the distance from a triangle (3, 3) of the farthest of points (n, 3)."""
    most = 0.0
    for n in range(len(points)):
        most = max(most, _from_triangle(points[n], triangle))
    return most


@kernel
def _from_box(points, box):
    """Squared, the distance from a box (2, 3) of the farthest of points (n, 3)."""
    most = 0.0
    for n in range(len(points)):
        total = 0.0
        for axis in range(3):
            at = points[n, axis]
            total += max(box[0, axis] - at, at - box[1, axis], 0.0) ** 2
        most = max(most, total)
    return most


@kernel
def _from_triangle(point, triangle):
    """Squared, the distance of a point (3,) from a triangle (3, 3), which may have no area.

    It is that of a point of the triangle, so rounding does not make it too small.
    """
    least = np.inf
    for i in range(3):
        least = min(least, _from_segment(point, triangle[i], triangle[i - 1]))
    uu = uv = vv = up = vp = 0.0
    for axis in range(3):
        u = triangle[1, axis] - triangle[0, axis]
        v = triangle[2, axis] - triangle[0, axis]
        p = point[axis] - triangle[0, axis]
        uu += u * u
        uv += u * v
        vv += v * v
        up += u * p
        vp += v * p
    area = uu * vv - uv * uv
    along_u, along_v = vv * up - uv * vp, uu * vp - uv * up
    if along_u > 0 and along_v > 0 and along_u + along_v < area:
        total = 0.0
        for axis in range(3):
            u = triangle[1, axis] - triangle[0, axis]
            v = triangle[2, axis] - triangle[0, axis]
            foot = triangle[0, axis] + (along_u * u + along_v * v) / area
            total += (point[axis] - foot) ** 2
        least = min(least, total)
    return least


@kernel
def _from_segment(point, start, end):
    """Squared, the distance of a point (3,) from the segment between two."""
    along = length = 0.0
    for axis in range(3):
        side = end[axis] - start[axis]
        along += (point[axis] - start[axis]) * side
        length += side * side
    share = min(max(along / length, 0.0), 1.0) if length > 0 else 0.0
    total = 0.0
    for axis in range(3):
        total += (point[axis] - start[axis] - share * (end[axis] - start[axis])) ** 2
    return total
