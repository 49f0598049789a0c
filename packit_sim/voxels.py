"""Outer and inner fine cells: what an item's surface touches or encloses, exactly, as bits.

A cell's 64 fine cells are one machine word, bit `16 * x + 4 * y + z` for the fine cell (x, y, z)
of the cell. Items keep only their cells with an outer fine cell, each with its two words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from packit_sim import rotations
from packit_sim.lattice import CELL, CONTACT_TOLERANCE, FINE_PER_CELL, MAX_CELLS, Triple

Words = npt.NDArray[np.uint64]

FULL = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
_Z_LOW, _Z_HIGH = np.uint64(0x1111_1111_1111_1111), np.uint64(0x8888_8888_8888_8888)
_Y_LOW, _Y_HIGH = np.uint64(0x000F_000F_000F_000F), np.uint64(0xF000_F000_F000_F000)
_X_LOW, _X_HIGH = np.uint64(0x0000_0000_0000_FFFF), np.uint64(0xFFFF_0000_0000_0000)
_1, _3, _4, _12, _16, _48 = (np.uint64(n) for n in (1, 3, 4, 12, 16, 48))

VOLUME_RESOLUTION = 256
"""Voxels along the longest side where the volume of a shape that is no closed body is measured."""


@dataclass(frozen=True, eq=False)
class Voxels:
    """The cells of an item that hold an outer fine cell, in a fixed, shuffled order.

    Shuffled, because neighbours tell the same: a scan that may stop early meets what differs soon.

    cells: cells an axis of the cell box. coords: (n, 3) int16, each cell's place in the cell box.
    outer, inner: (n,) uint64, a bit for each fine cell that is outer, or inner.
    """

    cells: Triple
    coords: npt.NDArray[np.int16]
    outer: Words
    inner: Words

    @property
    def nbytes(self) -> int:
        return int(self.coords.nbytes + self.outer.nbytes + self.inner.nbytes)

    def turned(self, rotation: int) -> Voxels:
        """The same under one of the 24 rotations, bit for bit."""
        cells = np.array(self.cells)[rotations.AXES[rotation]]
        tables = _byte_tables(rotation)
        x, y, z = cells.tolist()
        return Voxels(
            (x, y, z),
            _turn_coords(self.coords, cells, rotations.AXES[rotation], rotations.SIGNS[rotation]),
            _permute_bits(self.outer, tables),
            _permute_bits(self.inner, tables),
        )

    @property
    def outer_cells(self) -> npt.NDArray[np.bool_]:
        """Bool over the cell box: cells of which any fine cell is outer."""
        return self._dense(np.ones(len(self.coords), dtype=bool))

    @property
    def inner_cells(self) -> npt.NDArray[np.bool_]:
        """Bool over the cell box: cells of which all fine cells are inner."""
        return self._dense(self.inner == FULL)

    @property
    def outer_fine(self) -> npt.NDArray[np.bool_]:
        """Bool over the fine cells of the cell box: the outer ones."""
        return unpack(self._dense(self.outer))

    @property
    def inner_fine(self) -> npt.NDArray[np.bool_]:
        """Bool over the fine cells of the cell box: the inner ones."""
        return unpack(self._dense(self.inner))

    def _dense(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        dense = np.zeros(self.cells, dtype=values.dtype)
        dense[tuple(self.coords.T)] = values
        dense.setflags(write=False)
        return dense


def voxelize(triangles: npt.NDArray[np.float64], cells: Triple) -> Voxels:
    """The outer and inner fine cells of a surface in its cell box, which is centred on the origin.

    triangles: (n, 3, 3) corners in box units. A fine cell, grown by half the contact tolerance, is
    touched where a triangle meets it; the enclosed ones are those that no path over faces of
    untouched fine cells reaches from outside. Raises ValueError where the cell box has more than
    `MAX_CELLS` along an axis.
    """
    if max(cells) > MAX_CELLS:
        raise ValueError(
            f"a mesh of {' x '.join(map(str, cells))} cells is too large to voxelise: "
            f"at most {MAX_CELLS} an axis"
        )
    touched = _touched(triangles, np.array(cells), CELL, CONTACT_TOLERANCE / 2)
    reached = _reached(touched)
    outer = ~reached
    coords = np.random.default_rng(0).permutation(np.argwhere(outer))
    at = tuple(coords.T)
    return Voxels(cells, coords.astype(np.int16), outer[at], (outer & ~touched)[at])


def solid_volume(triangles: npt.NDArray[np.float64]) -> float:
    """Volume of what a surface encloses, for surfaces that are no closed body (DESIGN: Shapes).

    Voxels of 1/256 of the longest side; enclosed ones count whole and touched ones half.
    """
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    voxel = float((high - low).max()) / VOLUME_RESOLUTION
    cell = voxel * FINE_PER_CELL
    room_outside = 2  # a face on the border of voxels touches those on both sides of it
    cells = np.ceil((high - low) / cell).astype(np.int64) + room_outside
    touched = _touched(triangles - (low + high) / 2, cells, cell, voxel * 1e-9)
    enclosed = ~(touched | _reached(touched))
    counts = int(np.bitwise_count(enclosed).sum()) + int(np.bitwise_count(touched).sum()) / 2
    return counts * voxel**3


def unpack(words: Words) -> npt.NDArray[np.bool_]:
    """Words [x, y, z] as a bool array over their fine cells, four times as many an axis."""
    n = FINE_PER_CELL
    bits = np.unpackbits(words[..., None].view(np.uint8), axis=-1, bitorder="little")
    x, y, z = words.shape
    split = bits.reshape(x, y, z, n, n, n).transpose(0, 3, 1, 4, 2, 5)
    fine = np.ascontiguousarray(split).reshape(x * n, y * n, z * n).view(np.bool_)
    fine.setflags(write=False)
    return fine


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


_BYTE_TABLES: dict[int, Words] = {}


def _byte_tables(rotation: int) -> Words:
    """(8, 256): for each byte of a word and each value of it, the word's bits after a turn."""
    if rotation not in _BYTE_TABLES:
        bit = np.arange(64).reshape(4, 4, 4)
        turned = rotations.turn_array(bit, rotation).ravel()  # turned[new bit] = old bit
        new_bit = np.argsort(turned).astype(np.uint64).reshape(8, 8)
        value = np.arange(256, dtype=np.uint64)
        shift = np.arange(8, dtype=np.uint64)
        bits = (value[:, None] >> shift) & _1  # (256, 8)
        moved = bits[None] << new_bit[:, None]  # (8, 256, 8)
        _BYTE_TABLES[rotation] = np.bitwise_or.reduce(moved, axis=2)
    return _BYTE_TABLES[rotation]


@numba.njit(cache=True)
def _turn_coords(coords, cells, axes, signs):
    turned = np.empty_like(coords)
    for n in range(len(coords)):
        for d in range(3):
            at = coords[n, axes[d]]
            turned[n, d] = at if signs[d] > 0 else cells[d] - 1 - at
    return turned


@numba.njit(cache=True)
def _permute_bits(words, tables):
    permuted = np.empty_like(words)
    for n in range(words.size):
        word = words[n]
        new = np.uint64(0)
        for byte in range(8):
            new |= tables[byte, (word >> np.uint64(8 * byte)) & np.uint64(255)]
        permuted[n] = new
    return permuted


@numba.njit(cache=True)
def _touched(triangles, cells, cell, grow):
    """Words [x, y, z]: fine cells, grown on all sides, that a triangle meets.

    The separating-axis test of Akenine-Moeller (2001): the box's 3 axes, the triangle's normal, and
    the 9 products of their edges; first on whole cells, then on the fine cells of those that pass.
    """
    words = np.zeros((cells[0], cells[1], cells[2]), np.uint64)
    fine = cell / 4
    half_cell, half_fine = cell / 2 + grow, fine / 2 + grow
    axes = np.zeros((13, 3))
    span = np.zeros((13, 2))
    reach = np.zeros(13)
    first = np.zeros(3, np.int64)
    last = np.zeros(3, np.int64)
    center = np.zeros(3)
    fine_center = np.zeros(3)
    for t in range(len(triangles)):
        triangle = triangles[t]
        _separating_axes(triangle, axes)
        for a in range(13):
            p0 = _dot(axes[a], triangle[0])
            p1 = _dot(axes[a], triangle[1])
            p2 = _dot(axes[a], triangle[2])
            span[a, 0] = min(p0, p1, p2)
            span[a, 1] = max(p0, p1, p2)
            reach[a] = abs(axes[a, 0]) + abs(axes[a, 1]) + abs(axes[a, 2])
        for d in range(3):  # fine cells that the triangle's bounding box may meet, and one more
            low, high = span[10 + d, 0] - grow, span[10 + d, 1] + grow
            first[d] = max(int(np.floor(low / fine + 2 * cells[d])) - 1, 0)
            last[d] = min(int(np.floor(high / fine + 2 * cells[d])) + 1, 4 * cells[d] - 1)
        for x in range(first[0] // 4, last[0] // 4 + 1):
            center[0] = (x + 0.5 - cells[0] / 2) * cell
            for y in range(first[1] // 4, last[1] // 4 + 1):
                center[1] = (y + 0.5 - cells[1] / 2) * cell
                for z in range(first[2] // 4, last[2] // 4 + 1):
                    word = words[x, y, z]
                    if word == FULL:
                        continue
                    center[2] = (z + 0.5 - cells[2] / 2) * cell
                    if not _meets(center, half_cell, axes, span, reach):
                        continue
                    for u in range(max(first[0], 4 * x), min(last[0], 4 * x + 3) + 1):
                        fine_center[0] = (u + 0.5 - cells[0] * 2) * fine
                        for v in range(max(first[1], 4 * y), min(last[1], 4 * y + 3) + 1):
                            fine_center[1] = (v + 0.5 - cells[1] * 2) * fine
                            for w in range(max(first[2], 4 * z), min(last[2], 4 * z + 3) + 1):
                                bit = _1 << np.uint64(16 * (u & 3) + 4 * (v & 3) + (w & 3))
                                if word & bit:
                                    continue
                                fine_center[2] = (w + 0.5 - cells[2] * 2) * fine
                                if _meets(fine_center, half_fine, axes, span, reach):
                                    word |= bit
                    words[x, y, z] = word
    return words


@numba.njit(cache=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def _separating_axes(triangle, axes):
    """The normal, which tells most, then the 9 products of edges, then x, y and z."""
    edges = np.empty((3, 3))
    for e in range(3):
        edges[e] = triangle[(e + 1) % 3] - triangle[e]
    axes[0] = np.cross(edges[0], edges[1])
    for e in range(3):
        x, y, z = edges[e]
        axes[1 + 3 * e] = (0.0, -z, y)
        axes[2 + 3 * e] = (z, 0.0, -x)
        axes[3 + 3 * e] = (-y, x, 0.0)
    for d in range(3):
        axes[10 + d, d] = 1.0


@numba.njit(cache=True, inline="always")
def _meets(center, half, axes, span, reach):
    for a in range(13):
        at = _dot(axes[a], center)
        if at + half * reach[a] < span[a, 0] or at - half * reach[a] > span[a, 1]:
            return False
    return True


@numba.njit(cache=True)
def _reached(touched):
    """Words [x, y, z]: untouched fine cells with a path over faces from outside the cell box."""
    nx, ny, nz = touched.shape
    reached = np.zeros_like(touched)
    queued = np.zeros(touched.shape, np.bool_)
    stack = np.empty((touched.size, 3), np.int32)
    top = 0
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                border = np.uint64(0)
                if x == 0:
                    border |= _X_LOW
                if x == nx - 1:
                    border |= _X_HIGH
                if y == 0:
                    border |= _Y_LOW
                if y == ny - 1:
                    border |= _Y_HIGH
                if z == 0:
                    border |= _Z_LOW
                if z == nz - 1:
                    border |= _Z_HIGH
                border &= ~touched[x, y, z]
                if border:
                    reached[x, y, z] = border
                    stack[top] = (x, y, z)
                    queued[x, y, z] = True
                    top += 1
    while top:
        top -= 1
        x, y, z = stack[top]
        queued[x, y, z] = False
        free = ~touched[x, y, z]
        flood = reached[x, y, z]
        while True:
            grown = flood | (flood & ~_Z_HIGH) << _1 | (flood & ~_Z_LOW) >> _1
            grown |= (flood & ~_Y_HIGH) << _4 | (flood & ~_Y_LOW) >> _4
            grown |= flood << _16 | flood >> _16
            grown &= free
            if grown == flood:
                break
            flood = grown
        reached[x, y, z] = flood
        for side in range(6):
            u, v, w = x, y, z
            if side == 0:
                u, into = x + 1, flood >> _48
            elif side == 1:
                u, into = x - 1, flood << _48
            elif side == 2:
                v, into = y + 1, (flood & _Y_HIGH) >> _12
            elif side == 3:
                v, into = y - 1, (flood & _Y_LOW) << _12
            elif side == 4:
                w, into = z + 1, (flood & _Z_HIGH) >> _3
            else:
                w, into = z - 1, (flood & _Z_LOW) << _3
            if u < 0 or u >= nx or v < 0 or v >= ny or w < 0 or w >= nz:
                continue
            into &= ~(touched[u, v, w] | reached[u, v, w])
            if into:
                reached[u, v, w] |= into
                if not queued[u, v, w]:
                    queued[u, v, w] = True
                    stack[top] = (u, v, w)
                    top += 1
    return reached
