"""A voxel packer by Fourier transforms, in the manner of spectral packing.

Cui, Rong, Chen and Matusik, "Dense, Interlocking-Free and Scalable Spectral Packing of Generic 3D
Objects", SIGGRAPH 2023. Items are placed one after the other, largest first. For each item,
correlations of its voxels with the box's give the number of colliding voxels and the proximity to
filled voxels at all offsets at once. The item is placed at the nearest offset without collision,
with a penalty for height.

A small implementation of our own, without the test that an item can be removed again (a flood fill
through free offsets), orientations off the axes, adaptive resolution, and GPU support.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
from scipy import ndimage

from benchmarks.peers.grids import Voxels, voxels
from benchmarks.peers.posed import AXIS_ORDERS, Posed, largest_first
from packit_sim.core.caches import cached_property
from packit_sim.game.datasets.packs import Task
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import CELL, CELLS_PER_UNIT, Triple
from packit_sim.geometry.shapes import Item

HEIGHT_WEIGHT = 10.0
"""Weight of the cube of an item's bottom height, relative to its mean distance from filled voxels,
both in box units. The paper's cost has such a term as well; on train packs weights from 0 to 100
gave the same result."""

Floats32 = npt.NDArray[np.float32]
Spectrum = npt.NDArray[np.complex64]


@dataclass(frozen=True)
class Spectral:
    """A packer by correlations of voxels.

    Parameters
    ----------
    side : int
        Side of a voxel, in cells.
    sampled : bool
        Whether voxels are sampled or conservative (see `grids`).
    turns : tuple[int, ...]
        The rotations to try; the cheapest offset of all of them is chosen.
    height_weight : float
        Weight of the height in the cost (see `HEIGHT_WEIGHT`).
    """

    side: int = 1
    sampled: bool = False
    turns: tuple[int, ...] = AXIS_ORDERS
    height_weight: float = HEIGHT_WEIGHT

    @property
    def name(self) -> str:
        rule = "sampled" if self.sampled else "conservative"
        return f"spectral 1/{CELLS_PER_UNIT // self.side}, {rule}"

    def pack(self, task: Task) -> list[Posed]:
        """Place every item that fits."""
        x, y, z = (size // self.side for size in task.cells)
        filled = np.zeros((x, y, z), dtype=bool)
        metrics = Metrics(filled)
        packed = []
        for item in largest_first(task):
            found = self._cheapest(metrics, item)
            if found is None:
                continue
            turn, offset, own = found
            window = tuple(slice(o, o + n) for o, n in zip(offset, own.shape, strict=True))
            assert not (filled[window] & own).any(), "the transforms lost a collision"
            filled[window] |= own
            metrics = Metrics(filled)
            centre = (np.array(offset) + np.array(own.shape) / 2) * self.side * CELL
            packed.append(Posed(item.turned(turn), centre))
        return packed

    def _cheapest(self, metrics: Metrics, item: Item) -> tuple[int, Triple, Voxels] | None:
        """Find the best rotation, the offset in voxels, and the rotated item's voxels."""
        upright = voxels(item, self.side, self.sampled)
        unit = self.side * CELL
        best, found = np.inf, None
        for turn in self.turns:
            own = rotations.turn_array(upright, turn)
            if any(n > size for n, size in zip(own.shape, metrics.shape, strict=True)):
                continue
            spectrum = metrics.spectrum(own)
            free = metrics.collisions(spectrum, own.shape) < 0.5
            if not free.any():
                continue
            distance = metrics.proximity(spectrum, own.shape) / max(int(own.sum()), 1)
            height = np.arange(free.shape[2]) * unit
            cost = np.where(free, distance * unit + self.height_weight * height**3, np.inf)
            if cost.min() < best:
                best = float(cost.min())
                i, j, k = (int(n) for n in np.unravel_index(cost.argmin(), cost.shape))
                found = turn, (i, j, k), own
        return found


class Metrics:
    """A box of voxels in the frequency domain.

    Items are no larger than the box, so that at offsets inside the box nothing wraps around, and
    the arrays need no padding. In single precision, counts of collisions are off by 0.1 at most
    (box of 100^3, items of 200,000 voxels). Axes are transformed one after the other, which saves
    the transforms of the item's empty lines and of unused offsets.

    Parameters
    ----------
    filled : Voxels
        Bool (x, y, z), the filled voxels of the box.

    Attributes
    ----------
    shape : Triple
        Number of voxels along each axis.
    """

    def __init__(self, filled: Voxels) -> None:
        x, y, z = filled.shape
        self.shape: Triple = (x, y, z)
        self._voxels = filled.copy()

    def spectrum(self, array: npt.NDArray[Any]) -> Spectrum:
        """Transform an array that is no larger than the box."""
        half = scipy.fft.rfft(array.astype(np.float32), self.shape[2], axis=2)
        for axis in (1, 0):
            half = scipy.fft.fft(half, self.shape[axis], axis=axis)
        return np.asarray(half)

    def collisions(self, item: Spectrum, size: tuple[int, ...]) -> Floats32:
        """Count an item's colliding voxels at each offset inside the box."""
        return self._correlation(self._filled, item, size)

    def proximity(self, item: Spectrum, size: tuple[int, ...]) -> Floats32:
        """Sum the distances of an item's voxels from filled voxels, at each offset."""
        return self._correlation(self._distances, item, size)

    @cached_property
    def _filled(self) -> Spectrum:
        return self.spectrum(self._voxels)

    @cached_property
    def _distances(self) -> Spectrum:
        return self.spectrum(distances(self._voxels))

    def _correlation(self, own: Spectrum, item: Spectrum, size: tuple[int, ...]) -> Floats32:
        x, y, z = (n - m + 1 for n, m in zip(self.shape, size, strict=True))
        sums = scipy.fft.ifft(own * np.conj(item), axis=0)[:x]
        sums = scipy.fft.ifft(sums, axis=1)[:, :y]
        return np.asarray(scipy.fft.irfft(sums, self.shape[2], axis=2)[:, :, :z])


def distances(filled: Voxels) -> npt.NDArray[np.int32]:
    """Compute each voxel's distance, in steps, from the nearest filled voxel, wall or floor."""
    free = np.pad(~filled, ((1, 1), (1, 1), (1, 0)), constant_values=False)
    steps = ndimage.distance_transform_cdt(free, metric="taxicab")
    return np.asarray(steps[1:-1, 1:-1, 1:])
