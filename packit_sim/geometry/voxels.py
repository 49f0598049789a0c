"""The cells of an item as bits on two levels: bricks of cells, and cells of fine cells.

A brick is one grid step along each axis: 4 x 4 x 4 cells in one word, as are a cell's fine cells.
Items are placed at grid nodes, so the bricks of any two in a box line up, and so do their cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import cached_property
from packit_sim.core.errors import ArgumentError
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
    """The bricks of an item that contain an outer cell, in a shuffled order, and their fine cells.

    The order is shuffled because neighbouring bricks are alike: a scan that may stop early finds a
    blocking brick sooner.

    Attributes
    ----------
    cells : Triple
        Cells along each axis of the cell box.
    bricks : ndarray
        (n, 3) int16, place of each brick in the cell box, in grid steps.
    outer, inner : Words
        (n,) uint64, the outer and the inner cells of each brick; see docs/concepts/grid.md.
    first : ndarray
        (n + 1,) int32, where each brick's rows of `fine` start; the last is their number.
    fine : Words
        (m, 2) uint64, the outer and the inner fine cells of each cell that is outer but not inner,
        ordered by brick, and by bit in the brick.
    number : ndarray
        int32 [x, y, z], the number of the brick at each place, -1 for none.
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
        """Voxelize a surface in its cell box, which is centred on the origin.

        Parameters
        ----------
        triangles : ndarray
            (n, 3, 3) float64, corners in box units.
        cells : Triple
            Cells along each axis of the cell box.

        Returns
        -------
        Voxels
            The bricks of the surface.

        Raises
        ------
        ArgumentError
            If the cell box is too large (see `voxelization.fine_cells`).
        """
        return cls(cells, *brick_arrays(*fine_cells(triangles, cells)))

    @classmethod
    def in_box(cls, triangles: npt.NDArray[np.float64], cells: Triple) -> tuple[Triple, Voxels]:
        """Voxelize the part of a surface that is inside a box.

        Parameters
        ----------
        triangles : ndarray
            (n, 3, 3) float64, corners in box units, of the whole surface.
        cells : Triple
            Cells along each axis of the box.

        Returns
        -------
        location : Triple
            The grid node (i, j, k) at which the part begins.
        voxels : Voxels
            The part; it has no cells if nothing of the surface is in the box.

        Raises
        ------
        ArgumentError
            If the surface is too large (see `voxelization.fine_cells`).
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
        """Size of the arrays in bytes."""
        arrays = (self.bricks, self.outer, self.inner, self.first, self.fine, self.number)
        return sum(array.nbytes for array in arrays)

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """Fields of the item's `ItemArrays`."""
        return tuple(ItemArrays(self.bricks, self.outer, self.inner, self.first, self.fine))

    @cached_property
    def fixed_arrays(self) -> tuple[Any, ...]:
        """Fields of the item's `FixedArrays`."""
        return tuple(FixedArrays(self.number, self.outer, self.inner, self.first, self.fine))

    def turned(self, rotation: int) -> Voxels:
        """Return the voxels under one of the 24 rotations, exactly."""
        axes, signs = rotations.AXES[rotation], rotations.SIGNS[rotation]
        x, y, z = (self.cells[axis] for axis in axes.tolist())
        swaps = turning_swaps(rotation)
        return Voxels(
            (x, y, z),
            *turn_bricks(self.arrays, np.array((x, y, z)), axes, signs, swaps),
        )

    @property
    def outer_cells(self) -> npt.NDArray[np.bool_]:
        """Bool over the cell box: cells that contain an outer fine cell."""
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
    """Convert words [x, y, z] to a read-only bool array over the places of their bits.

    Parameters
    ----------
    words : Words
        (x, y, z) uint64.

    Returns
    -------
    ndarray
        Bool (4 x, 4 y, 4 z).
    """
    n = FINE_PER_CELL
    bits = np.unpackbits(words[..., None].view(np.uint8), axis=-1, bitorder="little")
    x, y, z = words.shape
    split = bits.reshape(x, y, z, n, n, n).transpose(0, 3, 1, 4, 2, 5)
    dense = np.ascontiguousarray(split).reshape(x * n, y * n, z * n).view(np.bool_)
    dense.setflags(write=False)
    return dense


def centred(cells: npt.NDArray[np.bool_], shape: Triple) -> npt.NDArray[np.bool_]:
    """Pad cells with False on all sides; an odd cell of padding is at the high end.

    Parameters
    ----------
    cells : ndarray
        Bool (x, y, z).
    shape : Triple
        Shape of the padded array.

    Returns
    -------
    ndarray
        Bool of this shape.

    Raises
    ------
    ArgumentError
        If the cells don't fit.
    """
    if any(own > space for own, space in zip(cells.shape, shape, strict=True)):
        raise ArgumentError(f"{cells.shape} cells do not fit into {shape}")
    padded = np.zeros(shape, dtype=bool)
    window = tuple(
        slice((space - own) // 2, (space - own) // 2 + own)
        for own, space in zip(cells.shape, shape, strict=True)
    )
    padded[window] = cells
    return padded


def _brick_box(cells: Triple) -> Triple:
    x, y, z = (-(-c // STEP) for c in cells)
    return x, y, z
