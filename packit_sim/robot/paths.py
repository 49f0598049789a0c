"""Paths between two points of a space with obstacles: RRT-Connect, with shortcuts."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from packit_sim.geometry.arrays import Floats

STEP = 0.4
"""Longest edge of a tree."""

TRIES = 400
"""Random points that are tried before the search gives up."""

SHORTCUTS = 30
"""Pairs of points of a path between which a straight edge is tried."""

_SAME = 1e-12
"""Squared distance below which two points are the same."""

Edge = Callable[[Floats, Floats], bool]
"""Decides whether a straight edge is free."""


def find_path(
    start: Floats, goal: Floats, low: Floats, high: Floats, is_free: Edge, rng: np.random.Generator
) -> Floats | None:
    """Find a path of straight edges.

    Parameters
    ----------
    start : ndarray of float64, shape (d,)
        Where the path starts, as also `goal` and the limits of the space.
    is_free : callable
        Decides whether the edge between two points is free.

    Returns
    -------
    ndarray of float64, shape (n, d)
        The corners of the path; None if none was found.

    Notes
    -----
    J. Kuffner and S. LaValle, RRT-Connect: an efficient approach to single-query path planning,
    ICRA 2000. The straight edge comes first.
    """
    if is_free(start, goal):
        return np.stack((start, goal))
    one, other = _Tree(start), _Tree(goal)
    for _ in range(TRIES):
        reached = one.extend(rng.uniform(low, high), is_free, greedy=False)
        if reached is not None:
            met = other.extend(one.points[reached], is_free, greedy=True)
            if met is not None and _is_same(other.points[met], one.points[reached]):
                ends = one.branch(reached)[::-1], other.branch(met)[1:]
                path = [*ends[0], *ends[1]]
                if one.points[0] is not start:
                    path.reverse()
                return np.array(_shortened(path, is_free, rng))
        one, other = other, one
    return None


class _Tree:
    def __init__(self, root: Floats) -> None:
        self.points = [root]
        self._parents = [-1]

    def extend(self, towards: Floats, is_free: Edge, *, greedy: bool) -> int | None:
        """Grow towards a point, by one edge or as far as possible; return the end, if it grew."""
        gaps = np.array(self.points) - towards
        near = int((gaps**2).sum(axis=1).argmin())
        found = None
        while not _is_same(self.points[near], towards):
            way = towards - self.points[near]
            share = min(1.0, STEP / float(np.linalg.norm(way)))
            point = towards if share == 1.0 else self.points[near] + share * way
            if not is_free(self.points[near], point):
                return found
            self.points.append(point)
            self._parents.append(near)
            near = found = len(self.points) - 1
            if not greedy:
                return found
        return near

    def branch(self, at: int) -> list[Floats]:
        """Return the points from one of them to the root."""
        found = []
        while at >= 0:
            found.append(self.points[at])
            at = self._parents[at]
        return found


def _is_same(one: Floats, other: Floats) -> bool:
    gap = one - other
    return float(gap @ gap) < _SAME


def _shortened(path: list[Floats], is_free: Edge, rng: np.random.Generator) -> list[Floats]:
    """Replace parts of a path between two random points of it by straight edges."""
    for _ in range(SHORTCUTS):
        if len(path) == 2:
            break
        lengths = [float(np.linalg.norm(b - a)) for a, b in pairwise(path)]
        places = np.concatenate(((0.0,), np.cumsum(lengths)))
        ends = np.sort(rng.uniform(0.0, places[-1], 2))
        first, last = (np.searchsorted(places, ends, side="right") - 1).tolist()
        if first == last:
            continue
        cut = [
            path[n] + (end - places[n]) / lengths[n] * (path[n + 1] - path[n])
            for n, end in zip((first, last), ends.tolist(), strict=True)
        ]
        if is_free(*cut):
            path = [*path[: first + 1], *cut, *path[last + 1 :]]
    return path
