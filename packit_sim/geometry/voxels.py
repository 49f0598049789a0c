"""The cells of an item, as bits on two levels: bricks of cells, and cells of fine cells.

A brick is one grid step an axis: 4 x 4 x 4 cells, one word, as a cell's fine cells are. Items stand
on the grid's nodes, so the bricks of any two in a box line up, and so do their cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import cached_property
from packit_sim.core.compilation import kernel
from packit_sim.geometry import rotations
from packit_sim.geometry.bits import (
    FULL,
    LOW,
    STRIDES,
    Words,
    turning_swaps,
)
from packit_sim.geometry.lattice import FINE_PER_CELL, STEP, Triple
from packit_sim.geometry.voxelization import fine_cells, lattice_cells
from packit_sim.geometry.word_kernels import count_bits, lowest_bit, turn_words

_1 = np.uint64(1)


class ItemArrays(NamedTuple):
    """An item's bricks as a list, as kernels take them (see `Voxels`)."""

    bricks: npt.NDArray[np.int16]
    outer: Words
    inner: Words
    first: npt.NDArray[np.int32]
    fine: Words


class FixedArrays(NamedTuple):
    """An item's bricks by place, as kernels take an item that another is compared with."""

    number: npt.NDArray[np.int32]
    outer: Words
    inner: Words
    first: npt.NDArray[np.int32]
    fine: Words


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
        return cls(cells, *_bricks(*fine_cells(triangles, cells)))

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
        bricks = _bricks(np.ascontiguousarray(touched[part]), np.ascontiguousarray(reached[part]))
        return (i, j, k), cls((x, y, z), *bricks)

    @property
    def nbytes(self) -> int:
        arrays = (self.bricks, self.outer, self.inner, self.first, self.fine, self.number)
        return sum(array.nbytes for array in arrays)

    @cached_property
    def arrays(self) -> ItemArrays:
        """The item, for kernels."""
        return ItemArrays(self.bricks, self.outer, self.inner, self.first, self.fine)

    @cached_property
    def fixed_arrays(self) -> FixedArrays:
        """The item that another is compared with, for kernels."""
        return FixedArrays(self.number, self.outer, self.inner, self.first, self.fine)

    def turned(self, rotation: int) -> Voxels:
        """The same under one of the 24 rotations, bit for bit."""
        axes, signs = rotations.AXES[rotation], rotations.SIGNS[rotation]
        x, y, z = (self.cells[axis] for axis in axes.tolist())
        swaps = turning_swaps(rotation)
        return Voxels(
            (x, y, z),
            *_turned(
                self.bricks,
                self.outer,
                self.inner,
                self.fine,
                np.array((x, y, z)),
                axes,
                signs,
                swaps,
            ),
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
        _spread(dense, self.bricks, self.outer, self.inner, self.fine[:, which])
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


@kernel
def _brick_words(touched, reached):
    """Outer and inner cells as words over the bricks [x, y, z], from words of fine cells."""
    nx, ny, nz = touched.shape
    bricks = ((nx + 3) // 4, (ny + 3) // 4, (nz + 3) // 4)
    outer_cells = np.zeros(bricks, np.uint64)
    inner_cells = np.zeros(bricks, np.uint64)
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                if reached[x, y, z] != FULL:
                    bit = _1 << np.uint64(16 * (x & 3) + 4 * (y & 3) + (z & 3))
                    outer_cells[x >> 2, y >> 2, z >> 2] |= bit
                    if not touched[x, y, z] | reached[x, y, z]:
                        inner_cells[x >> 2, y >> 2, z >> 2] |= bit
    return outer_cells, inner_cells


@kernel
def _shuffled(outer_cells, inner_cells):
    """The bricks that hold a cell, shuffled: places, words, and where their fine words start."""
    nx, ny, nz = outer_cells.shape
    count = 0
    for word in outer_cells.flat:
        count += word != 0
    bricks = np.empty((count, 3), np.int16)
    n = 0
    random = np.uint64(0x9E37_79B9_7F4A_7C15)
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                if outer_cells[x, y, z]:
                    random ^= random << np.uint64(13)  # Marsaglia's xorshift64
                    random ^= random >> np.uint64(7)
                    random ^= random << np.uint64(17)
                    at = np.int64(random % np.uint64(n + 1))
                    bricks[n] = bricks[at]
                    bricks[at, 0], bricks[at, 1], bricks[at, 2] = x, y, z
                    n += 1
    outer = np.empty(count, np.uint64)
    inner = np.empty(count, np.uint64)
    first = np.zeros(count + 1, np.int32)
    number = np.full((nx, ny, nz), np.int32(-1))
    for n in range(count):
        x, y, z = bricks[n]
        number[x, y, z] = n
        outer[n], inner[n] = outer_cells[x, y, z], inner_cells[x, y, z]
        first[n + 1] = first[n] + count_bits(outer[n] & ~inner[n])
    return bricks, outer, inner, first, number


@kernel
def _place(brick, bit):
    """Where the cell of a bit in a brick is, in cells."""
    return 4 * brick[0] + (bit >> 4), 4 * brick[1] + (bit >> 2 & 3), 4 * brick[2] + (bit & 3)


@kernel
def _bricks(touched, reached):
    """All that `Voxels` holds, from words of fine cells."""
    outer_cells, inner_cells = _brick_words(touched, reached)
    bricks, outer, inner, first, number = _shuffled(outer_cells, inner_cells)
    fine = np.empty((first[-1], 2), np.uint64)
    at = 0
    for n in range(len(bricks)):
        left = outer[n] & ~inner[n]
        while left:
            x, y, z = _place(bricks[n], lowest_bit(left))
            left &= left - _1
            fine[at, 0] = ~reached[x, y, z]
            fine[at, 1] = ~(reached[x, y, z] | touched[x, y, z])
            at += 1
    return bricks, outer, inner, first, fine, number


@kernel
def _turned(old_bricks, old_outer, old_inner, old_fine, cells, axes, signs, swaps):
    """The bricks and words of an item after a turn; cells: of the turned cell box."""
    nx, ny, nz = (cells[0] + 3) // 4, (cells[1] + 3) // 4, (cells[2] + 3) // 4
    outer_cells = np.zeros((nx, ny, nz), np.uint64)
    inner_cells = np.zeros((nx, ny, nz), np.uint64)
    words = old_outer.copy()
    turn_words(words, swaps)
    _put(outer_cells, words, old_bricks, axes, signs)
    words[:] = old_inner
    turn_words(words, swaps)
    _put(inner_cells, words, old_bricks, axes, signs)
    for d in range(3):
        spare = -cells[d] & 3
        if signs[d] < 0 and spare:
            _shift(outer_cells, d, spare)
            _shift(inner_cells, d, spare)
    bricks, outer, inner, first, number = _shuffled(outer_cells, inner_cells)
    flat = old_fine.ravel().copy()
    turn_words(flat, swaps)
    fine = np.empty_like(old_fine)
    at = 0
    old = np.empty(3, np.int64)
    new = np.empty(3, np.int64)
    for m in range(len(old_bricks)):
        left = old_outer[m] & ~old_inner[m]
        while left:
            old[0], old[1], old[2] = _place(old_bricks[m], lowest_bit(left))
            left &= left - _1
            for d in range(3):
                new[d] = old[axes[d]] if signs[d] > 0 else cells[d] - 1 - old[axes[d]]
            n = number[new[0] >> 2, new[1] >> 2, new[2] >> 2]
            bit = 16 * (new[0] & 3) + 4 * (new[1] & 3) + (new[2] & 3)
            below = (_1 << np.uint64(bit)) - _1
            to = first[n] + count_bits(outer[n] & ~inner[n] & below)
            fine[to, 0], fine[to, 1] = flat[2 * at], flat[2 * at + 1]
            at += 1
    return bricks, outer, inner, first, fine, number


@kernel
def _put(dense, words, bricks, axes, signs):
    """Words at the places of their bricks after a turn of a cell box of whole bricks."""
    place = np.empty(3, np.int64)
    for n in range(len(bricks)):
        for d in range(3):
            at = bricks[n, axes[d]]
            place[d] = at if signs[d] > 0 else dense.shape[d] - 1 - at
        dense[place[0], place[1], place[2]] = words[n]


@kernel
def _shift(dense, d, count):
    """Moves the cells in bricks [x, y, z] by 1 to 3 places towards 0 along axis d."""
    stride = STRIDES[d]
    low = np.uint64(0)
    for place in range(count):
        low |= LOW[d] << np.uint64(place * stride)
    down, up = np.uint64(count * stride), np.uint64((4 - count) * stride)
    nx, ny, nz = dense.shape
    dx, dy, dz = d == 0, d == 1, d == 2
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                word = (dense[x, y, z] & ~low) >> down
                if x + dx < nx and y + dy < ny and z + dz < nz:
                    word |= (dense[x + dx, y + dy, z + dz] & low) << up
                dense[x, y, z] = word


@kernel
def _spread(dense, bricks, outer, inner, fine):
    """Words [x, y, z] over the cell box, from bricks and the words of their outer cells."""
    at = 0
    for n in range(len(bricks)):
        left = outer[n]
        while left:
            bit = lowest_bit(left)
            left &= left - _1
            x, y, z = _place(bricks[n], bit)
            if inner[n] >> np.uint64(bit) & _1:
                dense[x, y, z] = FULL
            else:
                dense[x, y, z] = fine[at]
                at += 1
