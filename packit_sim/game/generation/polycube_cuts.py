"""Cuts into polycubes: connected pieces of equal cubes that interlock.

The box of 5 x 5 x 5 cubes begins as 125 pieces. The smallest piece joins a neighbour, again and
again, as long as the pieces can still be put in one after the other from above.
"""

from __future__ import annotations

import math
from graphlib import CycleError, TopologicalSorter

import numpy as np
import numpy.typing as npt

from packit_sim.game.generation.puzzle_pieces import NODES, NONE, STEP_UNITS, UNITS, PuzzlePiece
from packit_sim.geometry.arrays import Ints
from packit_sim.geometry.lattice import CONTACT_TOLERANCE

CUBES = 5
"""Cubes along the box."""

CUBE = NODES // CUBES
"""Steps of the grid along a cube."""

SIZES = (2 / 3, 4 / 3)
"""Minimum and maximum number of cubes of a piece, relative to the mean, rounded down and up."""

CLEARANCE = round(0.75 * CONTACT_TOLERANCE * UNITS)
"""Distance of the faces of a piece from those of its cubes, in millionths of the box. The surfaces
of two pieces are twice as far from each other. Collision meshes are drawn in towards the centre of
a piece. A face of a notch that looks towards the centre then moves outwards, by less than half of
the contact tolerance: without a clearance, pieces that fill each other's notches would be in
conflict."""

MIN_LOCKED = 3
"""Minimum number of directions, of six, in which one of two interlocking pieces is blocked."""

Labels = npt.NDArray[np.int64]
"""(5, 5, 5): the number of each cube's piece."""


def polycubes(pieces: int, rng: np.random.Generator) -> list[PuzzlePiece] | None:
    """Cut the box into polycubes.

    Parameters
    ----------
    rng : numpy.random.Generator
        The generator that decides which pieces join.

    Returns
    -------
    list of PuzzlePiece or None
        The pieces in an order in which they can be put in from above; None if the pieces that could
        join would be too large, or the result does not interlock.
    """
    labels = joined_cubes(pieces, rng)
    if labels is None or not interlocks(labels):
        return None
    order = _order(labels)
    assert order is not None
    return [piece_of(labels == label) for label in order]


def sizes(pieces: int) -> tuple[int, int]:
    """Return the minimum and the maximum number of cubes of a piece."""
    mean = CUBES**3 / pieces
    return max(1, math.floor(SIZES[0] * mean)), math.ceil(SIZES[1] * mean)


def interlocks(labels: Labels) -> bool:
    """Decide whether no plane separates the pieces, and two of them lock each other."""
    for axis in range(3):
        rows = np.moveaxis(labels, axis, 0)
        if (rows[1:] != rows[:-1]).all(axis=(1, 2)).any():
            return False
    names = np.unique(labels)
    return any(
        locked(labels == one, labels == other) >= MIN_LOCKED
        for n, one in enumerate(names)
        for other in names[:n]
    )


def locked(one: npt.NDArray[np.bool_], other: npt.NDArray[np.bool_]) -> int:
    """Count the directions, of six, in which a piece can't leave another by a straight move."""
    found = 0
    for axis in range(3):
        for way in (slice(None), slice(None, None, -1)):
            ours, theirs = (np.moveaxis(cubes, axis, 0)[way] for cubes in (one, other))
            found += bool((np.logical_or.accumulate(ours, axis=0) & theirs).any())
    return found


def joined_cubes(pieces: int, rng: np.random.Generator) -> Labels | None:
    """Join cubes until a number of pieces are left; None if that does not succeed."""
    labels = np.arange(CUBES**3).reshape(CUBES, CUBES, CUBES)
    min_cubes, max_cubes = sizes(pieces)
    left = CUBES**3
    while left > pieces:
        counts = np.bincount(labels.ravel())
        names = np.flatnonzero(counts)
        draws = dict(zip(names.tolist(), rng.random(len(names)).tolist(), strict=True))
        for label in sorted(draws, key=lambda name: (counts[name], draws[name])):
            joined = _with_neighbour(labels, label, counts, max_cubes, draws)
            if joined is not None:
                labels, left = joined, left - 1
                break
        else:
            return None
    counts = np.bincount(labels.ravel())
    return labels if counts[counts > 0].min() >= min_cubes else None


def _with_neighbour(
    labels: Labels, label: int, counts: Ints, max_cubes: int, draws: dict[int, float]
) -> Labels | None:
    """Join a piece with the first neighbour, in the order of `draws`, with which that is valid."""
    for other in sorted(_neighbours(labels, label), key=lambda name: draws[name]):
        if counts[label] + counts[other] > max_cubes:
            continue
        joined = np.where(labels == label, other, labels)
        if _is_manifold(joined == other) and _order(joined) is not None:
            return joined
    return None


def _neighbours(labels: Labels, label: int) -> set[int]:
    """Find the pieces that share a face with a piece."""
    found: set[int] = set()
    for axis in range(3):
        rows = np.moveaxis(labels, axis, 0)
        low, high = rows[:-1], rows[1:]
        found |= {*high[low == label].tolist(), *low[high == label].tolist()}
    return found - {label}


def _is_manifold(cubes: npt.NDArray[np.bool_]) -> bool:
    """Decide whether no two cubes of a piece share an edge, and no face on a way around it."""
    for axis in range(3):
        rows = np.moveaxis(cubes, axis, 0)
        a, b, c, d = rows[:, :-1, :-1], rows[:, 1:, 1:], rows[:, 1:, :-1], rows[:, :-1, 1:]
        if ((a & b & ~c & ~d) | (c & d & ~a & ~b)).any():
            return False
    return True


def _order(labels: Labels) -> list[int] | None:
    """Sort pieces so that none is below an earlier one; None if there is no such order."""
    below: dict[int, set[int]] = {int(label): set() for label in np.unique(labels)}
    low, high = labels[..., :-1], labels[..., 1:]
    differ = low != high
    for under, over in zip(low[differ].tolist(), high[differ].tolist(), strict=True):
        below[over].add(under)
    try:
        return list(TopologicalSorter(below).static_order())
    except CycleError:
        return None


def piece_of(cubes: npt.NDArray[np.bool_]) -> PuzzlePiece:
    """Return the surface of a piece, its faces drawn in by the clearance.

    The solid is divided at both sides of each plane between cubes: into the inner parts of cubes,
    and the gaps between them, which belong to the piece if all cubes around them do. Corners are
    then moved along the surface to the planes, as far as the surface is flat, so that gaps become
    triangles or vanish.
    """
    where = np.argwhere(cubes)
    start = where.min(axis=0)
    own = cubes[tuple(map(slice, start, where.max(axis=0) + 1))]
    for axis in range(3):
        rows = np.moveaxis(own, axis, 0)
        divided = np.empty((2 * len(rows) - 1, *rows.shape[1:]), dtype=bool)
        divided[::2], divided[1::2] = rows, rows[:-1] & rows[1:]
        own = np.moveaxis(divided, 0, axis)
    corners, normals = _squares(own)
    lines = corners.reshape(-1, 3)
    unique, names = np.unique(lines, axis=0, return_inverse=True)
    faces = names.reshape(-1, 4)
    bound = np.zeros((len(unique), 3), dtype=bool)
    bound[faces.ravel(), np.repeat(normals, 4)] = True
    side = np.where(unique % 2 == 0, CLEARANCE, -CLEARANCE)
    planes = (start + (unique + 1) // 2) * CUBE
    vertices = planes * STEP_UNITS + np.where(bound, side, 0)
    i, j, k = (start * CUBE).tolist()
    return PuzzlePiece("polycube", (i, j, k), *_merged(vertices, faces))


def _squares(solid: npt.NDArray[np.bool_]) -> tuple[Ints, Ints]:
    """Find the faces of a solid of cells: corners (m, 4, 3), and the axis of each normal (m,)."""
    padded = np.pad(solid, 1)
    corners, normals = [], []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        ring = np.zeros((4, 3), dtype=np.int64)
        ring[[1, 2], u] = 1
        ring[[2, 3], v] = 1
        for above in (0, 1):
            outside = np.roll(padded, 1 - 2 * above, axis)
            cells = np.argwhere(padded & ~outside) - 1
            cells[:, axis] += above
            corners.append(cells[:, None] + (ring if above else ring[::-1]))
            normals.append(np.full(len(cells), axis))
    return np.concatenate(corners), np.concatenate(normals)


def _merged(vertices: Ints, faces: Ints) -> tuple[Ints, Ints]:
    """Merge equal vertices; quadrilaterals become triangles, or vanish."""
    unique, names = np.unique(vertices, axis=0, return_inverse=True)
    rings = (list(dict.fromkeys(face)) for face in names.reshape(-1)[faces].tolist())
    kept = [ring + [NONE] * (4 - len(ring)) for ring in rings if len(ring) > 2]
    return unique, np.array(kept)
