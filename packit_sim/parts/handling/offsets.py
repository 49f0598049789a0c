"""Offsets of a part, on a grid: which of them surely lead into others, and the ways around those.

The parts are voxels here. Where enclosed voxels of the part coincide with enclosed voxels of
others, solids overlap, whatever their surfaces are in detail: such cells of offsets are surely
blocked, and a part whose cell they surround can't get out without turning. All other cells may be
free. Ways through them are only proposals, which exact sweeps confirm (see `ways_out`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import fft, ndimage

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.voxelization_kernels import reached_cells, touched_cells
from packit_sim.geometry.voxels import unpack
from packit_sim.geometry.winding import winding_numbers
from packit_sim.parts.handling.offset_kernels import UNREACHED, costs_to_border

_DOUBT = 2.0
"""The cost of a cell in which surfaces may meet, for each doubling of the voxels that do: ways keep
to the middle of channels. The cost of other cells is 1."""


@dataclass(frozen=True, eq=False)
class Offsets:
    """The cells of the offsets of a part, and the costs of the ways from them to the border.

    Attributes
    ----------
    cell : float
        The side of the cells.
    first : ndarray of int64, shape (3,)
        The number of the first cell along each axis; cell 0 has its centre at offset 0.
    costs : ndarray of int32, shape (x, y, z)
        See `costs_to_border`.
    """

    cell: float
    first: Ints
    costs: Any

    def cost(self, offset: Floats) -> int | None:
        """Return the cost of the way to the border from an offset (3,); None if there is none."""
        at = np.round(offset / self.cell).astype(int) - self.first
        if (at < 0).any() or (at >= self.costs.shape).any():
            return None
        cost = int(self.costs[tuple(at)])
        return None if cost >= UNREACHED else cost


def offsets_of(
    mover: Floats, others: Iterable[Floats], low: Floats, high: Floats, voxels: int
) -> Offsets:
    """Find the cells of the offsets of a part, up to some distance.

    Parameters
    ----------
    mover : ndarray of float64, shape (n, 3, 3)
        The triangles of the part.
    others : iterable of ndarray of float64, shape (m, 3, 3)
        Those of the parts that stay.
    low : ndarray of float64, shape (3,)
        The smallest offset along each axis, at most 0.
    high : ndarray of float64, shape (3,)
        The largest, at least 0.
    voxels : int
        About how many voxels the part and its offsets have.

    Returns
    -------
    Offsets
        The cells, from `low` to `high`.
    """
    corner, extents = mover.min(axis=(0, 1)), np.ptp(mover.reshape(-1, 3), axis=0)
    cell = _cell(extents + high - low, voxels)
    first = np.floor(low / cell).astype(int)
    steps = np.ceil(high / cell).astype(int) - first + 1
    start = np.floor(corner / cell - 0.5).astype(int)
    count = np.ceil((corner + extents) / cell - 0.5).astype(int) - start + 1
    own = _voxels(mover, start, count, cell, cell / 2)
    around = np.zeros((2, *(count + steps)), dtype=bool)
    for each in others:
        around |= _voxels(each, start + first, count + steps, cell)
    inner, outer = (_coinciding(*sets) for sets in zip(own, around, strict=True))
    costs = (1 + _DOUBT * np.log2(1 + outer)).astype(np.uint8)
    costs[inner > 0] = 0
    return Offsets(cell, first, costs_to_border(costs))


def _cell(sides: Floats, voxels: int) -> float:
    """Return the side of about so many voxels in a box that may be flat."""
    return float((np.maximum(sides, sides.max() / 64).prod() / voxels) ** (1 / 3))


def _coinciding(own: Any, around: Any) -> Any:
    """Count the voxels that coincide at the corners of each cell, the most of them.

    Two voxels that coincide at an offset overlap at all offsets that differ by less than a side,
    and thus in the eight cells around it.
    """
    shape = [fft.next_fast_len(side, real=True) for side in around.shape]
    spectrum = fft.rfftn(own.astype(float), shape).conj() * fft.rfftn(around.astype(float), shape)
    a, b, c = np.array(around.shape) - own.shape + 1
    found = np.round(fft.irfftn(spectrum, shape)[:a, :b, :c])
    found = np.maximum(found[1:], found[:-1])
    found = np.maximum(found[:, 1:], found[:, :-1])
    return np.maximum(found[:, :, 1:], found[:, :, :-1])


def _voxels(triangles: Floats, start: Ints, count: Ints, cell: float, shift: float = 0.0) -> Any:
    """Return the voxels (2, x, y, z) that a solid surely fills, and those that it may fill.

    Parameters
    ----------
    start, count : ndarray of int64, shape (3,)
        The first voxel along each axis, and how many.
    shift : float
        Where voxel 0 begins.
    """
    found = np.zeros((2, *count), dtype=bool)
    low = np.floor((triangles.min(axis=(0, 1)) - shift) / cell).astype(int) - 2
    high = np.ceil((triangles.max(axis=(0, 1)) - shift) / cell).astype(int) + 2
    words = (high - low + 3) // 4
    begin, end = np.maximum(start, low), np.minimum(start + count, low + 4 * words)
    if (begin >= end).any():
        return found
    centre = (low + 2 * words) * cell + shift
    touched = touched_cells(triangles - centre, words, 4 * cell, CONTACT_TOLERANCE)
    enclosed = ~touched & ~reached_cells(touched)
    # Only the words in the window become booleans: the solid may be much larger.
    first, last = (begin - low) // 4, -(-(end - low) // 4)
    window = _slices(first, last)
    inside = _slices(begin - low - 4 * first, end - low - 4 * first)
    here = _slices(begin - start, end - start)
    inner = unpack(enclosed[window])[inside]
    found[0][here] = _filled(inner, triangles, (begin + 0.5) * cell + shift, cell)
    found[1][here] = inner | unpack(touched[window])[inside]
    return found


def _slices(begin: Ints, end: Ints) -> Any:
    return tuple(map(slice, begin, end))


def _filled(inner: Any, triangles: Floats, first: Floats, cell: float) -> Any:
    """Return those enclosed voxels that are inside the solid, not in a cavity.

    A cavity may have an opening that is narrower than a voxel, so that parts can leave it.
    """
    numbers, count = ndimage.label(inner)
    if count == 0:
        return inner
    _, flat = np.unique(numbers, return_index=True)
    places = np.array(np.unravel_index(flat, inner.shape)).T
    places = places[numbers.ravel()[flat] > 0]
    solid = np.abs(winding_numbers(triangles, first + places * cell)) > 0.5
    return np.r_[False, solid][numbers]
