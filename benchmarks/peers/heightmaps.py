"""A heightmap packer: items move straight down, to where the heightmap grows least.

Wang and Hauser, "Stable Bin Packing of Non-convex 3D Objects with a Robot Manipulator", ICRA 2019:
their heightmap minimisation, by top and bottom heightmaps of the items. A small implementation of
our own, without their tests of stability and of reachability by a robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.peers.grids import profile_turned, profiles
from benchmarks.peers.posed import ALL_ROTATIONS, Posed, largest_first
from packit_sim.core.compilation import kernel
from packit_sim.game.datasets.packs import Task
from packit_sim.geometry.arrays import Ints
from packit_sim.geometry.lattice import CELL, FINE, FINE_PER_CELL, Triple
from packit_sim.geometry.shapes import Item


@dataclass(frozen=True)
class Heightmaps:
    """A packer whose pixels are cells, and whose heights are whole fine cells.

    Parameters
    ----------
    sampled : bool
        Whether heights are taken at the pixels' centres, as a depth camera does, instead of the
        largest in each pixel.
    turns : tuple[int, ...]
        The rotations to try; the best pixel of all of them is chosen.
    """

    sampled: bool = False
    turns: tuple[int, ...] = ALL_ROTATIONS

    @property
    def name(self) -> str:
        return f"heightmaps, {'sampled' if self.sampled else 'conservative'}"

    def pack(self, task: Task) -> list[Posed]:
        """Place every item that fits."""
        x, y, z = task.cells
        heights = np.zeros((x, y), dtype=np.int64)
        packed = []
        for item in largest_first(task):
            found = self._lowest(heights, z * FINE_PER_CELL, item)
            if found is None:
                continue
            turned, (i, j, rest), columns = found
            heights[i + columns[:, 0], j + columns[:, 1]] = rest + columns[:, 3]
            start = np.array((i * CELL, j * CELL, rest * FINE))
            packed.append(Posed(turned, start + np.array(turned.cells) / 2 * CELL))
        return packed

    def _lowest(self, heights: Ints, top: int, item: Item) -> tuple[Item, Triple, Ints] | None:
        """Find the rotated item, its min corner (pixels; fine cells in z) and its columns."""
        upright = profiles(item, self.sampled)
        best, found = np.inf, None
        for turn in self.turns:
            turned = item.turned(turn)
            nx, ny = (
                size - own + 1 for size, own in zip(heights.shape, turned.cells, strict=False)
            )
            columns = _columns(profile_turned(upright, turn))
            if nx < 1 or ny < 1:
                continue
            rests, growth = _drop(heights, columns, np.array((nx, ny)))
            fits = rests + turned.cells[2] * FINE_PER_CELL <= top
            if not fits.any():
                continue
            corner = np.add.outer(np.arange(nx), np.arange(ny)) / (nx + ny)  # breaks ties
            cost = np.where(fits, growth + corner, np.inf)
            if cost.min() < best:
                best = float(cost.min())
                i, j = (int(n) for n in np.unravel_index(cost.argmin(), cost.shape))
                found = turned, (i, j, int(rests[i, j])), columns
        return found


def _columns(profile: npt.NDArray[np.bool_]) -> Ints:
    """List x, y, bottom and top of each filled column, (n, 4), in fine cells along z."""
    x, y = np.nonzero(profile.any(axis=2))
    low = profile.argmax(axis=2)[x, y]
    top = profile.shape[2] - profile[:, :, ::-1].argmax(axis=2)[x, y]
    return np.column_stack((x, y, low, top)).astype(np.int64)


@kernel
def _drop(heights: Ints, columns: Ints, places: Ints) -> tuple[Ints, Ints]:
    """Compute where an item comes to rest at each place (x, y), and the heightmap's growth."""
    rests = np.zeros((places[0], places[1]), np.int64)
    growth = np.zeros((places[0], places[1]), np.int64)
    for n in range(len(columns)):
        x, y, low, top = columns[n]
        for i in range(places[0]):
            for j in range(places[1]):
                height = heights[i + x, j + y]
                rests[i, j] = max(rests[i, j], height - low)
                growth[i, j] += top - height
    growth += rests * len(columns)
    return rests, growth
