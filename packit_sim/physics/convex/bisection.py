"""A decomposition that always comes: halves of halves, where a hull fills what is hollow."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

import numpy as np

from packit_sim.geometry.shapes import Shape
from packit_sim.physics.convex.pieces import Floats, Piece, clipped
from packit_sim.physics.convex.solids import Solid


@dataclass(order=True)
class _Part:
    """What of a surface is between two corners: the worst of them comes first.

    overhang: of its hull, with a minus. number: in the order of making. low, high: (3,).
    """

    overhang: float
    number: int
    low: Floats = field(compare=False)
    high: Floats = field(compare=False)
    piece: Piece = field(compare=False)


def bisected(shape: Shape, solid: Solid, overhang: float, most: int) -> list[Piece]:
    """Hulls of a shape's surface in boxes that are halved until no hull is too far out.

    overhang: how far a hull may reach out of the shape, in canonical units (see `Solid`). most:
    pieces at which it ends in any case. The worst is halved next, across its longest side.
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
        return [_Part(-solid.overhang(piece), count, points.min(axis=0), points.max(axis=0), piece)]

    heap = parts(*np.asarray(shape.mesh.bounds))
    while -heap[0].overhang > overhang and len(heap) < most:
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
    """(6, 4) the planes of a box."""
    normals = np.concatenate((-np.eye(3), np.eye(3)))
    return np.column_stack((normals, np.concatenate((low, -high))))
