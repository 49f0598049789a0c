"""The cells of an item, as bits on two levels: bricks of cells, and cells of fine cells.

A brick is one grid step an axis: 4 x 4 x 4 cells, one word, as a cell's fine cells are. Items stand
on the grid's nodes, so the bricks of any two in a box line up, and so do their cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import cached_property
from packit_sim.geometry import rotations
from packit_sim.geometry.bits import (
    Words,
    turning_swaps,
)
from packit_sim.geometry.lattice import FINE_PER_CELL, STEP, Triple
from packit_sim.geometry.voxel_kernels import (
    FixedArrays,
    ItemArrays,
    brick_arrays,
    spread_words,
    turn_bricks,
)
from packit_sim.geometry.voxelization import fine_cells, lattice_cells


@dataclass(frozen=True, eq=False)
class Voxels:
    """The bricks of an item that hold an outer cell, in a shuffled order, and their fine cells.

    Shuffled, because neighbours tell the same: a scan that may stop early meets what differs soon.

    cells: cells an axis of the cell box. bricks: (n, 3) int16, each brick's place in the cell box,
    in grid steps. outer, inner: (n,) words, a bit for each cell that is outer, or inner (DESIGN).
    first: (n + 1,) int32, where the brick's part of `fine` starts, and stops.
    fine: (m, 2) words, the outer and the inner fine cells of each cell that is outer but not inner,
    by brick, and by bit in it. number: int32 [x, y, z], the brick at a place, -1 for none.
    """

    cells: Triple
    bricks: npt.NDArray[np.int16]
    outer: Words
    inner: Words
    first: npt.NDArray[np.int32]
    fine: Words
    number: npt.NDArray[np.int32]

    @classmethod
    def of(cls, triangles: npt.NDArray[np.float64], cells: Triple) -> Voxels:
        """Of a surface in its cell box, which is centred on the origin.

        triangles: (n, 3, 3) corners in box units. Raises ValueError where the cell box is too
        large (see `voxelization.fine_cells`).
        """
        return cls(cells, *brick_arrays(*fine_cells(triangles, cells)))

    @classmethod
    def in_box(cls, triangles: npt.NDArray[np.float64], cells: Triple) -> tuple[Triple, Voxels]:
        """Of a surface anywhere: the part that is in a box of so many cells, and where it begins.

        triangles: (n, 3, 3) corners in box units. What is enclosed, the whole surface says. The
        part begins at a grid node, (i, j, k); where nothing is in the box it has no cells. Raises
        ValueError where the surface is too large (see `voxelization.fine_cells`).
        """
        start, touched, reached = lattice_cells(triangles)
        low = np.clip(start, 0, cells)
        high = np.clip(start + touched.shape, low, cells)
        part = tuple(map(slice, low - start, high - start))
        x, y, z = (high - low).tolist()
        i, j, k = (low // STEP).tolist()
        arrays = brick_arrays(
            np.ascontiguousarray(touched[part]), np.ascontiguousarray(reached[part])
        )
        return (i, j, k), cls((x, y, z), *arrays)

    @property
    def nbytes(self) -> int:
        arrays = (self.bricks, self.outer, self.inner, self.first, self.fine, self.number)
        return sum(array.nbytes for array in arrays)

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """The fields of the item's `ItemArrays`."""
        return tuple(ItemArrays(self.bricks, self.outer, self.inner, self.first, self.fine))

    @cached_property
    def fixed_arrays(self) -> tuple[Any, ...]:
        """The fields of the item's `FixedArrays`."""
        return tuple(FixedArrays(self.number, self.outer, self.inner, self.first, self.fine))

    def turned(self, rotation: int) -> Voxels:
        """The same under one of the 24 rotations, bit for bit."""
        axes, signs = rotations.AXES[rotation], rotations.SIGNS[rotation]
        x, y, z = (self.cells[axis] for axis in axes.tolist())
        swaps = turning_swaps(rotation)
        return Voxels(
            (x, y, z),
            *turn_bricks(self.arrays, np.array((x, y, z)), axes, signs, swaps),
        )

    @property
    def outer_cells(self) -> npt.NDArray[np.bool_]:
        """Bool over the cell box: cells that hold an outer fine cell."""
        return self._unpacked(self.outer)

    @property
    def inner_cells(self) -> npt.NDArray[np.bool_]:
        """Bool over the cell box: cells of which all fine cells are inner."""
        return self._unpacked(self.inner)

    @property
    def outer_fine(self) -> npt.NDArray[np.bool_]:
        """Bool over the fine cells of the cell box: the outer ones."""
        return unpack(self.outer_words)

    @property
    def inner_fine(self) -> npt.NDArray[np.bool_]:
        """Bool over the fine cells of the cell box: the inner ones."""
        return unpack(self.inner_words)

    @property
    def outer_words(self) -> Words:
        """Words [x, y, z] over the cell box: the outer fine cells of each cell."""
        return self._words(0)

    @property
    def inner_words(self) -> Words:
        """Words [x, y, z] over the cell box: the inner fine cells of each cell."""
        return self._words(1)

    def _unpacked(self, words: Words) -> npt.NDArray[np.bool_]:
        dense = np.zeros(_brick_box(self.cells), dtype=np.uint64)
        dense[tuple(self.bricks.T)] = words
        x, y, z = self.cells
        return unpack(dense)[:x, :y, :z]

    def _words(self, which: int) -> Words:
        dense = np.zeros(self.cells, dtype=np.uint64)
        spread_words(dense, self.arrays, which)
        return dense


def unpack(words: Words) -> npt.NDArray[np.bool_]:
    """Words [x, y, z] as a bool array over their bits' places, four times as many an axis."""
    n = FINE_PER_CELL
    bits = np.unpackbits(words[..., None].view(np.uint8), axis=-1, bitorder="little")
    x, y, z = words.shape
    split = bits.reshape(x, y, z, n, n, n).transpose(0, 3, 1, 4, 2, 5)
    dense = np.ascontiguousarray(split).reshape(x * n, y * n, z * n).view(np.bool_)
    dense.setflags(write=False)
    return dense


def centred(cells: npt.NDArray[np.bool_], shape: Triple) -> npt.NDArray[np.bool_]:
    """Cells in the middle of a larger array, False around them; the odd cell is at the high end.

    Raises ValueError where they don't fit.
    """
    if any(own > room for own, room in zip(cells.shape, shape, strict=True)):
        raise ValueError(f"{cells.shape} cells do not fit into {shape}")
    padded = np.zeros(shape, dtype=bool)
    window = tuple(
        slice((room - own) // 2, (room - own) // 2 + own)
        for own, room in zip(cells.shape, shape, strict=True)
    )
    padded[window] = cells
    return padded


def _brick_box(cells: Triple) -> Triple:
    x, y, z = (-(-c // STEP) for c in cells)
    return x, y, z
