"""Convex pieces of packed items, divided and cut so that those of different items don't overlap.

Packed items are within 1e-4 of each other, and pieces fill shallow hollows: at the start of a
simulation they would overlap by up to a hundredth of an item, and be driven apart. Some pieces fill
a cavity with an opening so narrow that voxels close it, and other items may be in that cavity.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import cached_property
from packit_sim.geometry.arrays import Floats
from packit_sim.physics.convex.pieces import Piece, clipped, meets

MeasuredPiece = tuple[Piece, float]
"""A piece, and its one-sided Hausdorff distance from its shape."""

DEEP = 0.01
"""Box units by which a surface may be deeper in another item's piece than the piece's distance from
its shape, which is measured by coarse voxels."""

_HALVINGS = 5
"""Largest number of successive halvings of a piece that fills a cavity."""


@dataclass(eq=False)
class FittedItems:
    """The pieces of items, divided and cut so that no two of different items overlap.

    Attributes
    ----------
    divided : list of list of MeasuredPiece
        The pieces of each item, all in one frame, with their distances from the shapes. Those in
        which another item's surface is deep are replaced by smaller ones.
    surfaces : sequence of ndarray
        Triangles (m, 3, 3) of each item.

    Notes
    -----
    If another item's surface is deep in a piece (see `DEEP`), the piece fills a cavity: it is
    replaced by the hulls of its item's surface in both halves, and so on. If two pieces still
    overlap, both are cut parallel to a face of either, the one with the least overlap. The overlap
    is divided in proportion to their distances from their shapes, so that a piece that does not
    protrude stays whole. A piece that is completely cut off is dropped.
    """

    divided: list[list[MeasuredPiece]]
    surfaces: Sequence[Floats]

    @classmethod
    def of(
        cls, items: Sequence[Sequence[MeasuredPiece]], surfaces: Sequence[Floats]
    ) -> FittedItems:
        """Fit items, of which the pieces are as they were before they were divided."""
        ends, numbers = _ends(surfaces), range(len(items))
        divided = [_divided(items[n], n, surfaces, ends, numbers) for n in numbers]
        return cls(divided, surfaces)

    @classmethod
    def kept(
        cls, items: Sequence[Sequence[MeasuredPiece]], surfaces: Sequence[Floats]
    ) -> FittedItems:
        """Take the pieces of items as they were fitted before, wherever the items are now."""
        found = cls([list(parts) for parts in items], surfaces)
        found._cut = [list(parts) for parts in items]
        return found

    @property
    def measured(self) -> list[list[MeasuredPiece]]:
        """The pieces of each item, with their distances from the shapes before they were cut.

        An item that would lose all of its pieces keeps all.
        """
        return [own or all_of for own, all_of in zip(self._cut, self.divided, strict=True)]

    @cached_property
    def pieces(self) -> list[list[Piece]]:
        """The pieces of each item, without the distances."""
        return [[piece for piece, _ in parts] for parts in self.measured]

    def with_one(self, items: Sequence[Sequence[MeasuredPiece]], surface: Floats) -> FittedItems:
        """Fit one more item: the result is the same as if all were fitted together.

        Parameters
        ----------
        items : sequence of sequence of MeasuredPiece
            The pieces of the items as they were before they were divided, and last the new one's.
        surface : ndarray
            Triangles (m, 3, 3) of the new item.

        Returns
        -------
        FittedItems
            All items.
        """
        surfaces, new = [*self.surfaces, surface], len(self.surfaces)
        ends = _ends(surfaces)
        divided = [
            parts
            if _divided(parts, n, surfaces, ends, (new,)) == parts
            else _divided(items[n], n, surfaces, ends, range(new + 1))
            for n, parts in enumerate(self.divided)
        ]
        divided.append(_divided(items[new], new, surfaces, ends, range(new)))
        found = FittedItems(divided, surfaces)
        if divided[:new] == self.divided:  # only what meets the new item is cut once more
            found._cut = [*map(list, self._cut), list(divided[new])]
            for parts in found._cut[:new]:
                _part(parts, found._cut[new])
        return found

    @cached_property
    def _cut(self) -> list[list[MeasuredPiece]]:
        kept = [list(parts) for parts in self.divided]
        for one, other in combinations(kept, 2):
            _part(one, other)
        return kept


def _ends(surfaces: Sequence[Floats]) -> list[tuple[Floats, Floats]]:
    return [(surface.min(axis=(0, 1)), surface.max(axis=(0, 1))) for surface in surfaces]


def _divided(
    parts: Sequence[MeasuredPiece],
    n: int,
    surfaces: Sequence[Floats],
    ends: Sequence[tuple[Floats, Floats]],
    others: Iterable[int],
) -> list[MeasuredPiece]:
    """Replace the pieces of item n in which the surface of one of others is deep by smaller ones.

    ends: the low and the high corner of each surface.
    """
    (low, high), own = ends[n], surfaces[n]
    near = [
        surfaces[other][meets(surfaces[other], low, high)]
        for other in others
        if other != n and (ends[other][0] < high).all() and (ends[other][1] > low).all()
    ]
    foreign = np.concatenate([np.empty((0, 3, 3)), *near])
    return [half for part in parts for half in _halves(part, own, foreign, _HALVINGS)]


def _halves(part: MeasuredPiece, own: Floats, foreign: Floats, left: int) -> list[MeasuredPiece]:
    """Return what replaces a piece. own, foreign: triangles of its item, and of others."""
    piece, out = part
    low, high = piece.ends
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
        np.array([piece.ends[end] for piece, _ in parts]).reshape(-1, 3)
        for parts in (ones, others)
        for end in (0, 1)
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
