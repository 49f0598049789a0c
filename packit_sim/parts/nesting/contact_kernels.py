"""Kernels for planes that keep pairs of items apart while all items move at once.

A plane of a pair is a unit normal and a length: the second item's way less the first's must reach
at least that far along the normal. The first plane of a pair lies between its nearest points; its
normal is the gradient of their distance, by differences. If ways lead into a conflict nevertheless,
a further plane touches the last free point on the straight way there, found by bisection, so that
the same ways are not possible again. Planes between translating items go back to the compaction of
layouts by Li and Milenkovic (1995), which are polygons; here the surfaces are asked, of any form.

Invariant: a plane is only a guide, and may leave out what is possible. `in_conflict` decides.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inner_kernel, kernel
from packit_sim.parts.nesting.cost_kernels import offset
from packit_sim.parts.nesting.overlap_kernels import distance_at_shift, in_conflict

HALVINGS = 6
"""Bisections of a way: its end is known to a 60th."""

SHORTER = 0.9
"""Share of a free way that is left where its end has no plane that excludes the way beyond it."""


@allocating_kernel
def _offset(problem, state, i, j, x, y, z):
    """Return what `offset` returns after the second item has gone (x, y, z)."""
    p = np.empty(3)
    p[0], p[1], p[2] = state.places[i, 0] - x, state.places[i, 1] - y, state.places[i, 2] - z
    return offset(problem.lookup, state, i, state.turned[i], p, j)


@inner_kernel
def _is_blocked(problem, state, i, j, x, y, z):
    """Return whether two items are in conflict after the second has gone (x, y, z)."""
    first, other, rel, sx, sy, sz = _offset(problem, state, i, j, x, y, z)
    return in_conflict(problem, first, other, rel, sx, sy, sz, True)


@inner_kernel
def _gap(problem, state, i, j, x, y, z, limit):
    """Return the distance of surfaces that don't cross, up to a limit."""
    first, other, rel, sx, sy, sz = _offset(problem, state, i, j, x, y, z)
    problem.shift[0], problem.shift[1], problem.shift[2] = sx, sy, sz
    return distance_at_shift(problem, first, other, rel, limit)


@allocating_kernel
def _normal(problem, state, i, j, x, y, z, reach, step, plane):
    """Write the gradient of the distance to a plane; return the distance.

    The normal becomes 0 if the distance is at least the reach, or has no gradient.
    """
    gap = _gap(problem, state, i, j, x, y, z, reach)
    plane[:] = 0
    if gap >= reach:
        return gap
    limit = gap + 2 * step
    plane[0] = _gap(problem, state, i, j, x + step, y, z, limit) - gap
    plane[1] = _gap(problem, state, i, j, x, y + step, z, limit) - gap
    plane[2] = _gap(problem, state, i, j, x, y, z + step, limit) - gap
    length = np.sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
    if length > 0.1 * step:  # else they touch from several sides
        plane[:3] /= length
    else:
        plane[:3] = 0
    return gap


@kernel
def first_planes(problem, state, pairs, reach, step, margin, planes, gaps):
    """Find the planes between pairs that are apart.

    Parameters
    ----------
    state : State
        Poses of all items, without conflicts.
    pairs : ndarray
        (p, 2) int64, the items.
    reach : float
        Distance from which on a pair needs no plane.
    step : float
        The step of differences.
    margin : float
        Distance that is kept in addition to the clearance.
    planes : ndarray
        (p, 4) float64, written: normals and lengths, 0 without a plane.
    gaps : ndarray
        (p,) float64, written: how far the second item may go anywhere.
    """
    clearance = problem.lookup.clearance
    for n in range(len(pairs)):
        i, j = pairs[n]
        gap = _normal(problem, state, i, j, 0.0, 0.0, 0.0, clearance + reach, step, planes[n])
        gaps[n] = max(0.0, gap - clearance - margin)
        planes[n, 3] = -gaps[n]


@kernel
def cutting_planes(problem, state, pairs, gaps, free, ways, step, margin, numbers, planes):
    """Find the pairs that are in conflict after all items have moved, and planes that exclude it.

    Parameters
    ----------
    state, pairs, gaps, step, margin
        As for `first_planes`.
    free : ndarray
        (p, 3) float64, a way of the second item, less the first's, that is known to be free;
        updated.
    ways : ndarray
        (n, 3) float64, by items.
    numbers : ndarray
        (p,) int64, written: the pairs that are in conflict.
    planes : ndarray
        (p, 4) float64, written: theirs.

    Returns
    -------
    int
        The number of these pairs.
    """
    count = 0
    clearance = problem.lookup.clearance
    for n in range(len(pairs)):
        i, j = pairs[n]
        x, y, z = ways[j, 0] - ways[i, 0], ways[j, 1] - ways[i, 1], ways[j, 2] - ways[i, 2]
        length = np.sqrt(x * x + y * y + z * z)
        change = abs(x - free[n, 0]) + abs(y - free[n, 1]) + abs(z - free[n, 2])
        if length <= gaps[n] or change == 0:
            continue
        if not _is_blocked(problem, state, i, j, x, y, z):
            free[n, 0], free[n, 1], free[n, 2] = x, y, z
            continue
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if _is_blocked(problem, state, i, j, middle * x, middle * y, middle * z):
                high = middle
            else:
                low = middle
        plane = planes[count]
        reach = clearance + 2 * length
        gap = _normal(problem, state, i, j, low * x, low * y, low * z, reach, step, plane)
        along = plane[0] * x + plane[1] * y + plane[2] * z
        plane[3] = min(0.0, low * along - (gap - clearance) + margin)
        if not along < plane[3] - margin:
            plane[0], plane[1], plane[2] = -x / length, -y / length, -z / length
            plane[3] = -SHORTER * low * length
        numbers[count] = n
        count += 1
    return count
