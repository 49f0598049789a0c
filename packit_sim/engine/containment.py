"""Containment: whether a part of one surface is inside a closed part of another.

Surfaces that don't cross may still be one inside the other. Fine cells see that only where the
space inside has cells that the outer surface does not touch, so a sheet in a thicker sheet needs
this test. Nothing crosses, so one vertex decides for its whole part.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from packit_sim.engine.containment_kernels import any_inside, holds
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.parts import Parts
from packit_sim.geometry.triangle_trees import boxes_of

SLACK = 1e-12
"""Box units by which boxes are enlarged: more than rounding, so that they change no answer."""

_NO_TREE = (
    np.empty(0, dtype=np.int64),
    np.array([np.full((2, 3), np.nan)] * 2),
    np.empty(0, dtype=np.int64),
)
"""Part, boxes and starts of no triangles: no point is in these boxes."""


class PartArrays(NamedTuple):
    """The connected parts of a surface around the origin.

    Attributes
    ----------
    points : Floats
        (p, 3) a vertex of each part.
    extents : Floats
        (p, 2, 3) the lowest and the highest corner of each part's box.
    triangles : Floats
        (m, 3, 3) corners of the closed parts' triangles, in a tree (see `triangle_trees`).
    part : Ints
        (m,) the number of each of these triangles' part, from 0.
    boxes : Floats
        (2 leaves, 2, 3) boxes of the tree's nodes, enlarged by `SLACK`.
    starts : Ints
        (leaves + 1,) where each leaf's triangles start.
    """

    points: Floats
    extents: Floats
    triangles: Floats
    part: Ints
    boxes: Floats
    starts: Ints

    @classmethod
    def of(cls, vertices: Floats, parts: Parts) -> PartArrays:
        """Look up the coordinates of parts.

        Parameters
        ----------
        vertices : ndarray of float64, shape (n, 3)
            The vertices of the surface.

        Returns
        -------
        PartArrays
            Their coordinates.
        """
        points, triangles = vertices[parts.vertices], vertices[parts.closed]
        extents = vertices[parts.extremes, np.arange(3)]
        if len(triangles) == 0:
            return cls(points, extents, triangles, *_NO_TREE)
        part = np.arange(len(parts.starts) - 1).repeat(np.diff(parts.starts))[parts.order]
        triangles = triangles[parts.order]
        boxes, starts = boxes_of(triangles)
        boxes[1:, 0] -= SLACK
        boxes[1:, 1] += SLACK
        return cls(points, extents, triangles, part, boxes, starts)

    def outline(self, turn: Floats) -> Floats:
        """Compute a bound that quickly proves that nothing is inside (see `points_within`).

        Parameters
        ----------
        turn : ndarray of float64, shape (3, 3)
            One of the 24 rotations.

        Returns
        -------
        Floats
            (1 + p, 2, 3) the lowest and the highest corner of the box of all closed parts, NaN if
            there are none, and of each part's box; all rotated.
        """
        corners = np.concatenate((self.boxes[1:2], self.extents)) @ turn.T
        return np.stack((corners.min(axis=1), corners.max(axis=1)), axis=1)


def nested(
    one: PartArrays, other: PartArrays, turn: Floats, other_turn: Floats, shift: Floats
) -> bool:
    """Decide whether a part of one of two surfaces is inside a closed part of the other.

    Parameters
    ----------
    one : PartArrays
        A surface.
    other : PartArrays
        Another surface; they don't cross.
    turn : ndarray of float64, shape (3, 3)
        The rotation of the first.
    other_turn : ndarray of float64, shape (3, 3)
        The rotation of the other.
    shift : ndarray of float64, shape (3,)
        The vector from the centre of the first to that of the other.

    Returns
    -------
    bool
        Whether there is such a part.
    """
    return bool(
        holds(other.points, *one[2:], turn, other_turn, shift)
        or holds(one.points, *other[2:], other_turn, turn, -shift)
    )


class ClosedPart(NamedTuple):
    """A closed part of a surface around the origin.

    Attributes
    ----------
    triangles : Floats
        (m, 3, 3) corners of its triangles.
    low, high : Floats
        (3,) the corners of its bounding box.
    """

    triangles: Floats
    low: Floats
    high: Floats

    @classmethod
    def all_of(cls, parts: PartArrays) -> list[ClosedPart]:
        """Look up the closed parts among parts."""
        numbers = range(parts.part.max(initial=-1) + 1)
        each = (parts.triangles[parts.part == number] for number in numbers)
        return [cls(part, part.min(axis=(0, 1)), part.max(axis=(0, 1))) for part in each]


def nested_oracle(
    points: Floats, closed: Sequence[ClosedPart], turn: Floats, points_turn: Floats, shift: Floats
) -> bool:
    """Decide whether a point is inside a closed part, by a loop over all points and parts.

    Parameters
    ----------
    points : ndarray of float64, shape (p, 3)
        A vertex of each part of a surface.
    closed : Sequence[ClosedPart]
        The closed parts of another surface; they don't cross.
    turn : ndarray of float64, shape (3, 3)
        The rotation of the closed parts.
    points_turn : ndarray of float64, shape (3, 3)
        The rotation of the points.
    shift : ndarray of float64, shape (3,)
        The vector from the centre of the closed parts to that of the points.

    Returns
    -------
    bool
        Whether there is such a point. One outside a part's bounding box is not inside the part.
    """
    moved = points @ (turn.T @ points_turn).T + turn.T @ shift
    return any(
        any_inside(moved[((low <= moved) & (moved <= high)).all(axis=1)], part)
        for part, low, high in closed
    )
