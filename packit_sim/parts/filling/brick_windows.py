"""More bricks in a container: take a few out of it, put one more in, and move them apart.

Algorithm: separation in windows. A window is where the container is emptiest, of some random
places. The bricks nearest to it are moved, together with one more, until none overlaps another, one
outside the window or a wall; else all stay as they were. Bricks are equal parts that fill their
bounding boxes, so that depths of boxes decide, which are a thousand times as fast as meshes. The
packing is checked by the meshes nevertheless.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt

from packit_sim.core.parallel import Threads
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.motions import Motion
from packit_sim.parts.filling.block_spaces import BlockSpace, voxel_side
from packit_sim.parts.filling.brick_kernels import separated
from packit_sim.parts.filling.task import PackTask
from packit_sim.parts.nesting.search_frames import searched_rotations
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.rotation_sets import FREE
from packit_sim.parts.packings.turning import ANY_TURN
from packit_sim.parts.reading.boxes import BoxType

BRICK = 1 - 1e-6
"""Least share of its bounding box that a brick fills."""

MOVED = 2, 12
"""Bricks that move, besides the new one: at least, and fewer than that."""

PLACES = 40
"""Random places of which the emptiest becomes a window."""

AROUND = 0.8
"""How far a window reaches beyond the centres of its bricks, in shortest sides."""

STEPS = 600
"""Most moves in a window."""

UNTURNED = 30
"""Windows without a gain after which bricks that may turn freely do so."""

TURNING = 0.25
"""Share of the windows in which they do then."""

SHRINKAGE, ROUNDING = 0.02, 1e-4
"""By which shares of the tolerance half sides are smaller, so that bricks that touch are apart: the
second one where they keep a clearance, of which a check allows for rounding alone."""

AT_ONCE = 3
"""Windows of each worker in a round, so that none waits long for the others."""

CHECKED = 500
"""Bricks for each gain between two checks by the meshes, which take as long as some windows."""


class _Bricks(NamedTuple):
    """Bricks in the space for parts: their centres (n, 3), and directions of sides (n, 3, 3)."""

    centres: Floats
    axes: Floats

    def changed(self, moved: Ints, new: _Bricks) -> _Bricks:
        """Return the bricks with some at new places, and the last of the new ones added."""
        centres, axes = self.centres.copy(), self.axes.copy()
        centres[moved], axes[moved] = new.centres[:-1], new.axes[:-1]
        return _Bricks(np.vstack((centres, new.centres[-1:])), np.vstack((axes, new.axes[-1:])))


@dataclass(frozen=True, eq=False)
class _Window:
    """Some bricks that move, and a new one.

    Attributes
    ----------
    moved : ndarray of int64, shape (n,)
        The bricks that move.
    new : _Bricks
        The new one.
    corners : tuple of ndarray of float64, shape (3,)
        Between which their centres stay.
    turns : bool
        Whether they turn by any angle.
    seed : int
        The seed of their moves.
    """

    moved: Ints
    new: _Bricks
    corners: tuple[Floats, Floats]
    turns: bool
    seed: int

    def meets(self, other: _Window, reach: float) -> bool:
        """Return whether a brick of one can meet a brick of the other."""
        (low, high), (lower, higher) = self.corners, other.corners
        return bool(((low < higher + reach) & (high > lower - reach)).all())


@dataclass(frozen=True, eq=False)
class Brick:
    """A part that fills its bounding box.

    Attributes
    ----------
    turn : ndarray of float64, shape (3, 3)
        The rotation after which its sides are parallel to the axes.
    middle, half : ndarray of float64, shape (3,)
        Its middle then, and half its sides.
    axes : ndarray of float64, shape (n, 3, 3)
        The directions of its sides, as rows, in each of its orientations.
    usual : int
        How many of these are usual, the first ones; in others, free parts lean.
    is_free : bool
        Whether it may turn by any angle.
    """

    turn: Floats
    middle: Floats
    half: Floats
    axes: Floats
    usual: int
    is_free: bool

    @classmethod
    def of(cls, own: ItemType) -> Brick | None:
        """Return a part as a brick, or None if it is none."""
        turns = searched_rotations(own)
        turned = np.einsum("nij,pj->npi", turns, own.vertices)
        full = np.flatnonzero(own.volume >= BRICK * np.ptp(turned, axis=1).prod(axis=1))
        if not len(full):
            return None
        first, (low, high) = turns[full[0]], _bounds(turned[full[0]])
        half = (high - low) / 2
        axes = _different(first @ np.swapaxes(turns, 1, 2), half)
        is_free = own.rotations == FREE
        leans = is_free & ~np.isin(np.abs(axes).round(9), (0, 1)).all(axis=(1, 2))
        axes = axes[leans.argsort(kind="stable")]
        usual = int(len(axes) - leans.sum())
        is_any = is_free and own.turning == ANY_TURN
        return cls(first, (low + high) / 2, half, axes, usual, is_any)

    def axes_and_centre(self, pose: Motion) -> tuple[Floats, Floats]:
        """Return the directions of its sides (3, 3) and its centre (3,) at a pose."""
        axes = self.turn @ pose.rotation.T
        return axes, self.middle @ axes + pose.translation

    def pose(self, axes: Floats, centre: Floats) -> Motion:
        """Return the pose of which these are the directions and the centre."""
        return Motion(axes.T @ self.turn, centre - self.middle @ axes)


def _bounds(points: Floats) -> tuple[Floats, Floats]:
    return points.min(axis=0), points.max(axis=0)


def _different(axes: Floats, half: Floats) -> Floats:
    """Return one of the axes (n, 3, 3) of each box that differs."""
    found: list[int] = []
    shapes = np.swapaxes(axes, 1, 2) * half @ axes  # equal for all axes of the same box
    for n, shape in enumerate(shapes):
        if not any(np.allclose(shape, shapes[k], atol=1e-6 * half.max()) for k in found):
            found.append(n)
    return axes[found]


class BrickWindows:
    """A search for more equal bricks in one box.

    Parameters
    ----------
    task : PackTask
        The task.
    box : BoxType
        The box.
    counts : mapping of int to int
        How many of each part may be in it.
    bodies : sequence of ItemType
        What is in the space for parts, or around it.
    seed : int
        The seed of the search.
    """

    def __init__(
        self,
        task: PackTask,
        box: BoxType,
        counts: Mapping[int, int],
        bodies: Sequence[ItemType],
        seed: int,
    ) -> None:
        self._task, self._box, self._bodies = task, box, bodies
        self._number, self._count = next(iter(counts.items()))
        is_plain = box.limits.is_empty and task.stretch == 1 and len(counts) == 1
        is_plain = is_plain and not (task.is_constrained or task.settings.groups or task.stops)
        self._brick = Brick.of(task.parts[self._number].item_type) if is_plain else None
        self._margin = task.search_margin
        self._size = np.array(box.size) - self._margin.lower - self._margin.upper
        self._gap = task.largest_gap
        self._choices = np.random.default_rng(seed)

    @property
    def is_possible(self) -> bool:
        """True for equal bricks without limits, groups or constraints."""
        return self._brick is not None

    def run(
        self,
        packing: Packing,
        rounds: int | None,
        is_over: Callable[[], bool],
        better: Callable[[Packing], None],
    ) -> None:
        """Search from a packing.

        Parameters
        ----------
        packing : Packing
            The packing to begin with.
        rounds : int or None
            Most rounds, with a few windows of each worker; None: until it is over.
        is_over : callable
            Whether to end.
        better : callable
            Called with each packing of more bricks, which is valid.
        """
        assert self._brick is not None
        self._prepare(self._brick)
        valid = bricks = self._bricks_of(self._brick, packing)
        with Threads(self._task.settings.workers) as threads:
            vain = 0
            for number in itertools.count(1):
                may_turn = self._brick.is_free and vain > UNTURNED
                some = self._windows(self._brick, bricks, AT_ONCE * threads.count, may_turn)
                jobs = [(self._brick, bricks, each) for each in some]
                for window, new in zip(some, threads.map(self._separated, jobs), strict=True):
                    vain = vain + 1 if new is None else 0
                    if new is not None:
                        bricks = bricks.changed(window.moved, new)
                is_last = not some or number == rounds or is_over()
                gain = len(bricks.centres) - len(valid.centres)
                if gain > (0 if is_last else len(bricks.centres) // CHECKED):
                    found = self._packing(self._brick, bricks)
                    if found.problems():
                        bricks = valid
                    else:
                        valid = bricks
                        better(found)
                if is_last:
                    return

    def _prepare(self, brick: Brick) -> None:
        """Find out where bricks can be."""
        voxel = voxel_side(self._size, 2 * float(brick.half.min()))
        space = BlockSpace(self._size, np.eye(3), voxel)
        walls = [np.empty((0, 3, 3)), *(body.vertices[body.faces] for body in self._bodies)]
        for triangles in walls:
            space.block_body(triangles, self._gap)
        self._space = space.blocked, voxel
        self._clear = voxel * distance_transform_edt(np.pad(~space.blocked, 1))[1:-1, 1:-1, 1:-1]
        self._walls = np.concatenate(walls)
        self._wall_bounds = self._walls.min(axis=1), self._walls.max(axis=1)
        gap, tolerance = self._gap, self._task.tolerance
        half = brick.half - (ROUNDING if gap else SHRINKAGE) * tolerance
        self._halves = np.array((half + gap / 2, brick.half - SHRINKAGE * tolerance, half + gap))
        self._reach = 2 * float(np.linalg.norm(self._halves[2]))

    def _bricks_of(self, brick: Brick, packing: Packing) -> _Bricks:
        poses = [one.pose.shifted(-self._margin.lower) for one in packing.placements]
        axes, centres = zip(*map(brick.axes_and_centre, poses), strict=True)
        return _Bricks(np.array(centres), np.array(axes))

    def _packing(self, brick: Brick, bricks: _Bricks) -> Packing:
        poses = [brick.pose(axes, centre) for centre, axes in zip(*bricks, strict=True)]
        placements = [Placement(self._number, pose.shifted(self._margin.lower)) for pose in poses]
        return self._task.packing(self._task.container(self._box), placements)

    def _windows(self, brick: Brick, bricks: _Bricks, count: int, may_turn: bool) -> list[_Window]:
        """Choose windows that do not meet; none if there is no more brick."""
        found: list[_Window] = []
        left = self._count - len(bricks.centres)
        for _ in range(2 * count):
            if len(found) == min(count, left):
                break
            window = self._window(brick, bricks, may_turn)
            if not any(window.meets(each, self._reach) for each in found):
                found.append(window)
        return found

    def _window(self, brick: Brick, bricks: _Bricks, may_turn: bool) -> _Window:
        choices, place = self._choices, self._empty_place(bricks)
        order = np.linalg.norm(bricks.centres - place, axis=1).argsort(kind="stable")
        moved = order[: choices.integers(*MOVED)]
        around = AROUND * 2 * brick.half.min()
        low, high = _bounds(np.vstack((bricks.centres[moved], place)))
        low, high = low - around, high + around
        centre = place if choices.random() < 0.5 else choices.uniform(low, high)
        turns = may_turn and choices.random() < TURNING
        axes = choices.choice(brick.axes if turns else brick.axes[: brick.usual])
        new = _Bricks(centre[None], axes[None])
        return _Window(moved, new, (low, high), turns, int(choices.integers(2**62)))

    def _empty_place(self, bricks: _Bricks) -> Floats:
        """Return the emptiest of some random places."""
        voxels, voxel = self._space
        places = self._choices.uniform(0, self._size, (PLACES, 3))
        ways = places[:, None] - bricks.centres
        along = np.abs(np.einsum("nij,pnj->pni", bricks.axes, ways))
        distances = np.linalg.norm(np.maximum(along - self._halves[0], 0), axis=2).min(axis=1)
        cells = np.minimum((places / voxel).astype(int), np.array(voxels.shape) - 1)
        return np.asarray(places[np.minimum(distances, self._clear[tuple(cells.T)]).argmax()])

    def _separated(self, brick: Brick, bricks: _Bricks, window: _Window) -> _Bricks | None:
        """Move the bricks of a window apart; return those that moved, the new one last, or None."""
        low, high = window.corners[0] - self._reach, window.corners[1] + self._reach
        is_near = np.asarray(((bricks.centres > low) & (bricks.centres < high)).all(axis=1))
        is_near[window.moved] = False
        centres, axes = (
            np.concatenate((own[window.moved], new, own[is_near]))
            for own, new in zip(bricks, window.new, strict=True)
        )
        lows, highs = self._wall_bounds
        walls = self._walls[((lows < high) & (highs > low)).all(axis=1)]
        movable = len(window.moved) + 1
        is_apart = separated(
            *((centres, axes, self._halves), movable, window.corners),
            brick.axes if window.turns else brick.axes[: brick.usual],
            *((walls, self._size), self._space, window.turns, STEPS),
            np.array([window.seed], np.uint64),
        )
        return _Bricks(centres[:movable], axes[:movable]) if is_apart else None
