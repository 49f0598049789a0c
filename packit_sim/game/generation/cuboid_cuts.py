"""Cuts into cuboids: by planes through a whole part (guillotine), or by pinwheels."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from packit_sim.game.generation.puzzle_pieces import NODES, PuzzlePiece
from packit_sim.geometry.lattice import Triple

MIN_SIDE = 3
"""The shortest side of a piece, in steps of the grid."""

SHARES = (0.25, 4.0)
"""The smallest and the largest volume of a piece, relative to the mean."""

CUT = (0.3, 0.7)
"""The range in which a plane may cut a part, relative to its length."""

WHIRL = 5
"""Pieces of a pinwheel."""

Block = tuple[Triple, Triple]
"""A cuboid: its minimum and its maximum corner, in steps of the grid."""

WHOLE: Block = ((0, 0, 0), (NODES, NODES, NODES))
"""The box."""


def guillotine(pieces: int, rng: np.random.Generator) -> list[PuzzlePiece] | None:
    """Cut the box by planes, the largest part first; None if a part is too small to be cut."""
    blocks = split(pieces, rng)
    return None if blocks is None else _pieces(blocks)


def pinwheel(pieces: int, rng: np.random.Generator) -> list[PuzzlePiece] | None:
    """Cut the box into pinwheels, the largest part first, and finally by planes.

    Parameters
    ----------
    pieces : int
        The number of pieces, at least `WHIRL`.
    rng : numpy.random.Generator
        The generator that draws the cuts.

    Returns
    -------
    list of PuzzlePiece or None
        Cuboids in an order in which they can be put in from above; None if a part is too small to
        be cut, or a plane separates the pieces.
    """
    whirls, planes = divmod(pieces - 1, WHIRL - 1)
    blocks = divided([WHOLE], whirls, whirled, rng)
    blocks = blocks and divided(blocks, planes, _halved, rng)
    if not blocks or not is_even(blocks) or separating_planes(blocks):
        return None
    return _pieces(blocks)


def split(parts: int, rng: np.random.Generator) -> list[Block] | None:
    """Cut the box by planes into blocks; None if one is too small to be cut."""
    blocks = divided([WHOLE], parts - 1, _halved, rng)
    return blocks if blocks and is_even(blocks) else None


def volume(block: Block) -> int:
    """Compute the volume of a block, in steps of the grid."""
    return math.prod(extents(block))


def extents(block: Block) -> Triple:
    """Compute the extents of a block, in steps of the grid."""
    (x, y, z), (u, v, w) = block
    return u - x, v - y, w - z


def is_even(blocks: list[Block]) -> bool:
    """Decide whether no block is far smaller or larger than the mean."""
    mean = volume(WHOLE) / len(blocks)
    return all(SHARES[0] * mean <= volume(block) <= SHARES[1] * mean for block in blocks)


def separating_planes(blocks: list[Block]) -> list[tuple[int, int]]:
    """Find the planes (axis, step) inside the box that no block crosses."""
    return [
        (axis, at)
        for axis in range(3)
        for at in range(1, NODES)
        if not any(start[axis] < at < stop[axis] for start, stop in blocks)
    ]


def from_below(blocks: list[Block]) -> list[Block]:
    """Sort blocks so that none is below an earlier one."""
    return sorted(blocks, key=lambda block: (block[0][2], block[0][0], block[0][1]))


def moved(corner: Triple, axis: int, to: int) -> Triple:
    """Return a corner with another coordinate along an axis."""
    x, y, z = (to if n == axis else old for n, old in enumerate(corner))
    return x, y, z


def _pieces(blocks: list[Block]) -> list[PuzzlePiece]:
    return [PuzzlePiece.cuboid(*block) for block in from_below(blocks)]


def divided(
    blocks: list[Block],
    times: int,
    divide: Callable[[Block, np.random.Generator], list[Block] | None],
    rng: np.random.Generator,
) -> list[Block] | None:
    """Divide the largest block a number of times; None if one can't be divided."""
    blocks = list(blocks)
    for _ in range(times):
        largest = max(range(len(blocks)), key=lambda n: (volume(blocks[n]), -n))
        parts = divide(blocks.pop(largest), rng)
        if parts is None:
            return None
        blocks += parts
    return blocks


def _halved(block: Block, rng: np.random.Generator) -> list[Block] | None:
    """Cut a block by a plane."""
    start, stop = block
    axes = [axis for axis, side in enumerate(extents(block)) if side >= 2 * MIN_SIDE]
    if not axes:
        return None
    axis = int(rng.choice(axes))
    side = extents(block)[axis]
    least = max(MIN_SIDE, math.ceil(CUT[0] * side))
    most = min(side - MIN_SIDE, math.floor(CUT[1] * side))
    at = start[axis] + int(rng.integers(least, most + 1))
    return [(start, moved(stop, axis, at)), (moved(start, axis, at), stop)]


def whirled(block: Block, rng: np.random.Generator) -> list[Block] | None:
    """Cut a block into a pinwheel: four cuboids around a fifth, along a random axis."""
    sides = extents(block)
    long = [axis for axis in range(3) if sides[axis] >= 3 * MIN_SIDE]
    if len(long) < 2:
        return None
    u, v = (int(axis) for axis in rng.choice(long, 2, replace=False))
    (a, b), (c, d) = (_two_cuts(block, axis, rng) for axis in (u, v))
    start, stop = block
    (u0, v0), (u1, v1) = (start[u], start[v]), (stop[u], stop[v])
    plan = [(u0, v0, a, d), (u0, d, b, v1), (b, c, u1, v1), (a, v0, u1, c), (a, c, b, d)]
    return [
        (moved(moved(start, u, low), v, left), moved(moved(stop, u, high), v, right))
        for low, left, high, right in plan
    ]


def _two_cuts(block: Block, axis: int, rng: np.random.Generator) -> tuple[int, int]:
    """Draw two cuts of a side near its thirds."""
    side = extents(block)[axis]
    spare = side - 3 * MIN_SIDE
    first = MIN_SIDE + int(rng.integers(round(spare / 3 * 0.5), round(spare / 3 * 1.5) + 1))
    rest = side - first - 2 * MIN_SIDE
    second = first + MIN_SIDE + int(rng.integers(round(rest / 4), max(rest - rest // 4, 0) + 1))
    return block[0][axis] + first, block[0][axis] + second
