"""Pieces of packed items, divided and cut back where they reach into another item.

Packed items stand within 1e-4 of each other, and pieces fill what is a little hollow: at the start
they would overlap by up to a hundredth of an item, and a simulation would drive them apart. Some
fill a cavity, whose way in is a gap so narrow that voxels close it, and in which items may stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from packit_sim.physics.convex.pieces import Floats, Piece, clipped, meets

Part = tuple[Piece, float]
"""A piece, and how far it reaches out of its shape."""

DEEP = 0.01
"""Box units by which a surface may be deeper in another item's piece than the piece reaches out of
its shape: voxels, which tell that, are coarse."""

_HALVINGS = 5
"""Of a piece that fills what is hollow, at most."""


def fitted(items: Sequence[Sequence[Part]], surfaces: Sequence[Floats]) -> list[list[Piece]]:
    """The pieces of items, all in one frame, of which none overlaps one of another item.

    surfaces: of each item the triangles (m, 3, 3). A piece in which another's surface is deep (see
    `DEEP`) was taken for solid where it is hollow: halves of its own surface take its place, and
    halves of these. Of two pieces that overlap after that, both are cut at a plane along a face of
    either, the one that takes least away; it is shared out as they reach out of their shapes, so
    that what is as large as its shape stays whole. A piece that is all beyond the plane is dropped;
    an item that would lose its last one keeps them all.
    """
    whole = _divided(items, surfaces)
    kept = [list(parts) for parts in whole]
    for one, other in combinations(range(len(kept)), 2):
        _part(kept[one], kept[other])
    return [[piece for piece, _ in own or all_of] for own, all_of in zip(kept, whole, strict=True)]


def _divided(items: Sequence[Sequence[Part]], surfaces: Sequence[Floats]) -> list[Sequence[Part]]:
    """The pieces of items, in which no other's surface is deep, or which were halved to the end."""
    ends = [(surface.min(axis=(0, 1)), surface.max(axis=(0, 1))) for surface in surfaces]
    found: list[Sequence[Part]] = []
    for n, parts in enumerate(items):
        (low, high), own = ends[n], surfaces[n]
        foreign = [
            surface[meets(surface, low, high)]
            for other, surface in enumerate(surfaces)
            if other != n and (ends[other][0] < high).all() and (ends[other][1] > low).all()
        ]
        strange = np.concatenate([np.empty((0, 3, 3)), *foreign])
        found.append([half for part in parts for half in _halves(part, own, strange, _HALVINGS)])
    return found


def _halves(part: Part, own: Floats, strange: Floats, left: int) -> list[Part]:
    """What takes a piece's place. own, strange: triangles of its item's surface, and of others'."""
    piece, out = part
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    strange = strange[meets(strange, low, high)]
    inner = piece.planes + np.array((0, 0, 0, out + DEEP))
    if not len(strange) or not len(clipped(strange, inner)):
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
            found += _halves((Piece.around(points), out), own, strange, left - 1)
    return found


def _part(ones: list[Part], others: list[Part]) -> None:
    """Cuts the pieces of two items, in place, so that none overlaps one of the other's."""
    left: list[Part | None] = [*ones]
    right: list[Part | None] = [*others]
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


def _cut(piece: Piece, out: float, normal: Floats, offset: float) -> Part | None:
    rest = piece.cut(normal, offset)
    return None if rest is None else (rest, out)


def _near(ones: Sequence[Part], others: Sequence[Part]) -> npt.NDArray[np.bool_]:
    """Bool (n, m): whether the bounding boxes of two pieces overlap."""
    low, high, other_low, other_high = (
        np.array([end(piece.vertices, axis=0) for piece, _ in parts]).reshape(-1, 3)
        for parts in (ones, others)
        for end in (np.min, np.max)
    )
    overlap = (low[:, None] < other_high) & (high[:, None] > other_low)
    return np.asarray(overlap.all(axis=2))


def _least_overlap(one: Piece, other: Piece) -> tuple[Floats, float, float]:
    """A unit normal (3,) from one to the other, how far one reaches along it, and how far the other
    reaches back from there: 0 or less where a face of either parts them.
    """
    normals = np.concatenate((one.planes[:, :3], -other.planes[:, :3]))
    high = (one.vertices @ normals.T).max(axis=0)
    depths = high - (other.vertices @ normals.T).min(axis=0)
    least = int(np.argmin(depths))
    return normals[least], float(high[least]), float(depths[least])
