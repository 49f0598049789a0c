"""Convex pieces of packed items, divided and cut so that those of different items don't overlap.

Packed items are within 1e-4 of each other, and pieces fill shallow hollows: at the start of a
simulation they would overlap by up to a hundredth of an item, and be driven apart. Some pieces fill
a cavity with an opening so narrow that voxels close it, and other items may be in that cavity.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats
from packit_sim.physics.convex.pieces import Piece, clipped, meets

MeasuredPiece = tuple[Piece, float]
"""A piece, and its one-sided Hausdorff distance from its shape."""

DEEP = 0.01
"""Box units by which a surface may be deeper in another item's piece than the piece's distance from
its shape, which is measured by coarse voxels."""

_HALVINGS = 5
"""Largest number of successive halvings of a piece that fills a cavity."""


def fitted(
    items: Sequence[Sequence[MeasuredPiece]], surfaces: Sequence[Floats]
) -> list[list[Piece]]:
    """Divide and cut the pieces of items so that no two of different items overlap.

    Parameters
    ----------
    items : Sequence[Sequence[MeasuredPiece]]
        The pieces of each item, all in one frame, with their distances from the shapes.
    surfaces : Sequence[ndarray]
        Triangles (m, 3, 3) of each item.

    Returns
    -------
    list[list[Piece]]
        The pieces of each item. An item that would lose all of its pieces keeps all.

    Notes
    -----
    If another item's surface is deep in a piece (see `DEEP`), the piece fills a cavity: it is
    replaced by the hulls of its item's surface in both halves, and so on. If two pieces still
    overlap, both are cut parallel to a face of either, the one with the least overlap. The overlap
    is divided in proportion to their distances from their shapes, so that a piece that does not
    protrude stays whole. A piece that is completely cut off is dropped.
    """
    whole = _divided(items, surfaces)
    kept = [list(parts) for parts in whole]
    for one, other in combinations(range(len(kept)), 2):
        _part(kept[one], kept[other])
    return [[piece for piece, _ in own or all_of] for own, all_of in zip(kept, whole, strict=True)]


def _divided(
    items: Sequence[Sequence[MeasuredPiece]], surfaces: Sequence[Floats]
) -> list[Sequence[MeasuredPiece]]:
    """Replace the pieces of items in which another item's surface is deep by smaller ones."""
    ends = [(surface.min(axis=(0, 1)), surface.max(axis=(0, 1))) for surface in surfaces]
    found: list[Sequence[MeasuredPiece]] = []
    for n, parts in enumerate(items):
        (low, high), own = ends[n], surfaces[n]
        others = [
            surface[meets(surface, low, high)]
            for other, surface in enumerate(surfaces)
            if other != n and (ends[other][0] < high).all() and (ends[other][1] > low).all()
        ]
        foreign = np.concatenate([np.empty((0, 3, 3)), *others])
        found.append([half for part in parts for half in _halves(part, own, foreign, _HALVINGS)])
    return found


def _halves(part: MeasuredPiece, own: Floats, foreign: Floats, left: int) -> list[MeasuredPiece]:
    """Return what replaces a piece. own, foreign: triangles of its item, and of others."""
    piece, out = part
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    foreign = foreign[meets(foreign, low, high)]
    inner = piece.planes + np.array((0, 0, 0, out + DEEP))
    if not len(foreign) or not len(clipped(foreign, inner)):
        return [part]
    axis = int(np.argmax(high - low))
    if not left:
        return [(piece, float(high[axis] - low[axis]))]
    own = own[meets(own, low, high)]
    middle = (low[axis] + high[axis]) / 2
    found = []
    for side in (1, -1):
        half = np.append(side * np.eye(3)[axis], -side * middle)
        points = clipped(own, np.vstack((piece.planes, half)))
        if len(points):
            found += _halves((Piece.around(points), out), own, foreign, left - 1)
    return found


def _part(ones: list[MeasuredPiece], others: list[MeasuredPiece]) -> None:
    """Cut the pieces of two items, in place, so that none overlaps one of the other item."""
    left: list[MeasuredPiece | None] = [*ones]
    right: list[MeasuredPiece | None] = [*others]
    for i, j in np.argwhere(_near(ones, others)).tolist():
        here, there = left[i], right[j]
        if here is None or there is None:
            continue
        (one, out), (other, other_out) = here, there
        normal, high, depth = _least_overlap(one, other)
        if depth > 0:
            at = high - depth * (out / (out + other_out) if out + other_out else 0.5)
            left[i] = _cut(one, out, normal, -at)
            right[j] = _cut(other, other_out, -normal, at)
    ones[:] = [part for part in left if part is not None]
    others[:] = [part for part in right if part is not None]


def _cut(piece: Piece, out: float, normal: Floats, offset: float) -> MeasuredPiece | None:
    rest = piece.cut(normal, offset)
    return None if rest is None else (rest, out)


def _near(ones: Sequence[MeasuredPiece], others: Sequence[MeasuredPiece]) -> npt.NDArray[np.bool_]:
    """Return bool (n, m): whether the bounding boxes of two pieces overlap."""
    low, high, other_low, other_high = (
        np.array([end(piece.vertices, axis=0) for piece, _ in parts]).reshape(-1, 3)
        for parts in (ones, others)
        for end in (np.min, np.max)
    )
    overlap = (low[:, None] < other_high) & (high[:, None] > other_low)
    return np.asarray(overlap.all(axis=2))


def _least_overlap(one: Piece, other: Piece) -> tuple[Floats, float, float]:
    """Find the face normal of either piece along which they overlap least.

    Returns the unit normal (3,) from one to the other, the highest coordinate of one along it, and
    the depth of the overlap, 0 or less if a face separates them.
    """
    normals = np.concatenate((one.planes[:, :3], -other.planes[:, :3]))
    high = (one.vertices @ normals.T).max(axis=0)
    depths = high - (other.vertices @ normals.T).min(axis=0)
    least = int(np.argmin(depths))
    return normals[least], float(high[least]), float(depths[least])
