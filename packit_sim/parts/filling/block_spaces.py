"""The space for blocks in a container: its voxels in a frame, and which of them are blocked."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.filling.block_lattice_kernels import lattice_counts
from packit_sim.parts.nesting.voxel_sets import placed_voxels

FINENESS = 10
"""Voxels along the shortest side of the smallest block, and offsets along each side."""

MOST_VOXELS = 8_000_000

SLACK = 1e-3
"""Voxels by which blocks are made smaller, so that they do not reach into voxels they touch."""


def voxel_side(size: Floats, shortest: float) -> float:
    """Return the side of voxels for a space (3,) and the shortest side of a block."""
    return max(shortest / FINENESS, (float(size.prod()) / MOST_VOXELS) ** (1 / 3))


class BlockSpace:
    """A space in one of its frames, with the voxels that are blocked.

    Parameters
    ----------
    size : ndarray of float64, shape (3,)
        The sides of the space.
    frame : ndarray of float64, shape (3, 3)
        The frame: a rotation to the container.
    voxel : float
        The side of the voxels.
    """

    def __init__(self, size: Floats, frame: Floats, voxel: float) -> None:
        self._frame, self._voxel = frame, voxel
        corners = np.array(np.meshgrid(*([0.0, side] for side in size))).reshape(3, -1).T @ frame
        self._low = corners.min(axis=0)
        self._sides = np.ptp(corners, axis=0)
        shape = np.ceil(self._sides / voxel - 1e-6).astype(int)
        self._blocked = np.zeros(shape, bool)
        self._sums: Ints | None = None
        if not np.array_equal(frame, np.eye(3)):
            self._block_outside(size)

    def copy(self) -> BlockSpace:
        """Return a copy, whose voxels can be blocked."""
        new = object.__new__(BlockSpace)
        vars(new).update(vars(self), _blocked=self._blocked.copy())
        return new

    def _block_outside(self, size: Floats) -> None:
        """Block the voxels that are not wholly inside the space, of which the frame is turned."""
        axes = [(np.arange(n) + 0.5) * self._voxel for n in self._blocked.shape]
        x, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
        for row, side in zip(self._frame, size, strict=True):
            middle = row @ self._low + row[0] * x + row[1] * y + row[2] * z
            reach = (0.5 - SLACK) * self._voxel * np.abs(row).sum()
            self._blocked |= (middle < reach) | (middle > side - reach)

    def block_body(self, triangles: Floats, grow: float) -> None:
        """Block the voxels of a body but for those that it only touches from one side.

        Those are free if the body moves a little away from them, one way or the opposite one.
        """
        masks = []
        for shift in (SLACK * self._voxel, -SLACK * self._voxel):
            moved = self.copy()
            moved._blocked[:] = False
            moved.block(triangles + self._frame @ np.full(3, shift), grow)
            masks.append(moved._blocked)
        self._blocked |= masks[0] & masks[1]
        self._sums = None

    def block(self, triangles: Floats, grow: float) -> None:
        """Block the voxels that a body touches or encloses, grown by a length."""
        if not len(triangles):
            return
        low, voxels = placed_voxels(triangles @ self._frame - self._low, self._voxel, grow)
        start = np.maximum(low, 0)
        end = np.minimum(low + voxels.shape, self._blocked.shape)
        if (start < end).all():
            there = tuple(map(slice, start, end))
            self._blocked[there] |= voxels[tuple(map(slice, start - low, end - low))] > 0
            self._sums = None

    @property
    def voxel(self) -> float:
        """The side of the voxels."""
        return self._voxel

    @property
    def blocked(self) -> npt.NDArray[np.bool_]:
        """The voxels (x, y, z) that are blocked."""
        return self._blocked

    def best_offset(self, sides: Floats, pitches: Floats) -> tuple[Floats, int]:
        """Return the offset of a lattice of most free boxes, and how many that are."""
        if self._sums is None:
            sums = self._blocked.astype(np.int32)
            for axis in range(3):
                sums = sums.cumsum(axis=axis, dtype=np.int32)
            self._sums = np.pad(sums, ((1, 0), (1, 0), (1, 0)))
        steps = np.full(3, FINENESS, np.int64)
        slack = 2 * SLACK * self._voxel
        counts = lattice_counts(self._sums, self._voxel, self._sides, sides, pitches, steps, slack)
        best = np.array(np.unravel_index(counts.argmax(), counts.shape))
        return pitches * best / steps, int(counts.max())

    def free(self, sides: Floats, pitches: Floats, offset: Floats) -> Floats:
        """Return the lower corners (n, 3) of the free boxes of a lattice, from the bottom up."""
        slack = 2 * SLACK * self._voxel
        axes = [
            np.arange(low, whole - side + slack, pitch)
            for low, whole, side, pitch in zip(offset, self._sides, sides, pitches, strict=True)
        ]
        z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
        places = np.column_stack((x.ravel(), y.ravel(), z.ravel()))
        first = np.maximum((places + slack) / self._voxel, 0).astype(int)
        last = np.ceil((places + sides - slack) / self._voxel).astype(int)
        last = np.minimum(last, self._blocked.shape)
        free = [
            not self._blocked[tuple(map(slice, a, b))].any()
            for a, b in zip(first, last, strict=True)
        ]
        return np.asarray(places[free] + self._low)
