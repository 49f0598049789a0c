"""Near-duplicates among shapes: turned, mirrored, remeshed or slightly edited."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from packit_sim.geometry.deviation import Surface
from packit_sim.geometry.deviation_kernels import distances
from packit_sim.geometry.shapes import Shape

SAME = 0.004
"""Mean distance of two surfaces up to which they are near-duplicates, in canonical units. Of the
models of Sweet Home 3D, variants of a car or a table are up to 0.0033 apart, a beer and a wine
bottle or a washing machine and a dryer more than 0.005."""

SAME_OF_THICKNESS = 0.1
"""The same relative to the least extent, for flat shapes, which are near each other anyway."""

EXTENTS = 0.03
"""Largest difference of the extents of near-duplicates, in canonical units."""

POINTS = 512
"""Number of sample points on a surface at which its distance from others is measured."""

_FIRST = 32, 2.5
"""Points in a first test, and the factor above the limit at which it drops an orientation."""

_CAP = 0.05
"""Distances are capped here: a single part that moved does not make another object."""


def near_duplicates(shapes: Sequence[Shape]) -> list[int]:
    """Group shapes that are near-duplicates of each other.

    Parameters
    ----------
    shapes : Sequence[Shape]
        The shapes to compare.

    Returns
    -------
    list[int]
        The number of each shape's group, counted from 0 in the order of the shapes.

    Notes
    -----
    Two shapes are near-duplicates if their surfaces are at most `SAME` apart in the mean in one of
    the 24 rotations or their mirror images. Groups are the connected components, so that they do
    not depend on the order of the shapes.
    """
    if not shapes:
        return []
    probes = [_Probe.of(shape) for shape in shapes]
    sorted_extents = np.sort([probe.extents for probe in probes], axis=1)
    pairs = cKDTree(sorted_extents).query_pairs(EXTENTS, p=np.inf, output_type="ndarray")
    same = [(i, j) for i, j in pairs.tolist() if _same(probes[i], probes[j])]
    rows, columns = np.array(same, dtype=np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(same)), (rows, columns)), shape=(len(shapes), len(shapes)))
    labels = connected_components(graph, directed=False)[1]
    names: dict[int, int] = {}
    return [names.setdefault(label, len(names)) for label in labels.tolist()]


@dataclass(frozen=True, eq=False)
class _Probe:
    """A shape prepared for comparison. extents: (3,). points: (POINTS, 3) on its surface."""

    extents: npt.NDArray[np.float64]
    points: npt.NDArray[np.float64]
    surface: Surface

    @classmethod
    def of(cls, shape: Shape) -> _Probe:
        points = trimesh.sample.sample_surface(shape.mesh, POINTS, seed=0)[0]
        return cls(shape.extents, np.array(points), Surface.of(shape.mesh))


def _same(a: _Probe, b: _Probe) -> bool:
    limit = min(SAME, SAME_OF_THICKNESS * a.extents.min(), SAME_OF_THICKNESS * b.extents.min())
    for axes in map(list, itertools.permutations(range(3))):
        if np.abs(a.extents[axes] - b.extents).max() > EXTENTS:
            continue
        back = np.argsort(axes)
        for signs in itertools.product((1, -1), repeat=3):
            if all(
                _near(points, probe.surface, limit)
                for points, probe in (
                    (a.points[:, axes] * signs, b),
                    ((b.points * signs)[:, back], a),
                )
            ):
                return True
    return False


def _near(points: npt.NDArray[np.float64], surface: Surface, limit: float) -> bool:
    """Return whether the mean distance of points (POINTS, 3) from a surface is within a limit."""
    count, times = _FIRST
    if distances(points[:count], surface, _CAP).mean() > times * limit:
        return False
    return bool(distances(points, surface, _CAP).mean() <= limit)
