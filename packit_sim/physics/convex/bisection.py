"""Convex decomposition by bisection, which never fails: boxes are halved until hulls are tight."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.shapes import Shape
from packit_sim.physics.convex.pieces import Piece, clipped
from packit_sim.physics.convex.solids import Solid


@dataclass(order=True)
class _Part:
    """The part of a surface between two corners, sorted by its hull's distance, largest first.

    priority: minus the hull's distance (see `Solid.hausdorff`). number: order of creation. low,
    high: (3,).
    """

    priority: float
    number: int
    low: Floats = field(compare=False)
    high: Floats = field(compare=False)
    piece: Piece = field(compare=False)


def bisect(shape: Shape, solid: Solid, max_distance: float, max_pieces: int) -> list[Piece]:
    """Decompose a shape into the hulls of its surface in boxes.

    Parameters
    ----------
    solid : Solid
        Its voxels.
    max_distance : float
        Boxes are halved while a hull's one-sided Hausdorff distance from the shape is larger, in
        canonical units. The worst is halved next, across its longest side.
    max_pieces : int
        Number of pieces at which the halving ends.

    Returns
    -------
    list[Piece]
        The hulls, in the order of creation.
    """
    triangles = np.asarray(shape.mesh.triangles)
    count = 0

    def parts(low: Floats, high: Floats) -> list[_Part]:
        nonlocal count
        points = clipped(triangles, _sides(low, high))
        if not len(points):
            return []
        count += 1
        piece = Piece.around(points)
        return [
            _Part(-solid.hausdorff(piece), count, points.min(axis=0), points.max(axis=0), piece)
        ]

    heap = parts(*np.asarray(shape.mesh.bounds))
    while -heap[0].priority > max_distance and len(heap) < max_pieces:
        worst = heapq.heappop(heap)
        axis = int(np.argmax(worst.high - worst.low))
        middle = (worst.low[axis] + worst.high[axis]) / 2
        for end in (worst.low, worst.high):
            low, high = worst.low.copy(), worst.high.copy()
            (high if end is worst.low else low)[axis] = middle
            for part in parts(low, high):
                heapq.heappush(heap, part)
    return [part.piece for part in sorted(heap, key=lambda part: part.number)]


def _sides(low: Floats, high: Floats) -> Floats:
    """Return the planes (6, 4) of a box."""
    normals = np.concatenate((-np.eye(3), np.eye(3)))
    return np.column_stack((normals, np.concatenate((low, -high))))
