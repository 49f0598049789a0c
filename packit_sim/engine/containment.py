"""Containment: whether a part of one surface is inside a closed part of another.

Surfaces that don't cross may still be one inside the other. Fine cells see that only where the
space inside has cells that the outer surface does not touch, so a sheet in a thicker sheet needs
this test. Nothing crosses, so one vertex decides for its whole part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from packit_sim.engine.containment_kernels import any_inside, holds
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.deviation import tree_of
from packit_sim.geometry.parts import Parts

SLACK = 1e-12
"""Box units by which boxes are enlarged: more than rounding, so that they change no answer."""

_NO_TREE = (
    np.empty(0, dtype=np.int64),
    np.empty((0, 2, 3)),
    np.empty(0, dtype=np.int64),
)
"""Part, boxes and starts of no triangles."""


class PartArrays(NamedTuple):
    """The connected parts of a surface around the origin.

    Attributes
    ----------
    points : Floats
        (p, 3) a vertex of each part.
    triangles : Floats
        (m, 3, 3) corners of the closed parts' triangles, in a tree (see `deviation.Surface`).
    part : Ints
        (m,) the number of each of these triangles' part, from 0.
    boxes : Floats
        (2 leaves, 2, 3) boxes of the tree's nodes, enlarged by `SLACK`.
    starts : Ints
        (leaves + 1,) where each leaf's triangles start.
    """

    points: Floats
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
        parts : Parts
            Its parts.

        Returns
        -------
        PartArrays
            Their coordinates.
        """
        points, triangles = vertices[parts.vertices], vertices[parts.closed]
        if len(triangles) == 0:
            return cls(points, triangles, *_NO_TREE)
        part = np.arange(len(parts.starts) - 1).repeat(np.diff(parts.starts))
        order, boxes, starts = tree_of(triangles)
        boxes[1:, 0] -= SLACK
        boxes[1:, 1] += SLACK
        return cls(points, triangles[order], part[order], boxes, starts)


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
        From the centre of the first to that of the other.

    Returns
    -------
    bool
        Whether there is such a part.
    """
    return bool(
        (len(one.part) and holds(other.points, *one[1:], turn, other_turn, shift))
        or (len(other.part) and holds(one.points, *other[1:], other_turn, turn, -shift))
    )


def nested_oracle(
    one: PartArrays, other: PartArrays, turn: Floats, other_turn: Floats, shift: Floats
) -> bool:
    """Compute `nested` by a loop over all parts and all closed parts.

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
        From the centre of the first to that of the other.

    Returns
    -------
    bool
        Whether a part of one is inside a closed part of the other.
    """
    for around, inside, to_frame, moved in (
        (one, other, turn.T @ other_turn, turn.T @ shift),
        (other, one, other_turn.T @ turn, other_turn.T @ -shift),
    ):
        points = inside.points @ to_frame.T + moved
        for number in range(around.part.max(initial=-1) + 1):
            if any_inside(points, around.triangles[around.part == number]):
                return True
    return False
