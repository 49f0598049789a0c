"""Lattices of equal blocks in containers that are no boxes: a packing to begin with.

Blocks are parts that nearly fill their bounding boxes. One lattice after the other is put into the
space that is left, each time the one of most value: in the frame of the container, and then also in
frames flush with its slanted walls. Voxels only propose: the packing is checked by the meshes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.block_spaces import SLACK, BlockSpace, voxel_side
from packit_sim.parts.filling.free_turns import flush_frames
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.nesting.search_frames import searched_rotations
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.boxes import BoxType

BLOCK = 0.9
"""Least share of its bounding box that a block fills."""

MOST_TYPES = 4
"""Most types of blocks: each has up to six orientations in each frame."""


@dataclass(frozen=True)
class _Block:
    """A part in a rotation, in a frame in which its bounding box is nearly full."""

    type: int
    turn: Floats
    low: Floats
    sides: Floats
    value: float


@dataclass(frozen=True, eq=False)
class _Lattice:
    frame: int
    block: _Block
    offset: Floats
    count: int
    value: float


def latticed(
    task: PackTask,
    box: BoxType,
    counts: Mapping[int, int],
    bodies: Sequence[ItemType],
    is_over: Callable[[], bool],
) -> Packing | None:
    """Fill a box with lattices of blocks.

    Parameters
    ----------
    counts : mapping of int to int
        How many of each part.
    bodies : sequence of ItemType
        What is in the space for parts, or around it.
    is_over : callable
        Whether to end with the best filling so far.

    Returns
    -------
    Packing or None
        The filled box, which is valid; None if there are no blocks, or no space for them.
    """
    margin = task.search_margin
    size = np.array(box.size) - margin.lower - margin.upper
    frames = [np.eye(3), *flush_frames(box.container)]
    filling = _LatticeFilling(task, counts, size, bodies, frames, is_over)
    placements = [replace(one, pose=Motion.shift(margin.lower) @ one.pose) for one in filling.run()]
    packing = task.packing(task.container(box), placements)
    return None if not placements or packing.problems() else packing


class _LatticeFilling:
    """Filling of a container with lattices.

    Parameters
    ----------
    size : ndarray of float64, shape (3,)
        The sides of the space for parts.
    bodies : sequence of ItemType
        What is in it already, or around it.
    frames : sequence of ndarray of float64, shape (3, 3)
        The frames of lattices: rotations to the container, the identity first.
    is_over : callable
        Whether to end with the best filling so far.
    """

    def __init__(
        self,
        task: PackTask,
        counts: Mapping[int, int],
        size: Floats,
        bodies: Sequence[ItemType],
        frames: Sequence[Floats],
        is_over: Callable[[], bool],
    ) -> None:
        self._task, self._counts, self._is_over = task, dict(counts), is_over
        self._size, own = size, [(frame, self._blocks_in(frame)) for frame in frames]
        self._frames = [frame for frame, blocks in own if blocks]
        self._blocks = [blocks for _, blocks in own if blocks]
        sides = [block.sides for own in self._blocks for block in own]
        shortest = min((float(each.min()) for each in sides), default=1.0)
        self._gaps = task.largest_gap * np.array((1.0, 1.0, 1 / task.stretch))
        self._voxel = voxel_side(size, shortest)
        self._bodies = bodies

    def run(self) -> tuple[Placement, ...]:
        """Return the most valuable placements found, in the coordinates of the space."""
        types = {block.type for own in self._blocks for block in own}
        if not 0 < len(types) <= MOST_TYPES:
            return ()
        grow = float(self._gaps.max())
        empty = [BlockSpace(self._size, frame, self._voxel) for frame in self._frames]
        for space in empty:
            for body in self._bodies:
                space.block_body(body.vertices[body.faces], grow)
        best = self._best(empty[:1], ())
        if len(empty) > 1 and not self._is_over():
            rest = [each.copy() for each in empty]
            for space in rest:
                space.block(self._triangles(best), grow)
            best = self._filled(rest, best)
            best = self._best(empty, best)
        return tuple(best)

    def _best(self, empty: Sequence[BlockSpace], best: Sequence[Placement]) -> Sequence[Placement]:
        """Return the most valuable filling that begins with one lattice, or one that is better.

        With several frames, it begins with a lattice of the others that has no less value than all
        of the first one: with less, nothing was ever gained.
        """
        lattices = self._lattices(empty, self._counts)
        if len(empty) > 1:
            least = max((each.value for each in lattices if each.frame == 0), default=0.0)
            lattices = [each for each in lattices if each.frame > 0 and each.value >= least]
        for lattice in sorted(lattices, key=lambda each: -each.value):
            found = self._filled([each.copy() for each in empty], (), lattice)
            best = max(best, found, key=self._worth)
            if self._is_over():
                break
        return best

    def _worth(self, placements: Sequence[Placement]) -> float:
        return sum(self._task.weights[one.type] for one in placements)

    def _blocks_in(self, frame: Floats) -> list[_Block]:
        """Return the blocks of all parts, one of those that are equal but for a symmetry."""
        found: list[_Block] = []
        for n in self._counts:
            own = self._task.parts[n].item_type
            known: list[Floats] = []
            for turn in searched_rotations(own):
                vertices = own.vertices @ (frame.T @ turn).T
                sides = np.ptp(vertices, axis=0)
                if own.volume < BLOCK * sides.prod() or any(
                    np.allclose(sides, each, rtol=1e-6) for each in known
                ):
                    continue
                known.append(sides)
                low = vertices.min(axis=0)
                found.append(_Block(n, turn, low, sides, self._task.weights[n]))
        return found

    def _pitch(self, frame: int) -> Floats:
        """Return the gaps (3,) between blocks in a frame, where z may not be upright."""
        is_upright = np.array_equal(self._frames[frame], np.eye(3))
        return self._gaps if is_upright else np.full(3, self._gaps.max())

    def _lattices(self, spaces: Sequence[BlockSpace], left: Mapping[int, int]) -> list[_Lattice]:
        """Return the best offset of the lattice of each block."""
        found = []
        for number, (space, blocks) in enumerate(zip(spaces, self._blocks, strict=False)):
            for block in blocks:
                if left[block.type] == 0 or self._is_over():
                    continue
                offset, count = space.best_offset(block.sides, block.sides + self._pitch(number))
                count = min(count, left[block.type])
                if count:
                    value = count * block.value
                    found.append(_Lattice(number, block, offset, count, value))
        return found

    def _filled(
        self,
        spaces: Sequence[BlockSpace],
        first: Sequence[Placement],
        lattice: _Lattice | None = None,
    ) -> list[Placement]:
        """Put one lattice after the other into what is left, beginning with a given one."""
        found, left = list(first), dict(self._counts)
        for one in first:
            left[one.type] -= 1
        while True:
            if lattice is None:
                others = self._lattices(spaces, left)
                lattice = max(others, key=lambda each: each.value, default=None)
            if lattice is None:
                return found
            block, frame = lattice.block, self._frames[lattice.frame]
            pitches = block.sides + self._pitch(lattice.frame)
            places = spaces[lattice.frame].free(block.sides, pitches, lattice.offset)
            poses = [
                Motion(block.turn, frame @ (place - block.low)) for place in places[: lattice.count]
            ]
            more = [Placement(block.type, pose) for pose in poses]
            for space in spaces:
                space.block(self._triangles(more), float(self._gaps.max()))
            found += more
            left[block.type] -= len(more)
            lattice = None

    def _triangles(self, placements: Sequence[Placement]) -> Floats:
        """Return the triangles (n, 3, 3) of parts that are a little smaller, to block voxels."""
        found = []
        for one in placements:
            own = self._task.parts[one.type].item_type
            middle = own.middle
            vertices = middle + (own.vertices - middle) * (1 - 2 * SLACK)
            found.append(one.apply(vertices)[own.faces])
        return np.concatenate(found) if found else np.empty((0, 3, 3))
