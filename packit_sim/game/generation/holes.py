"""Holes in a box: the largest item of a shape that fits into one, at any scale and rotation.

First, points of the shape are compared with the fine cells of the box, for all rotations and
locations at once. This needs no voxels of the item, which would have to be computed for each scale.
A point inside another item proves that a placement is not feasible. The engine decides the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from packit_sim.box import Box
from packit_sim.game.generation.hole_kernels import find_holes, inner_rows
from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.bits import Words
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import FINE, STEP
from packit_sim.geometry.shapes import Item, Shape

REFERENCE_SIDE = 0.25
"""Longest side, in box units, of the item whose cells are the points inside a shape."""

SPREAD_POINTS = 128
"""Points inside a shape that are compared first: deep ones, far from each other."""

SOLID_POINTS, SURFACE_POINTS = 3000, 4000
"""Further points inside a shape, and points on its surface."""

DEEP = 1.02 * math.sqrt(3) * FINE
"""Depth of a point, in box units, from which its whole fine cell is inside the shape."""

MAX_FOUND = 64
"""Placements to find at a scale before the engine decides some of them."""

MAX_DECIDED = 12
"""Placements at a scale for the engine to decide; the scale is reduced if all are infeasible."""

REDUCTIONS, REDUCTION = 8, 0.97
"""Maximum number of reductions of the volume, and the factor of each."""

LARGEST_SIDE = 0.9999
"""Longest side of an item relative to the box's shortest: the rest is for rounding."""


@dataclass(frozen=True, eq=False)
class ShapePoints:
    """Points of a shape in its canonical frame.

    Attributes
    ----------
    points : ndarray
        (n, 3) float64, in canonical units.
    depth : ndarray
        (n,) float64, a lower bound of the distance to the surface; 0 for points on it.
    coarse : int
        The number of points to compare first.
    """

    points: Floats
    depth: Floats
    coarse: int

    @classmethod
    def of(cls, shape: Shape) -> ShapePoints:
        """Choose the points of a shape, which are always the same."""
        rng = np.random.default_rng(0)
        side = REFERENCE_SIDE / float(shape.extents.max())
        inner = Item(shape, side**3).voxels.inner_fine
        padded = np.pad(inner, 1)
        depths = distance_transform_edt(padded)[1:-1, 1:-1, 1:-1]
        cells = rng.permutation(np.argwhere(inner))[:SOLID_POINTS]
        solid = (cells + 0.5 - np.array(inner.shape) / 2) * (FINE / side)
        depth = (depths[tuple(cells.T)] - 0.5) * (FINE / side)
        surface = _surface_points(shape, rng)
        order = _spread(solid, depth)
        return cls(
            np.concatenate([solid[order], surface]),
            np.concatenate([depth[order], np.zeros(len(surface))]),
            SPREAD_POINTS,
        )


@lru_cache(maxsize=1024)
def shape_points(shape: Shape) -> ShapePoints:
    """Look up or choose the points of a shape."""
    return ShapePoints.of(shape)


@dataclass(frozen=True)
class Holes:
    """The free space of a box, valid until the box changes.

    Attributes
    ----------
    rows : Words
        Its inner cells (see `hole_kernels.inner_rows`).
    """

    box: Box
    rows: Words

    @classmethod
    def of(cls, box: Box) -> Holes:
        """Take the free space of a box in its present state."""
        bricks, _, _, _, ny = box.arrays
        return cls(box, inner_rows(bricks[1], ny))

    def largest_volume(self, shape: Shape) -> float:
        """Compute the volume of a shape whose longest side is the box's shortest."""
        longest, side = float(shape.extents.max()), float(self.box.size.min())
        return shape.volume * (LARGEST_SIDE * side / longest) ** 3

    def placements(
        self, shape: Shape, scale: float, turns: Sequence[int], each: int, max_count: int
    ) -> list[tuple[int, tuple[int, int, int]]]:
        """Find placements that points of a shape do not prove to be infeasible.

        Parameters
        ----------
        turns : sequence of int
            The rotations to look at, in this order.
        each : int
            The number of placements to find for each rotation.
        max_count : int
            The number of placements to find in all.

        Returns
        -------
        list of tuple
            Rotations and locations. All feasible placements are among them, unless there are more
            than `each` or `max_count`.
        """
        side = float(np.cbrt(scale))
        own = shape_points(shape)
        order = np.array(turns, dtype=np.int64)
        axes = rotations.AXES[order]
        upright = np.array(Item(shape, scale).cells)
        rows = np.concatenate([axes, rotations.SIGNS[order], upright[axes]], axis=1)
        limits = np.minimum((self.box.cells - upright[axes]) // STEP + 1, self.box.nodes)
        found = np.empty((max_count, 4), dtype=np.int64)
        count = find_holes(
            self.box.arrays,
            self.rows,
            own.points * (side / FINE),
            (own.depth * side < DEEP).astype(np.uint8),
            own.coarse,
            rows,
            limits,
            each,
            found,
        )
        return [(turns[turn], (i, j, k)) for turn, i, j, k in found[:count].tolist()]

    def largest(
        self,
        shape: Shape,
        min_volume: float,
        max_volume: float,
        rng: np.random.Generator,
        precision: float,
    ) -> PlacedItem | None:
        """Find a feasible placement of a shape with about the largest possible volume.

        Parameters
        ----------
        min_volume : float
            The least volume of the item, in cubic box units.
        max_volume : float
            The largest volume of the item, in cubic box units.
        precision : float
            The relative precision of the volume.

        Returns
        -------
        PlacedItem or None
            The item, which is feasible; None if none was found.
        """
        max_volume = min(max_volume, self.largest_volume(shape))
        if min_volume > max_volume:
            return None
        order = rng.permutation(rotations.COUNT).tolist()
        fitting = self.placements(shape, min_volume / shape.volume, order, 1, rotations.COUNT)
        if not fitting:
            return None
        turns = [turn for turn, _ in fitting]
        low, high = min_volume, max_volume
        if self.placements(shape, high / shape.volume, turns, 1, 1):
            low = high
        while high > low * (1 + precision):
            middle = math.sqrt(low * high)
            if self.placements(shape, middle / shape.volume, turns, 1, 1):
                low = middle
            else:
                high = middle
        for _ in range(REDUCTIONS):
            found = self._feasible(shape, low / shape.volume, turns, rng)
            if found is not None or low <= min_volume:
                return found
            low = max(min_volume, low * REDUCTION)
        return None

    def another(self, item: Item, rng: np.random.Generator) -> PlacedItem | None:
        """Find a feasible placement of an item, in any rotation; None if none was found."""
        turns = rng.permutation(rotations.COUNT).tolist()
        return self._feasible(item.shape, item.scale, turns, rng)

    def _feasible(
        self, shape: Shape, scale: float, turns: Sequence[int], rng: np.random.Generator
    ) -> PlacedItem | None:
        """Let the engine decide some placements at a scale, in a random order."""
        candidates = self.placements(shape, scale, turns, MAX_FOUND, MAX_FOUND)
        for n in rng.permutation(len(candidates))[:MAX_DECIDED].tolist():
            turn, location = candidates[n]
            item = Item(shape, scale, turn)
            if self.box.is_feasible(item, location):
                return PlacedItem(item, location)
        return None


def _spread(points: Floats, depth: Floats) -> npt.NDArray[np.int64]:
    """Sort points inside a shape: first deep ones that are far from each other, then the others."""
    if len(points) == 0:
        return np.empty(0, dtype=np.int64)
    chosen = [int(depth.argmax())]
    distance = np.full(len(points), np.inf)
    while len(chosen) < min(SPREAD_POINTS, len(points)):
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int((distance + depth).argmax()))
    others = np.setdiff1d(np.arange(len(points)), chosen)
    return np.concatenate([np.array(chosen), others])


def _surface_points(shape: Shape, rng: np.random.Generator) -> Floats:
    """Draw points on the surface, uniformly by area."""
    corners = np.asarray(shape.mesh.triangles)
    areas = np.asarray(shape.mesh.area_faces)
    chosen = corners[rng.choice(len(corners), size=SURFACE_POINTS, p=areas / areas.sum())]
    first, second = np.sqrt(rng.random(SURFACE_POINTS)), rng.random(SURFACE_POINTS)
    weights = np.stack([1 - first, first * (1 - second), first * second], axis=1)
    points: Floats = np.einsum("nc,ncd->nd", weights, chosen)
    return points
