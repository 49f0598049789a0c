"""Cuts by slanted and curved surfaces: blocks of the box, each cut into two pieces that fit.

The surface is a profile, which rises and falls along one axis of the block between two steps of the
grid, and is straight along another. It touches both steps, so that the pieces stand on the grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from packit_sim.game.generation.cuboid_cuts import Block, extents, from_below, moved, split, volume
from packit_sim.game.generation.puzzle_pieces import STEP_UNITS, UNITS, PuzzlePiece
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.lattice import CONTACT_TOLERANCE

GAP = round(4 * CONTACT_TOLERANCE * UNITS)
"""The distance of the two surfaces of a cut along its axis, in millionths of the box: 1/25 of a
cell. Collision meshes are drawn in towards the centre of a piece by half of the contact tolerance,
and so a surface beyond the centre moves outwards; at the steepest slope this takes two thirds of
the gap."""

STEEPEST = 1.5
"""The steepest slope of a profile."""

SEGMENTS = 12
"""Straight segments of a curved profile; the extremes of all of them are at ends of segments."""

MIN_RISE = 2
"""The least difference of a profile's extremes, in steps of the grid."""

MIN_THICKNESS = 1
"""The least thickness of a piece, in steps of the grid."""

SHARES = (0.3, 0.7)
"""The share of the block under the profile."""

_TURN = np.linspace(0, np.pi, SEGMENTS + 1)

PROFILES = {
    "slant": np.array([0.0, 1.0]),
    "bend": (1 - np.cos(_TURN)) / 2,
    "bump": np.sin(_TURN),
    "wave": (1 + np.sin(2 * _TURN)) / 2,
}
"""Heights of each profile, from 0 to 1, at equal distances."""

RISING = ("slant", "bend")
"""Profiles that only rise; along z others would lock the pieces against each other."""


@dataclass(frozen=True, eq=False)
class CutSurface:
    """A surface that cuts a block in two.

    Attributes
    ----------
    across : int
        The axis along which the two pieces follow each other.
    along : int
        The axis along which the profile rises and falls.
    heights : ndarray of float64
        The profile, from 0 to 1.
    low, high : int
        Its extremes, in steps from the start of the block.
    """

    across: int
    along: int
    heights: Floats
    low: int
    high: int

    def cut(self, block: Block) -> list[PuzzlePiece]:
        """Cut a block; the second piece can be put in from above after the first."""
        start = block[0]
        base, top = (corner[self.across] * STEP_UNITS for corner in block)
        rise = (self.high - self.low) * self.heights
        middle = base + np.rint((self.low + rise) * STEP_UNITS).astype(np.int64)
        half = GAP // 2
        ends = np.full_like(middle, base + half), np.full_like(middle, top - half)
        node = moved(start, self.across, start[self.across] + self.low)
        under = self._piece(block, start, ends[0], middle - half)
        over = self._piece(block, node, middle + half, ends[1])
        widens = self.along == 2 and self.heights[-1] > self.heights[0]
        return [over, under] if widens else [under, over]

    def _piece(
        self, block: Block, node: tuple[int, int, int], low: Ints, high: Ints
    ) -> PuzzlePiece:
        """Return the piece of a block between two heights."""
        straight = 3 - self.across - self.along
        ends = np.array(block) * STEP_UNITS
        near, far = ends[:, self.along]
        points = np.rint(np.linspace(near, far, len(low))).astype(np.int64)
        vertices = np.empty((len(points), 2, 2, 3), dtype=np.int64)  # point, straight, low or high
        vertices[..., self.across] = np.stack([low, high], axis=-1)[:, None]
        vertices[..., self.along] = points[:, None, None]
        vertices[..., straight] = ends[:, straight][:, None]
        names = np.arange(4 * len(points)).reshape(-1, 2, 2)
        here, next_ = names[:-1].reshape(-1, 4), names[1:].reshape(-1, 4)
        ring = [(0, 1), (1, 3), (3, 2), (2, 0)]
        faces = [
            *(np.column_stack([here[:, [b, a]], next_[:, [a, b]]]) for a, b in ring),
            names[:1].reshape(1, 4)[:, [0, 1, 3, 2]],
            names[-1:].reshape(1, 4)[:, [2, 3, 1, 0]],
        ]
        is_mirrored = (self.across, self.along) not in {(0, 1), (1, 2), (2, 0)}
        way = -1 if is_mirrored else 1
        return PuzzlePiece("curved", node, vertices.reshape(-1, 3), np.concatenate(faces)[:, ::way])


def curved(pieces: int, rng: np.random.Generator) -> list[PuzzlePiece] | None:
    """Cut the box by planes into blocks, and these by slanted and curved surfaces.

    Parameters
    ----------
    pieces : int
        The number of pieces; if it is odd, the smallest block remains whole.
    rng : numpy.random.Generator
        The generator that draws the cuts and the surfaces.

    Returns
    -------
    list of PuzzlePiece or None
        The pieces in an order in which they can be put in from above; None if a block is too small
        to be cut.
    """
    blocks = split((pieces + 1) // 2, rng)
    if blocks is None:
        return None
    whole = min(blocks, key=volume) if pieces % 2 else None
    found: list[PuzzlePiece] = []
    for block in from_below(blocks):
        if block is whole:
            found.append(PuzzlePiece.cuboid(*block))
            continue
        surface = _drawn(block, rng)
        if surface is None:
            return None
        found += surface.cut(block)
    return found


def _drawn(block: Block, rng: np.random.Generator) -> CutSurface | None:
    """Draw a surface that can cut a block: a profile, then one of its places; None if none can."""
    for name in rng.permutation(list(PROFILES)).tolist():
        possible = [
            surface
            for across, along in permutations(range(3), 2)
            if along != 2 or across == 2 or name in RISING
            for surface in _surfaces(block, across, along, PROFILES[name])
        ]
        if possible:
            return possible[rng.integers(len(possible))]
    return None


def _surfaces(block: Block, across: int, along: int, heights: Floats) -> list[CutSurface]:
    """List the surfaces of a profile, and of its mirror image, that can cut a block."""
    sides = extents(block)
    height, length = sides[across], sides[along]
    steepest = np.abs(np.diff(heights)).max() * (len(heights) - 1) / length
    least, most = (share * height for share in SHARES)
    return [
        CutSurface(across, along, form, low, high)
        for form in (heights, 1 - heights)
        for low in range(MIN_THICKNESS, height - MIN_THICKNESS)
        for high in range(low + MIN_RISE, height - MIN_THICKNESS + 1)
        if (high - low) * steepest <= STEEPEST
        and least <= low + (high - low) * float(form[1:].mean() + form[:-1].mean()) / 2 <= most
    ]
