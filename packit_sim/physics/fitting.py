"""Pieces of packed items, cut back where they reach into another item's.

Packed items stand within 1e-4 of each other, and pieces fill what is a little hollow: at the start
they would overlap by up to a hundredth of an item, and a simulation would drive them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from packit_sim.physics.pieces import Floats, Piece

Part = tuple[Piece, float]
"""A piece, and how far it reaches out of its shape."""


def fitted(items: Sequence[Sequence[Part]]) -> list[list[Piece]]:
    """The pieces of items, all in one frame, of which none overlaps one of another item.

    Of two that do, both are cut at a plane along a face of either, the one that takes least away;
    it is shared out as they reach out of their shapes, so that what is as large as its shape stays
    whole. A piece that is all beyond the plane is dropped; an item that would lose its last one
    keeps them all.
    """
    kept = [list(parts) for parts in items]
    for one, other in combinations(range(len(kept)), 2):
        _part(kept[one], kept[other])
    return [[piece for piece, _ in own or whole] for own, whole in zip(kept, items, strict=True)]


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
