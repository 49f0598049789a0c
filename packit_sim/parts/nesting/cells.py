"""Items as cells of a fine grid, for problems of too many types for a field of each pair.

A box is a grid of cells, and an item at a grid position is the set of cells that its surface
touches or encloses, grown by half of the clearance. Two items whose sets have no cell in common
are certainly apart, so that whole columns of positions are tested by the bits of a word
(`placement_kernels`), and the cells that two items share say how deep they overlap
(`cell_separation_kernels`). What is needed grows with the number of types, not with its square.

Sets are conservative: they may share cells although the surfaces are apart. Surfaces are asked then
(`settling_kernels`, `cell_separation_kernels`), so that the grid costs little space in the end.
"""

from __future__ import annotations

import threading
import weakref
from typing import Any, NamedTuple

import numpy as np

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.placement_kernels import (
    LONGEST,
    cover,
    inner_cubes,
    lowest_place,
    mark,
    update_windows,
)
from packit_sim.parts.nesting.problem import Problem
from packit_sim.parts.nesting.voxel_sets import placed_voxels, voxelized

CUBES_TRIED_FIRST = 48
"""Large cubes inside an item with which a search for its places begins."""

WORD = 64
"""Bits of a word."""


class Cells(NamedTuple):
    """The cells of all types, in all their rotations.

    Attributes
    ----------
    side : float
        The side of a cell.
    margin : int
        Cells by which the grid of a box reaches beyond its walls: items are grown there too.
    bits : ndarray
        uint64, planes of words along z, with y contiguous, of each type and rotation.
    forms : ndarray
        (t, m, 7) int64, by type and number of the rotation: where its planes start, the lengths of
        a row and of a plane, the number of planes, and the numbers of cells along the axes.
    cubes : ndarray
        (c, 4) int32, lowest cells and sides of the cubes that a type consists of, the largest
        first, in a base orientation.
    first : ndarray
        (p, 4) int32, large cubes inside a type, which overlap each other.
    starts, first_starts : ndarray
        (b + 1,) int64, where the cubes of each base start.
    bases : ndarray
        (t, m) int64, the base that each rotation of a type is made from.
    axes, signs : ndarray
        (t, m, 3) int64, how: axis d is the base's `axes[d]`, reversed where the sign is -1.
    """

    side: float
    margin: int
    bits: Any
    forms: Any
    cubes: Any
    first: Any
    starts: Any
    first_starts: Any
    bases: Any
    axes: Any
    signs: Any


MOST_BYTES = 300e6
"""Most memory of the words of a grid."""

MOST_KNOWN = 2 * MOST_BYTES
"""Most memory of the words of all grids that are kept."""

_known: dict[tuple[int, float], Cells] = {}
_lock = threading.Lock()


def cells_of(problem: Problem, side: float) -> Cells:
    """Return the cells of a problem's types, which all threads share and some grids keep.

    Parameters
    ----------
    side : float
        The side of a cell.

    Returns
    -------
    Cells
        The cells.
    """
    corners = problem.surfaces.other  # threads share it, whatever else they have of their own
    key = id(corners), side
    with _lock:
        if key not in _known:
            most = MOST_KNOWN - 8 * _count_words(problem, side)
            while _known and sum(each.bits.nbytes for each in _known.values()) > most:
                del _known[next(iter(_known))]
            _known[key] = _computed(problem, side)
            weakref.finalize(corners, _known.pop, key, None)
        return _known[key]


def least_side(problem: Problem, side: float) -> float:
    """Return a side of cells, or a larger one with which their words take `MOST_BYTES`."""
    while 8 * _count_words(problem, side) > MOST_BYTES:
        side *= 1.05
    return side


def _count_words(problem: Problem, side: float) -> int:
    """Return how many words all types take in all their rotations, if no body is around them."""
    is_own = np.arange(problem.allowed.shape[1]) < problem.allowed_counts[:, None]
    types, place = np.nonzero(is_own)
    boxes = problem.lookup.boxes[types, problem.allowed[types, place]]
    extents = boxes[:, 3:] - boxes[:, :3] + problem.lookup.clearance
    x, y, z = np.ceil(extents / side).T
    return int((x * y * np.ceil(z / WORD)).sum())


def _computed(problem: Problem, side: float) -> Cells:
    types, rotations = problem.allowed.shape
    grow = problem.lookup.clearance / 2
    forms = np.zeros((types, rotations, 7), np.int64)
    bases, axes, signs = (
        np.zeros((types, rotations, *more), np.int64) for more in ((), (3,), (3,))
    )
    bits = np.empty(_count_words(problem, side), np.uint64)
    cubes: list[Any] = []
    first: list[Any] = []
    start = 0
    for t in range(types):
        own, own_bases = _type_cells(problem, t, side, grow)
        for o, words, base, own_axes, own_signs, shape in own:
            forms[t, o] = (start, shape[1], shape[0] * shape[1], len(words), *shape)
            bases[t, o] = len(cubes) + base
            axes[t, o], signs[t, o] = own_axes, own_signs
            if start + words.size > len(bits):
                more = np.empty(len(bits) + words.size, np.uint64)  # no memory until it is used
                bits = np.concatenate((bits[:start], more))
            bits[start : start + words.size] = words.ravel()
            start += words.size
        cubes += [each for each, _ in own_bases]
        first += [each for _, each in own_bases]
    return Cells(
        side,
        int(grow / side),
        bits[:start],
        forms,
        np.concatenate(cubes),
        np.concatenate(first),
        _starts(cubes),
        _starts(first),
        bases,
        axes,
        signs,
    )


def _type_cells(problem: Problem, t: int, side: float, grow: float) -> tuple[Any, Any]:
    """Return the rotations of a type with their words, and its bases with their cubes."""
    surfaces = problem.surfaces
    triangles = surfaces.other[surfaces.triangle_starts[t] : surfaces.triangle_starts[t + 1]]
    found: list[tuple[Any, ...]] = []
    bases: list[tuple[Any, Any]] = []
    turned: list[tuple[Floats, Any]] = []
    for o in problem.allowed[t, : problem.allowed_counts[t]].tolist():
        turn = problem.lookup.turns[o]
        number, axes, signs = _exchange_of_axes(turn, turned)
        if number == len(turned):
            solid = voxelized(triangles @ turn.T, side, grow)
            turned.append((turn, solid))
            bases.append((_shuffled(cover(solid)), inner_cubes(solid, CUBES_TRIED_FIRST)))
        solid = turned[number][1]
        own = np.flip(solid.transpose(axes), tuple(np.flatnonzero(signs < 0)))
        found.append((o, _words(own), number, axes, signs, own.shape))
    return found, bases


def _exchange_of_axes(turn: Floats, bases: list[tuple[Floats, Any]]) -> tuple[int, Ints, Ints]:
    """Return the base from which an exchange of axes gives a rotation, these, and their signs.

    If there is none, the rotation itself becomes a base, with the next number.
    """
    for number, (one, _) in enumerate(bases):
        way = turn @ one.T
        axes = np.abs(way).argmax(axis=1)
        signs = way[np.arange(3), axes]
        if np.abs(np.abs(signs) - 1).max() < 1e-9:
            return number, axes, np.sign(signs).astype(np.int64)
    return len(bases), np.arange(3), np.ones(3, np.int64)


def _shuffled(cubes: Any) -> Any:
    """Shuffle the cubes of each side, so that the first ones are all over the item."""
    mixed = cubes[np.random.default_rng(0).permutation(len(cubes))]
    return mixed[np.argsort(-mixed[:, 3], kind="stable")]


def _words(solid: Any) -> Any:
    """Return the bits of cells (x, y, z) in words along z: planes (words, x, y) of uint64."""
    count = -(-solid.shape[2] // WORD)
    padded = np.zeros((*solid.shape[:2], count * WORD), np.uint8)
    padded[:, :, : solid.shape[2]] = solid
    words = np.packbits(padded, axis=2, bitorder="little").view("<u8").astype(np.uint64)
    return np.ascontiguousarray(words.transpose(2, 0, 1))


def _starts(parts: list[Any]) -> Ints:
    return np.cumsum([0, *map(len, parts)]).astype(np.int64)


class Space:
    """The grid of a box, with the cells that are taken.

    Parameters
    ----------
    box : ndarray of float64, shape (4,)
        The box (see `problem.boxes_of`); its height may be infinite.
    """

    def __init__(self, cells: Cells, box: Floats) -> None:
        self._cells = cells
        self._low = np.array([box[0], 0.0, 0.0]) - cells.margin * cells.side
        wide = np.minimum(box[1:] / cells.side + 1e-9, 1e6).astype(np.int64)
        self._sides = wide + 2 * cells.margin
        self._windows = _no_windows(self._sides[0], self._sides[1], LONGEST)
        self._top = 0

    def put(self, triangles: Floats, grow: float) -> None:
        """Take the cells of a solid at any place, as far as they are in the grid."""
        low, solid = placed_voxels(triangles - self._low, self._cells.side, grow)
        cut = np.maximum(-low, 0)
        solid = solid[cut[0] :, cut[1] :, cut[2] :]
        low = np.maximum(low, 0)
        left = np.maximum(self._sides - low, 0)
        solid = solid[: left[0], : left[1], : left[2]]
        if solid.size == 0:
            return
        self._reach(int(low[2] + solid.shape[2]))
        words = _words(solid)
        x, y, z = solid.shape
        mark(self._windows, words.ravel(), np.array([0, y, x * y, len(words), x, y, z]), *low)
        self._changed(low, low + solid.shape)

    def lowest(self, t: int, turns: Ints) -> tuple[int, Floats] | None:
        """Find the place of an item whose top is lowest, in any of its rotations.

        Parameters
        ----------
        t : int
            The type.
        turns : ndarray of int64
            The numbers of its rotations.

        Returns
        -------
        tuple of int and ndarray of float64, or None
            The number of the rotation, and the place (3,).
        """
        longest = int(self._cells.forms[t, turns, 4:].max())
        limit = min(self._top + longest, int(self._sides[2]))
        self._reach(limit)
        found = np.zeros(4, np.int64)
        top = lowest_place(
            self._windows, self._sides[0], self._sides[1], self._cells, t, turns, limit, found
        )
        if top > limit:
            return None
        o = int(found[0])
        form = self._cells.forms[t, o]
        return o, self._low + (found[1:] + form[4:] / 2) * self._cells.side

    def _reach(self, height: int) -> None:
        """Let the grid reach some height."""
        more = _no_windows(self._sides[0], self._sides[1], height).shape[2]
        if more > self._windows.shape[2]:
            shape = (*self._windows.shape[:2], more - self._windows.shape[2])
            above = np.zeros(shape + self._windows.shape[3:], np.uint64)
            self._windows = np.concatenate((self._windows, above), axis=2)

    def _changed(self, low: Ints, high: Ints) -> None:
        self._top = max(self._top, int(high[2]))
        update_windows(self._windows, *low[:2], *high[:2])


def _no_windows(x: int, y: int, height: int) -> Any:
    """Return arrays for a grid of some height without any item (see `placement_kernels`)."""
    return np.zeros((8, 4, height // (4 * WORD) + 1, x + 4, y + 4), np.uint64)
