"""Triangles in numpy alone: distances, winding numbers, and what is above what.

Nothing here is of PackIt-Sim or trimesh.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

CHUNK = 20_000
"""Pairs of triangles at a time."""


def distance(one: Floats, other: Floats, within: float) -> float:
    """Return the smallest distance of two sets of triangles (n, 3, 3).

    Parameters
    ----------
    within : float
        Larger distances need not be exact: infinity may be returned instead.

    Returns
    -------
    float
        The distance; 0 if two triangles cross.
    """
    least = np.inf
    for a, b in _near(one, other, within):
        least = min(least, float(_distances(a, b).min()))
    return least


def _near(one: Floats, other: Floats, within: float) -> Iterator[tuple[Floats, Floats]]:
    """Yield the pairs of triangles whose bounding boxes are not farther apart."""
    low, high = one.min(axis=1)[:, None], one.max(axis=1)[:, None]
    other_low, other_high = other.min(axis=1)[None], other.max(axis=1)[None]
    gaps = np.maximum(np.maximum(low - other_high, other_low - high), 0)
    rows, columns = np.nonzero((gaps**2).sum(axis=2) <= within**2)
    for start in range(0, len(rows), CHUNK):
        yield one[rows[start : start + CHUNK]], other[columns[start : start + CHUNK]]


def _distances(a: Floats, b: Floats) -> Floats:
    """Return the distance of each pair of triangles (n, 3, 3); 0 if they cross."""
    found = np.full(len(a), np.inf)
    for p, q in ((a, b), (b, a)):
        for k in range(3):
            found = np.minimum(found, point_triangle(p[:, k], q))
            crossing = segment_crosses(p[:, k], p[:, (k + 1) % 3], q)
            found = np.where(crossing, 0.0, found)
    for i in range(3):
        for j in range(3):
            ends = a[:, i], a[:, (i + 1) % 3], b[:, j], b[:, (j + 1) % 3]
            found = np.minimum(found, segment_segment(*ends))
    return found


def point_segment(p: Floats, a: Floats, b: Floats) -> Floats:
    """Return the distances of points from segments, all (n, 3)."""
    d = b - a
    t = _dot(p - a, d) / np.maximum(_dot(d, d), 1e-300)
    return np.linalg.norm(a + np.clip(t, 0, 1)[:, None] * d - p, axis=1)


def point_triangle(p: Floats, corners: Floats) -> Floats:
    """Return the distances of points (n, 3) from triangles (n, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    over = size > 0
    for start, end in ((a, b), (b, c), (c, a)):
        over &= _dot(np.cross(end - start, p - start), normal) >= 0
    edges = np.minimum(point_segment(p, a, b), point_segment(p, b, c))
    edges = np.minimum(edges, point_segment(p, c, a))
    plane = np.abs(_dot(p - a, normal)) / np.maximum(size, 1e-300)
    return np.where(over, np.minimum(plane, edges), edges)


def segment_segment(p: Floats, q: Floats, r: Floats, s: Floats) -> Floats:
    """Return the distances of segments pq from segments rs, all (n, 3)."""
    u, v, w = q - p, s - r, p - r
    uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    below = uu * vv - uv * uv
    safe = below > 1e-12 * uu * vv
    divisor = np.where(safe, below, 1.0)
    t, z = (uv * vw - vv * uw) / divisor, (uu * vw - uv * uw) / divisor
    inner = safe & (t >= 0) & (t <= 1) & (z >= 0) & (z <= 1)
    between = np.linalg.norm(w + t[:, None] * u - z[:, None] * v, axis=1)
    ends = np.minimum(point_segment(p, r, s), point_segment(q, r, s))
    ends = np.minimum(ends, np.minimum(point_segment(r, p, q), point_segment(s, p, q)))
    return np.where(inner, np.minimum(between, ends), ends)


def segment_crosses(p: Floats, q: Floats, corners: Floats) -> Bools:
    """Return which segments pq pass through the inside of triangles (n, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    from_p, from_q = _dot(p - a, normal), _dot(q - a, normal)
    found = from_p * from_q < 0
    span = np.where(found, from_p - from_q, 1.0)
    hit = p + (from_p / span)[:, None] * (q - p)
    for start, end in ((a, b), (b, c), (c, a)):
        found &= _dot(np.cross(end - start, hit - start), normal) >= 0
    return found


def winding_numbers(points: Floats, corners: Floats) -> Floats:
    """Return how often a surface (m, 3, 3) winds around points (n, 3): 1 inside a solid."""
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(each, axis=2) for each in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=2)
    below = la * lb * lc + (a * b).sum(axis=2) * lc
    below += (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
    winding: Floats = np.arctan2(above, below).sum(axis=1) / (2 * np.pi)
    return winding


def highest_above(lower: Floats, upper: Floats) -> float:
    """Return by how much points of `upper` are above points of `lower` with the same x and y.

    Both are triangles (n, 3, 3).

    Returns
    -------
    float
        The largest difference of z; minus infinity if no triangles are over each other.
    """
    best = -np.inf
    low, high = lower[:, :, :2].min(axis=1)[:, None], lower[:, :, :2].max(axis=1)[:, None]
    other_low, other_high = upper[:, :, :2].min(axis=1)[None], upper[:, :, :2].max(axis=1)[None]
    rows, columns = np.nonzero(((low <= other_high) & (other_low <= high)).all(axis=2))
    for start in range(0, len(rows), CHUNK):
        a, b = lower[rows[start : start + CHUNK]], upper[columns[start : start + CHUNK]]
        for k in range(3):
            best = max(best, _largest(_height(a[:, k], b) - a[:, k, 2]))
            best = max(best, _largest(b[:, k, 2] - _height(b[:, k], a)))
        for i in range(3):
            for j in range(3):
                ends = a[:, i], a[:, (i + 1) % 3], b[:, j], b[:, (j + 1) % 3]
                best = max(best, _largest(_rise(*ends)))
    return best


def _largest(values: Floats) -> float:
    return float(np.nanmax(values, initial=-np.inf))


def _height(p: Floats, corners: Floats) -> Floats:
    """Return z of triangles at the x and y of points (n, 3); NaN beside them or if upright."""
    a, ab, ac, ap = corners[:, 0], *(x - corners[:, 0] for x in (corners[:, 1], corners[:, 2], p))
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    flat = np.abs(area) > 1e-9
    divisor = np.where(flat, area, 1.0)
    t = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / divisor
    u = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / divisor
    inside = flat & (t >= 0) & (u >= 0) & (t + u <= 1)
    return np.where(inside, a[:, 2] + t * ab[:, 2] + u * ac[:, 2], np.nan)


def _rise(p: Floats, q: Floats, r: Floats, s: Floats) -> Floats:
    """Return how much segments rs are above pq where they cross in the plan; NaN elsewhere."""
    u, v, w = q - p, s - r, r - p
    below = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    safe = np.abs(below) > 1e-9
    divisor = np.where(safe, below, 1.0)
    t = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / divisor
    z = (w[:, 0] * u[:, 1] - w[:, 1] * u[:, 0]) / divisor
    inside = safe & (t >= 0) & (t <= 1) & (z >= 0) & (z <= 1)
    return np.where(inside, r[:, 2] + z * v[:, 2] - p[:, 2] - t * u[:, 2], np.nan)


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("ij,ij->i", a, b)
    return product
