"""Placed items, and the fine cells of a box that they fill."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
import numpy.typing as npt

from packit_sim.lattice import CELL, STEP, Triple
from packit_sim.shapes import Item
from packit_sim.voxels import Words

_1 = np.uint64(1)


@dataclass(frozen=True)
class Placed:
    """An item at a location: the min corner of its cell box stands at grid node (i, j, k)."""

    item: Item
    location: Triple

    @property
    def start(self) -> Triple:
        """The min corner of the cell box, in cells."""
        i, j, k = self.location
        return i * STEP, j * STEP, k * STEP

    @property
    def stop(self) -> Triple:
        """The max corner of the cell box, in cells."""
        (x, y, z), (a, b, c) = self.start, self.item.cells
        return x + a, y + b, z + c

    @cached_property
    def center(self) -> npt.NDArray[np.float64]:
        """(3,) where the centre of the item's bounding box stands, in box units."""
        return (np.array(self.start) + np.array(self.stop)) / 2 * CELL

    @cached_property
    def pose(self) -> npt.NDArray[np.float64]:
        """(4, 4) shape-to-box matrix: puts the canonical mesh, `item.shape.mesh`, in its place."""
        pose = np.eye(4)
        pose[:3, :3] = self.item.linear
        pose[:3, 3] = self.center
        return pose


class Occupancy:
    """The fine cells of a box that placed items fill: a cache, rebuilt from `placed` at any time.

    outer, inner: words [x, y, z] over the box's cells, the union over the placed items.
    filled: a bit for each cell in C order, set where it holds an outer fine cell; small enough to
    stay in the processor's cache, and nine of ten questions end there.
    """

    def __init__(self, cells: Triple) -> None:
        self.cells = cells
        self.outer: Words = np.zeros(cells, dtype=np.uint64)
        self.inner: Words = np.zeros(cells, dtype=np.uint64)
        self.filled: Words = np.zeros(-(-math.prod(cells) // 64), dtype=np.uint64)
        self._placed: list[Placed] = []
        self._own_outer: list[Words] = []
        self._spans = np.zeros((0, 6), dtype=np.int64)

    @property
    def placed(self) -> tuple[Placed, ...]:
        return tuple(self._placed)

    @property
    def spans(self) -> npt.NDArray[np.int64]:
        """(n, 6): the cell box of each placed item, min and max corner in cells."""
        return self._spans[: len(self._placed)]

    def add(self, placed: Placed) -> None:
        """Fills the cells of an item. Whether it is feasible there was checked before."""
        voxels = placed.item.voxels
        self._fill(placed)
        own = np.zeros(voxels.cells, dtype=np.uint64)
        own[tuple(voxels.coords.T)] = voxels.outer
        self._own_outer.append(own)
        count = len(self._placed)
        if count == len(self._spans):
            self._spans = np.concatenate([self._spans, np.zeros((count + 8, 6), dtype=np.int64)])
        self._spans[count] = (*placed.start, *placed.stop)
        self._placed.append(placed)

    def truncate(self, count: int) -> None:
        """Takes out all but the first `count` items."""
        removed = self._placed[count:]
        del self._placed[count:], self._own_outer[count:]
        for gone in removed:
            _clear(self.outer, self.inner, self.filled, gone.item.voxels.coords, gone.start)
        for kept in self._placed:
            if any(_overlap(kept.start, kept.stop, gone.start, gone.stop) for gone in removed):
                self._fill(kept)

    def touching(self, candidate: Placed) -> Iterator[Placed]:
        """The placed items of which an outer fine cell is one of the candidate's too."""
        voxels, start = candidate.item.voxels, candidate.start
        for other, own_outer in zip(self._placed, self._own_outer, strict=True):
            if _overlap(start, candidate.stop, other.start, other.stop) and _meets(
                own_outer, other.start, voxels.coords, voxels.outer, start
            ):
                yield other

    def _fill(self, placed: Placed) -> None:
        voxels = placed.item.voxels
        _fill(
            self.outer,
            self.inner,
            self.filled,
            voxels.coords,
            voxels.outer,
            voxels.inner,
            placed.start,
        )


def _overlap(start: Triple, stop: Triple, other_start: Triple, other_stop: Triple) -> bool:
    return all(
        a < d and c < b for a, b, c, d in zip(start, stop, other_start, other_stop, strict=True)
    )


@numba.njit(cache=True, nogil=True)
def _fill(box_outer, box_inner, filled, coords, outer, inner, start):
    _, size_y, size_z = box_outer.shape
    for n in range(len(coords)):
        x, y, z = coords[n, 0] + start[0], coords[n, 1] + start[1], coords[n, 2] + start[2]
        box_outer[x, y, z] |= outer[n]
        box_inner[x, y, z] |= inner[n]
        at = (x * size_y + y) * size_z + z
        filled[at >> 6] |= _1 << np.uint64(at & 63)


@numba.njit(cache=True, nogil=True)
def _clear(box_outer, box_inner, filled, coords, start):
    _, size_y, size_z = box_outer.shape
    for n in range(len(coords)):
        x, y, z = coords[n, 0] + start[0], coords[n, 1] + start[1], coords[n, 2] + start[2]
        box_outer[x, y, z] = 0
        box_inner[x, y, z] = 0
        at = (x * size_y + y) * size_z + z
        filled[at >> 6] &= ~(_1 << np.uint64(at & 63))


@numba.njit(cache=True, nogil=True)
def _meets(own_outer, own_start, coords, outer, start):
    """Whether an outer fine cell of one item, dense, is one of another's, a list."""
    for n in range(len(coords)):
        x = coords[n, 0] + start[0] - own_start[0]
        y = coords[n, 1] + start[1] - own_start[1]
        z = coords[n, 2] + start[2] - own_start[2]
        if (
            0 <= x < own_outer.shape[0]
            and 0 <= y < own_outer.shape[1]
            and 0 <= z < own_outer.shape[2]
            and own_outer[x, y, z] & outer[n]
        ):
            return True
    return False
