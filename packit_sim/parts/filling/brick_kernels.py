"""Kernels that move bricks of a window apart: among each other, other bricks and walls.

How deep two bricks, or a brick and a triangle of a wall, reach into each other is the least length
along one of the axes that can separate two convex bodies (Gottschalk et al., 1996): normals of
sides, and products of edges. The overlap of a window is the sum of these depths with weights, which
grow where bricks stay in conflict: guided local search (Voudouris and Tsang, 1999).
"""

from __future__ import annotations

import math

import numpy as np

from packit_sim.core.compilation import allocating_kernel, inner_kernel, kernel
from packit_sim.parts.nesting.pose_kernels import random

FAR = 15
"""Trials of a move anywhere in the window, of a brick that is in conflict."""

NEAR = 25
"""Trials of a move near the best one so far."""

TURNED = 0.5
"""Share of trials anywhere in which a brick that may turn freely leans."""

LEANING = 0.5
"""Standard deviation in radians of the turn of such a brick, about each axis."""

ABOUT_ONE = 0.75
"""Share of the turns that are about one of the brick's axes only."""

SCATTER = 1.6
"""Standard deviation of the first near moves along each axis, in the shortest half side; the last
ones are 300 times smaller."""

GROWTH = 1.2
"""Factor of the weight of a conflict that stays."""

DECAY = 0.95
"""Factor of the weight of a conflict that is gone; weights are at least 1."""

FIRST_STEP, LAST_STEP, SHRINKAGE = 0.08, 4e-5, 0.4
"""Steps along the sides after the trials, relative to the shortest brick's half side, and how they
shrink."""

PARALLEL = 1e-6
"""Square of the sine between two edges below which their product is no axis."""


@inner_kernel
def _brick_depth(bricks, place, axes, j, scratch):
    """Return how deep a brick at a place (3,), with axes (3, 3), reaches into brick j, or 0."""
    centres, turned, halves = bricks
    half = halves[0]
    dot, flat, way = scratch
    dx, dy, dz = centres[j, 0] - place[0], centres[j, 1] - place[1], centres[j, 2] - place[2]
    least = 1e300
    for a in range(3):
        way[a] = axes[a, 0] * dx + axes[a, 1] * dy + axes[a, 2] * dz
        reach = half[a]
        for b in range(3):
            dot[a, b] = (
                axes[a, 0] * turned[j, b, 0]
                + axes[a, 1] * turned[j, b, 1]
                + axes[a, 2] * turned[j, b, 2]
            )
            flat[a, b] = abs(dot[a, b])
            reach += half[b] * flat[a, b]
        least = min(least, reach - abs(way[a]))
        if least <= 0.0:
            return 0.0
    for b in range(3):
        reach, along = half[b], 0.0
        for a in range(3):
            reach += half[a] * flat[a, b]
            along += way[a] * dot[a, b]
        least = min(least, reach - abs(along))
        if least <= 0.0:
            return 0.0
    for a in range(3):
        a1, a2 = (a + 1) % 3, (a + 2) % 3
        for b in range(3):
            square = 1.0 - dot[a, b] * dot[a, b]
            if square < PARALLEL:
                continue
            b1, b2 = (b + 1) % 3, (b + 2) % 3
            along = abs(way[a2] * dot[a1, b] - way[a1] * dot[a2, b])
            reach = half[a1] * flat[a2, b] + half[a2] * flat[a1, b]
            reach += half[b1] * flat[a, b2] + half[b2] * flat[a, b1]
            least = min(least, (reach - along) / math.sqrt(square))
            if least <= 0.0:
                return 0.0
    return least


@inner_kernel
def _along(least, x, y, z, size, points, half):
    """Return the least depth so far and along an axis in a brick's frame; 0 if they are apart.

    An axis whose square is next to nothing, relative to a size, is none.
    """
    square = x * x + y * y + z * z
    if square <= PARALLEL * size:
        return least
    low, high = 1e300, -1e300
    for k in range(3):
        along = x * points[k, 0] + y * points[k, 1] + z * points[k, 2]
        low, high = min(low, along), max(high, along)
    reach = abs(x) * half[0] + abs(y) * half[1] + abs(z) * half[2]
    return max(0.0, min(least, min(reach - low, high + reach) / math.sqrt(square)))


@inner_kernel
def _reach(axes, half, d):
    """Return how far a brick reaches from its centre along axis d of the space."""
    return abs(axes[0, d]) * half[0] + abs(axes[1, d]) * half[1] + abs(axes[2, d]) * half[2]


@inner_kernel
def _wall_depth(place, axes, half, triangle, points):
    """Return how deep a brick reaches over a triangle (3, 3) of a wall, or 0."""
    for d in range(3):
        reach = _reach(axes, half, d)
        low = min(triangle[0, d], min(triangle[1, d], triangle[2, d]))
        high = max(triangle[0, d], max(triangle[1, d], triangle[2, d]))
        if low >= place[d] + reach or high <= place[d] - reach:
            return 0.0
    for k in range(3):
        x, y, z = triangle[k, 0] - place[0], triangle[k, 1] - place[1], triangle[k, 2] - place[2]
        for a in range(3):
            points[k, a] = axes[a, 0] * x + axes[a, 1] * y + axes[a, 2] * z
    least = _along(1e300, 1.0, 0.0, 0.0, 1.0, points, half)
    least = _along(least, 0.0, 1.0, 0.0, 1.0, points, half)
    least = _along(least, 0.0, 0.0, 1.0, 1.0, points, half)
    x0, y0, z0 = points[0, 0], points[0, 1], points[0, 2]
    x1, y1, z1 = points[1, 0] - x0, points[1, 1] - y0, points[1, 2] - z0
    x2, y2, z2 = points[2, 0] - x0, points[2, 1] - y0, points[2, 2] - z0
    x, y, z = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
    size = (x1 * x1 + y1 * y1 + z1 * z1) * (x2 * x2 + y2 * y2 + z2 * z2)
    least = _along(least, x, y, z, size, points, half)
    for k in range(3):
        if least <= 0.0:
            return 0.0
        n = (k + 1) % 3
        x = points[n, 0] - points[k, 0]
        y = points[n, 1] - points[k, 1]
        z = points[n, 2] - points[k, 2]
        size = x * x + y * y + z * z
        least = _along(least, 0.0, z, -y, size, points, half)
        least = _along(least, -z, 0.0, x, size, points, half)
        least = _along(least, y, -x, 0.0, size, points, half)
    return least


@inner_kernel
def _is_inside(place, window, space):
    """Return whether a place (3,) is in the window, and in a voxel that is not blocked."""
    low, high = window
    blocked, voxel = space
    for d in range(3):
        if place[d] < low[d] or place[d] > high[d]:
            return False
    i, j, k = int(place[0] / voxel), int(place[1] / voxel), int(place[2] / voxel)
    if min(place[0], min(place[1], place[2])) < 0.0:
        return False
    if i >= blocked.shape[0] or j >= blocked.shape[1] or k >= blocked.shape[2]:
        return False
    return not blocked[i, j, k]


@inner_kernel
def _outside(place, axes, halves, walls, scratch):
    """Return how deep a brick reaches over the sides of the space, and over walls in it."""
    triangles, size = walls
    total = 0.0
    for d in range(3):
        reach = _reach(axes, halves[1], d)
        total += max(0.0, reach - place[d]) + max(0.0, place[d] + reach - size[d])
    for n in range(len(triangles)):
        total += _wall_depth(place, axes, halves[2], triangles[n], scratch[0])
    return total


@inner_kernel
def _overlap(bricks, i, place, axes, walls, weights, most, scratch):
    """Return the weighted overlap of brick i at a place with axes, or more than a bound."""
    total = weights[i, i] * _outside(place, axes, bricks[2], walls, scratch)
    if total >= most:
        return total
    for j in range(len(bricks[0])):
        if j != i:
            total += weights[i, j] * _brick_depth(bricks, place, axes, j, scratch)
            if total >= most:
                return total
    return total


@inner_kernel
def _normal(rng):
    """Return a number that is nearly normal, of variance 1: a sum of uniform ones."""
    return 2.0 * (random(rng) + random(rng) + random(rng) - 1.5)


@inner_kernel
def _turn(axes, deviation, rng, found):
    """Turn axes (3, 3) by a random rotation with a standard deviation, often about one of them."""
    square, only = 0.0, -1
    if random(rng) < ABOUT_ONE:
        only = int(3.0 * random(rng))
    v = found[0]
    for d in range(3):
        v[d] = 0.0
    for k in range(3):
        if only in (-1, k):
            angle = deviation * _normal(rng)
            for d in range(3):
                v[d] += angle * axes[k, d]
    for d in range(3):
        square += v[d] * v[d]
    angle = math.sqrt(square) + 1e-300
    x, y, z = v[0] / angle, v[1] / angle, v[2] / angle
    sine, rest = math.sin(angle), 1.0 - math.cos(angle)
    for a in range(3):
        p, q, r = axes[a, 0], axes[a, 1], axes[a, 2]
        along = rest * (x * p + y * q + z * r)
        found[a, 0] = p * (1.0 - rest) + (y * r - z * q) * sine + along * x
        found[a, 1] = q * (1.0 - rest) + (z * p - x * r) * sine + along * y
        found[a, 2] = r * (1.0 - rest) + (x * q - y * p) * sine + along * z


@allocating_kernel
def _move(bricks, i, window, orientations, walls, space, turns, weights, rng, scratch):
    """Move a brick to where it overlaps least, of some trials, and then by small steps."""
    centres, turned, halves = bricks
    low, high = window
    place, best = np.empty(3), centres[i].copy()
    axes, best_axes = np.empty((3, 3)), turned[i].copy()
    least = _overlap(bricks, i, best, best_axes, walls, weights, 1e300, scratch)
    shortest = min(halves[0, 0], min(halves[0, 1], halves[0, 2]))
    for trial in range(FAR + NEAR):
        if trial < FAR:
            own = orientations[int(random(rng) * len(orientations))]
            if turns and random(rng) < TURNED:
                _turn(own, LEANING, rng, axes)
            else:
                axes[:] = own
            for d in range(3):
                place[d] = low[d] + random(rng) * (high[d] - low[d])
        else:
            scale = 10.0 ** (-2.5 * (trial - FAR) / NEAR)
            if turns and random(rng) < TURNED:
                _turn(best_axes, LEANING * scale, rng, axes)
            else:
                axes[:] = best_axes
            for d in range(3):
                place[d] = best[d] + SCATTER * shortest * scale * _normal(rng)
        if not _is_inside(place, window, space):
            continue
        found = _overlap(bricks, i, place, axes, walls, weights, least, scratch)
        if found < least:
            least, best[:], best_axes[:] = found, place, axes
    step = FIRST_STEP * shortest
    while step > LAST_STEP * shortest and least > 0.0:
        before = least
        for n in range(6):
            d = n // 2  # along the brick's sides, which may be flush with a wall
            way = step if n % 2 else -step
            place[:] = best + way * best_axes[d]
            if not _is_inside(place, window, space):
                continue
            found = _overlap(bricks, i, place, best_axes, walls, weights, least, scratch)
            if found < least:
                least, best[:] = found, place
        if least == before:
            step *= SHRINKAGE
    centres[i], turned[i] = best, best_axes


@kernel
def separated(bricks, movable, window, orientations, walls, space, turns, steps, rng):
    """Move the first bricks of a window until no brick overlaps, or for some steps.

    Parameters
    ----------
    bricks : tuple of ndarray
        The centres (n, 3) and axes (n, 3, 3), as rows, of all bricks there; and the half sides
        (3, 3) that keep clear of other bricks, of the sides of the space, and of walls in it.
    movable : int
        How many of them move: the first ones. Their centres and axes are changed.
    window : tuple of ndarray
        The corners (3,) between which their centres stay.
    orientations : ndarray
        (k, 3, 3), the axes that bricks may have.
    walls : tuple of ndarray
        Triangles (m, 3, 3) in the space, and the sides (3,) of the space.
    space : tuple of (ndarray, float)
        The voxels (x, y, z) in which no centre may be, and their side.
    turns : bool
        Whether bricks may turn by any angle from their orientations.
    steps : int
        Most bricks that are moved.
    rng : ndarray
        (1,) uint64, the state of the generator.

    Returns
    -------
    bool
        Whether no brick overlaps.
    """
    centres, turned, _ = bricks
    scratch = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    weights = np.ones((movable, len(centres)))
    own = np.empty(movable)
    for _ in range(steps):
        total = 0.0
        for i in range(movable):
            own[i] = _overlap(bricks, i, centres[i], turned[i], walls, weights, 1e300, scratch)
            total += own[i]
        if total <= 0.0:
            return True
        left, moved = random(rng) * total, 0
        for i in range(movable):
            if own[i] > 0.0:
                moved = i
                left -= own[i]
                if left <= 0.0:
                    break
        _move(
            *(bricks, moved, window, orientations, walls, space),
            *(turns, weights, rng, scratch),
        )
        _weigh(bricks, movable, walls, weights, scratch)
    return False


@inner_kernel
def _weigh(bricks, movable, walls, weights, scratch):
    """Change the weights of all conflicts, by whether they are still there."""
    centres, turned, halves = bricks
    for i in range(movable):
        for j in range(len(centres)):
            if j == i:
                depth = _outside(centres[i], turned[i], halves, walls, scratch)
            else:
                depth = _brick_depth(bricks, centres[i], turned[i], j, scratch)
            if depth > 0.0:
                weights[i, j] *= GROWTH
            else:
                weights[i, j] = max(1.0, weights[i, j] * DECAY)
