"""The paper's heuristic with voxels instead of meshes, to isolate the value of exact collision.

Order, rotation, grid and bottom-left-back fill are those of "largest-first/aligned/blbf".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.peers.grids import Voxels, voxels
from benchmarks.peers.posed import Posed, largest_first
from benchmarks.peers.spectral import Metrics
from packit_sim import placement
from packit_sim.game.datasets.packs import Task
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import CELL, CELLS_PER_UNIT, STEP, Triple


@dataclass(frozen=True)
class VoxelHeuristic:
    """A packer of voxels.

    Parameters
    ----------
    side : int
        Side of a voxel in cells; a grid step is a multiple of it.
    sampled : bool
        Whether voxels are sampled or conservative (see `grids`).
    """

    side: int = 1
    sampled: bool = False

    @property
    def name(self) -> str:
        rule = "sampled" if self.sampled else "conservative"
        return f"heuristic, voxels 1/{CELLS_PER_UNIT // self.side}, {rule}"

    def pack(self, task: Task) -> list[Posed]:
        """Place every item that fits."""
        x, y, z = (size // self.side for size in task.cells)
        filled = np.zeros((x, y, z), dtype=bool)
        packed = []
        for item in largest_first(task):
            turned = item.turned(rotations.aligned(item.shape.extents))
            own = rotations.turn_array(voxels(item, self.side, self.sampled), turned.rotation)
            start = self._first(filled, own)
            if start is None:
                continue
            filled[tuple(slice(s, s + n) for s, n in zip(start, own.shape, strict=True))] |= own
            centre = (np.array(start) + np.array(own.shape) / 2) * self.side * CELL
            packed.append(Posed(turned, centre))
        return packed

    def _first(self, filled: Voxels, own: Voxels) -> Triple | None:
        """Find the first grid node without collision in (z, x, y) order, in voxels."""
        if any(n > size for n, size in zip(own.shape, filled.shape, strict=True)):
            return None
        metrics = Metrics(filled)
        step = STEP // self.side
        shared = metrics.collisions(metrics.spectrum(own), own.shape)[::step, ::step, ::step]
        node = placement.first(shared < 0.5)
        return None if node is None else (node[0] * step, node[1] * step, node[2] * step)
