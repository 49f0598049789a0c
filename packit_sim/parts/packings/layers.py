"""The layers of a packing: the area of its parts, and how many there are, at each height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.packings.packing import Packing

COUNT = 50
"""Heights at which a packing is cut, evenly spaced from the floor to the highest part."""


@dataclass(frozen=True, eq=False)
class Layers:
    """Cuts through a packing.

    Attributes
    ----------
    heights : ndarray of float64, shape (k,)
        The heights of the cuts: the middles of layers of equal height.
    areas : ndarray of float64, shape (k,)
        The area of all parts in each; exact for closed meshes.
    counts : ndarray of int64, shape (k,)
        How many parts each goes through.
    """

    heights: Floats
    areas: Floats
    counts: Ints

    @property
    def variation(self) -> float:
        """The coefficient of variation of the areas: 0 if they are all equal."""
        return variation(self.areas)


def variation(areas: Floats) -> float:
    """Return the standard deviation of areas, divided by their mean."""
    mean = float(areas.mean())
    return float(areas.std()) / mean if mean > 0 else 0.0


def layers(packing: Packing) -> Layers:
    """Cut a packing into layers, from the floor to its highest part."""
    top = packing.height
    heights = (np.arange(COUNT) + 0.5) * top / COUNT
    areas, counts = np.zeros(COUNT), np.zeros(COUNT, np.int64)
    for one in packing.placements:
        vertices = packing.vertices(one)
        faces = packing.types[one.type].faces
        first, last = np.searchsorted(heights, (vertices[:, 2].min(), vertices[:, 2].max()))
        counts[first:last] += 1
        for n in range(first, last):
            areas[n] += cut_area(vertices[faces], float(heights[n]))
    return Layers(heights, areas, counts)


def cut_area(triangles: Floats, height: float) -> float:
    """Return the area of a closed mesh in a horizontal plane.

    Each triangle (3, 3) that crosses the plane has a segment in it, with the inside on its left:
    the area of the polygons of all segments follows from Green's theorem.
    """
    above = triangles[:, :, 2] > height
    crossing = above.any(axis=1) & ~above.all(axis=1)
    corners, is_above = triangles[crossing], above[crossing]
    lone = is_above.sum(axis=1) == 1  # one corner is above, else one is below
    apex = np.where(lone, is_above.argmax(axis=1), (~is_above).argmax(axis=1))
    rows = np.arange(len(corners))
    a, b, c = (corners[rows, (apex + k) % 3] for k in range(3))
    ends = []
    for other in (b, c):
        share = (height - a[:, 2]) / (other[:, 2] - a[:, 2])
        ends.append(a[:, :2] + share[:, None] * (other[:, :2] - a[:, :2]))
    (x0, y0), (x1, y1) = ends[0].T, ends[1].T
    return float(0.5 * ((x0 * y1 - x1 * y0) * np.where(lone, 1.0, -1.0)).sum())
