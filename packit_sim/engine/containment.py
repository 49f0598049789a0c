"""Containment: whether a part of one surface is inside a closed part of another.

Surfaces that don't cross may still be one inside the other. Fine cells see that only where the
space inside has cells that the outer surface does not touch, so a sheet in a thicker sheet needs
this test. Nothing crosses, so one vertex decides for its whole part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from packit_sim.engine.containment_kernels import any_inside
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.parts import Parts


class PartArrays(NamedTuple):
    """The connected parts of a surface around the origin.

    Attributes
    ----------
    points : Floats
        (p, 3) a vertex of each part.
    boxes : Floats
        (q + 1, 2, 3) lowest and highest corner of all closed parts together, then of each.
    triangles : Floats
        (m, 3, 3) corners of the closed parts' triangles, those of a part next to each other.
    starts : Ints
        (q + 1,) where the triangles of each closed part start.
    """

    points: Floats
    boxes: Floats
    triangles: Floats
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
        triangles = vertices[parts.closed]
        shells = [vertices[shell] for shell in parts.shells]
        boxes = [
            (corners.min(axis=(0, 1)), corners.max(axis=(0, 1)))
            for corners in ([triangles, *shells] if shells else [])
        ]
        return cls(
            vertices[parts.vertices], np.array(boxes).reshape(-1, 2, 3), triangles, parts.starts
        )


def nested_oracle(
    one: PartArrays, other: PartArrays, turn: Floats, other_turn: Floats, shift: Floats
) -> bool:
    """Compute `containment_kernels.nested` by a loop over all parts and all closed parts.

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
        if any_inside(inside.points @ to_frame.T + moved, around.triangles, around.starts):
            return True
    return False
