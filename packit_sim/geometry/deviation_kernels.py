"""Kernels for distances from a surface, by its tree of boxes (see `triangle_trees`).

The one-sided Hausdorff distance by branch and bound (Tang, Lee and Kim, 2009): the distance from a
convex set is a convex function, so that no point of a piece of a triangle is farther from a
triangle of the surface than the piece's farthest corner is. The best such triangle bounds a piece
from above, its corners bound it from below; a piece whose bounds differ is cut in two.

Exactness: `bound` returns two proved bounds (up to rounding), `farthest` and `distances` exact
values. Distances are measured to a point of a triangle, so that rounding never makes them too
small. `divided` is shared with the tests of two trees.
"""

from __future__ import annotations

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inner_kernel, kernel

_CUTS_TO_FIT = 64
"""Cuts of a triangle, one inside the other, after which its pieces are only halved."""

_HALVED = 4
"""Before that, every n-th cut is a halving."""

_SLIVER = 1e-3
"""Share of an edge below which a part is not cut off."""

_BISECTIONS = 40
"""Steps to find where an edge leaves the neighbourhood of a triangle."""

_STACK = 512
"""Pieces that can wait: halving makes any piece as small as the slack in far fewer cuts."""


@kernel
def distances(points, surface, most):
    """Return (n,) distances of points (n, 3) from a surface, at most `most`."""
    found = np.empty(len(points))
    best = 0
    for n in range(len(points)):
        found[n], best = _nearest(points[n : n + 1], surface, best, 0.0, most)
    return found


@kernel
def farthest(points, surface, low):
    """Return the largest distance of points (n, 3) from a surface, at least `low`."""
    best = 0
    for n in range(len(points)):
        distance, best = _nearest(points[n : n + 1], surface, best, low, np.inf)
        low = max(low, distance)
    return low


@kernel
def bound(triangles, surface, low, high, relative_slack, slack):
    """Bound the one-sided Hausdorff distance of triangles (n, 3, 3) from a surface from both sides.

    Parameters
    ----------
    triangles : ndarray
        (n, 3, 3) float64.
    low : float
        Lower bound so far; all corners of the triangles are within it.
    high : float
        Upper bound so far.
    relative_slack : float
        Largest relative excess of the upper bound over the distance.
    slack : float
        Further excess, absolute.

    Returns
    -------
    low, high : float
        Both bounds, at least as large as before.
    """
    pieces = np.empty((_STACK, 3, 3))
    cuts = np.empty(_STACK, np.int64)
    cut = np.empty((1, 3))
    best = 0
    for n in range(len(triangles)):
        pieces[0], cuts[0] = triangles[n], 0
        top = 1
        while top:
            top -= 1
            piece, depth = pieces[top], cuts[top] + 1
            distance, best = _nearest(piece, surface, best, high, np.inf)
            if distance <= high:
                continue
            # Close enough to the lower bound; or the stack is full, where `high` stays a bound.
            if distance <= low * (1 + relative_slack) + slack or top + 2 > _STACK:
                high = distance
                continue
            # `best` bounds the piece: cut where an edge leaves the neighbourhood of that triangle.
            start, end = _cut(piece, surface.triangles[best], high, depth, cut[0])
            low = max(low, _nearest(cut, surface, best, low, np.inf)[0])
            high = max(high, low)
            pieces[top + 1] = piece
            pieces[top, end] = cut[0]
            pieces[top + 1, start] = cut[0]
            cuts[top] = cuts[top + 1] = depth
            top += 2
    return low, high


@inner_kernel
def _cut(piece, triangle, high, depth, cut):
    """Choose where to cut a piece: return the edge's two corners, and write the point to `cut`.

    The cut is where the edge leaves the triangle's neighbourhood, so that surfaces that agree are
    only cut into their overlay, or else at the middle of the longest edge. depth: number of cuts.
    """
    start = end = 0
    least, most = np.inf, -1.0
    for i in range(3):
        distance = np.sqrt(_from_triangle(piece[i], triangle))
        if distance < least:
            start, least = i, distance
        if distance > most:
            end, most = i, distance
    # Every fourth cut halves, and after many all do: else slivers could be cut off without end.
    if least <= high and depth % _HALVED and depth < _CUTS_TO_FIT:
        near, far = 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = (near + far) / 2
            for axis in range(3):
                cut[axis] = piece[start, axis] + middle * (piece[end, axis] - piece[start, axis])
            if np.sqrt(_from_triangle(cut, triangle)) <= high:
                near = middle
            else:
                far = middle
        if _SLIVER < near < 1 - _SLIVER:
            return start, end
    longest = -1.0
    for i in range(3):
        length = 0.0
        for axis in range(3):
            length += (piece[i, axis] - piece[i - 1, axis]) ** 2
        if length > longest:
            start, end, longest = i, i - 1, length
    for axis in range(3):
        cut[axis] = (piece[start, axis] + piece[end, axis]) / 2
    return start, end


@kernel
def divided(waiting, top, a, b, is_first):
    """Append the pairs of one node and each child of the other; return how many pairs wait then."""
    if is_first:
        waiting[top, 0], waiting[top, 1] = 2 * a, b
        waiting[top + 1, 0], waiting[top + 1, 1] = 2 * a + 1, b
    else:
        waiting[top, 0], waiting[top, 1] = a, 2 * b
        waiting[top + 1, 0], waiting[top + 1, 1] = a, 2 * b + 1
    return top + 2


@allocating_kernel
def _nearest(points, surface, guess, enough, most):
    """Find the triangle whose largest distance from points (n, 3) is least: distance and number.

    Any triangle with a distance of at most `enough` may be returned; `guess` is tried first. If all
    distances are more than `most`, the distance is `most` and the number has no meaning.
    """
    enough = enough * enough
    # Pieces that follow each other are often nearest to the same triangle: a good first bound.
    best, least = guess, min(_farthest_corner(points, surface.triangles[guess]), most * most)
    leaves = len(surface.starts) - 1
    stack = np.empty(64, np.int64)
    bounds = np.empty(64)
    stack[0], bounds[0] = 1, 0.0
    top = 1
    while top and least > enough:
        top -= 1
        node = stack[top]
        if bounds[top] >= least:
            continue
        if node >= leaves:
            for n in range(surface.starts[node - leaves], surface.starts[node - leaves + 1]):
                distance = _farthest_corner(points, surface.triangles[n])
                if distance < least:
                    best, least = n, distance
            continue
        near, far = 2 * node, 2 * node + 1
        to_near, to_far = (
            _from_box(points, surface.boxes[near]),
            _from_box(points, surface.boxes[far]),
        )
        # The nearer child is searched first: it lowers the bound that prunes the other one.
        if to_far < to_near:
            near, far, to_near, to_far = far, near, to_far, to_near
        stack[top], bounds[top] = far, to_far
        stack[top + 1], bounds[top + 1] = near, to_near
        top += 2
    return np.sqrt(least), best


@inner_kernel
def _farthest_corner(points, triangle):
    """Return the largest squared distance of points (n, 3) from a triangle (3, 3)."""
    most = 0.0
    for n in range(len(points)):
        most = max(most, _from_triangle(points[n], triangle))
    return most


@inner_kernel
def _from_box(points, box):
    """Return the largest squared distance of points (n, 3) from a box (2, 3)."""
    most = 0.0
    for n in range(len(points)):
        total = 0.0
        for axis in range(3):
            at = points[n, axis]
            total += max(box[0, axis] - at, at - box[1, axis], 0.0) ** 2
        most = max(most, total)
    return most


@inner_kernel
def _from_triangle(point, triangle):
    """Return the squared distance of a point (3,) from a triangle (3, 3), which may have no area.

    It is measured to a point of the triangle, so that rounding does not make it too small.
    """
    least = np.inf
    for i in range(3):
        least = min(least, _from_segment(point, triangle[i], triangle[i - 1]))
    uu = uv = vv = up = vp = 0.0
    for axis in range(3):
        u = triangle[1, axis] - triangle[0, axis]
        v = triangle[2, axis] - triangle[0, axis]
        p = point[axis] - triangle[0, axis]
        uu += u * u
        uv += u * v
        vv += v * v
        up += u * p
        vp += v * p
    # The foot on the plane counts only inside the triangle, by barycentric coordinates; a triangle
    # without area has none, and its edges are enough.
    area = uu * vv - uv * uv
    along_u, along_v = vv * up - uv * vp, uu * vp - uv * up
    if along_u > 0 and along_v > 0 and along_u + along_v < area:
        total = 0.0
        for axis in range(3):
            u = triangle[1, axis] - triangle[0, axis]
            v = triangle[2, axis] - triangle[0, axis]
            foot = triangle[0, axis] + (along_u * u + along_v * v) / area
            total += (point[axis] - foot) ** 2
        least = min(least, total)
    return least


@inner_kernel
def _from_segment(point, start, end):
    """Return the squared distance of a point (3,) from a segment."""
    along = length = 0.0
    for axis in range(3):
        side = end[axis] - start[axis]
        along += (point[axis] - start[axis]) * side
        length += side * side
    share = min(max(along / length, 0.0), 1.0) if length > 0 else 0.0
    total = 0.0
    for axis in range(3):
        total += (point[axis] - start[axis] - share * (end[axis] - start[axis])) ** 2
    return total
