"""Ways into and out of a packed box: straight moves along the axes, one after another.

An item that can be taken out can be put in: the way is the same, the other way round. Moves are
exact all along (see `sweeping`); their corners are locations of the grid, and the last goes up and
out (see `lifting`). Nothing is turned on the way, and only one item moves at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import ArgumentError
from packit_sim.engine import feasibility, insertion
from packit_sim.engine.feasibility import Mask
from packit_sim.engine.items import Contents, PlacedItem
from packit_sim.engine.occupancy import Occupancy
from packit_sim.engine.sweeping import Axis, room
from packit_sim.geometry.lattice import CELL, MAX_CELLS, STEP, Triple

MOVES = 3
"""Straight moves that a way has at most: two along the axes, and up."""

_AXES: tuple[Axis, ...] = (2, 0, 1)
_STEP = STEP * CELL

Route = tuple[Triple, ...]
"""The locations where straight moves begin, from an item's place on; the last one goes up."""


@dataclass(frozen=True)
class Disassembly:
    """How items get into a box and out of it again.

    volumes: of the items, in order. into: how each gets to its place, past those placed before it,
    as the way back from there; out: how each gets out of the finished pack. None where no way of
    so many moves is found. interlocked: those that stay where everything that has a way out is
    taken out, one after another, until nothing that is left has one.
    """

    volumes: tuple[float, ...]
    into: tuple[Route | None, ...]
    out: tuple[Route | None, ...]
    interlocked: tuple[int, ...]

    @property
    def insertable(self) -> float:
        """Share of the volume that gets to its place in the order of placing; 1 where none is."""
        return share(self.volumes, self.into)

    @property
    def insertable_from_above(self) -> float:
        """Of these the share that comes straight down."""
        straight = [way if way and len(way) == 1 else None for way in self.into]
        return share(self.volumes, straight)

    @property
    def removable(self) -> float:
        """Share of the volume that gets out of the finished pack, each by itself."""
        return share(self.volumes, self.out)


def disassemble(box: Contents[PlacedItem], moves: int = MOVES) -> Disassembly:
    """Looks for ways of so many moves at most, the last of which goes up.

    Raises ValueError unless moves is at least 1.
    """
    into = insertion_routes(box, moves)
    placed = box.placed
    out = [
        find_route([*placed[:n], *placed[n + 1 :]], one, box.cells, moves)
        for n, one in enumerate(placed)
    ]
    volumes = tuple(one.item.volume for one in placed)
    return Disassembly(volumes, into, tuple(out), _interlocked(box, out, moves))


def insertion_routes(box: Contents[PlacedItem], moves: int = MOVES) -> tuple[Route | None, ...]:
    """How each item gets to its place, past those placed before it: `Disassembly.into` alone.

    Raises ValueError unless moves is at least 1.
    """
    if moves < 1:
        raise ArgumentError(f"moves {moves!r} is not possible: it must be at least 1")
    placed = box.placed
    return tuple(find_route(placed[:n], one, box.cells, moves) for n, one in enumerate(placed))


def share(volumes: Sequence[float], ways: Sequence[Route | None]) -> float:
    """Share of the volume of items that have a way; 1 where there are no items."""
    found = [volume for volume, way in zip(volumes, ways, strict=True) if way]
    return sum(found) / sum(volumes) if volumes else 1.0


def find_route(
    others: Sequence[PlacedItem], candidate: PlacedItem, cells: Triple, moves: int = MOVES
) -> Route | None:
    """A way of few moves for an item from its place out of a box of so many cells; None where there
    is none of so many moves.

    Of ways that are found none is shorter, counted in moves. On the way the item may rise above the
    box's open top, but not reach through its walls.
    """
    if insertion.is_clear(others, candidate):
        return (candidate.location,)
    x, y, z = cells
    rise = -(-candidate.item.cells[2] // STEP) * STEP
    tall: Occupancy[PlacedItem] = Occupancy((x, y, min(z + rise, MAX_CELLS)))
    for other in others:
        tall.add(other)
    free = feasibility.feasible(tall, candidate.item)
    ends = insertion.clear(others, candidate.item, free)
    before: dict[Triple, Triple | None] = {candidate.location: None}
    corners = [candidate.location]
    for _ in range(moves - 1):
        reached = []
        for here in corners:
            for there in _straight(others, PlacedItem(candidate.item, here), free):
                if there in before:
                    continue
                before[there] = here
                if ends[there]:
                    return _way(before, there)
                reached.append(there)
        corners = reached
    return None


def _straight(others: Sequence[PlacedItem], candidate: PlacedItem, free: Mask) -> Iterator[Triple]:
    """The locations that an item reaches by one straight move."""
    for axis, forward in product(_AXES, (True, False)):
        there = np.array(candidate.location)
        there[axis] += 1 if forward else -1
        reach = None
        while 0 <= there[axis] < free.shape[axis] and free[tuple(there)]:
            if reach is None:  # not asked where the first step is in conflict
                reach = _reach(others, candidate, axis, forward)
            if abs(int(there[axis]) - candidate.location[axis]) * _STEP > reach:
                break
            i, j, k = there.tolist()
            yield i, j, k
            there[axis] += 1 if forward else -1


def _reach(others: Sequence[PlacedItem], candidate: PlacedItem, axis: Axis, forward: bool) -> float:
    """How far an item can go, in box units, until it meets another."""
    return min(
        (
            room(candidate.item, other.item, other.center - candidate.center, axis, forward)
            for other in others
            if _in_the_way(other, candidate, axis)
        ),
        default=np.inf,
    )


def _in_the_way(other: PlacedItem, candidate: PlacedItem, axis: Axis) -> bool:
    """Whether the cell boxes of two items overlap, seen along an axis."""
    across: npt.NDArray[np.bool_] = np.array(other.start) < candidate.stop
    across &= np.array(candidate.start) < other.stop
    across[axis] = True
    return bool(across.all())


def _way(before: dict[Triple, Triple | None], end: Triple) -> Route:
    way = [end]
    while (here := before[way[-1]]) is not None:
        way.append(here)
    return tuple(reversed(way))


def _interlocked(
    box: Contents[PlacedItem], out: Sequence[Route | None], moves: int
) -> tuple[int, ...]:
    """What is left where all that has a way out is taken out, again and again."""
    free = [n for n, way in enumerate(out) if way]
    left = [n for n, way in enumerate(out) if not way]
    while free and left:
        free = [
            n
            for n in left
            if find_route([box.placed[m] for m in left if m != n], box.placed[n], box.cells, moves)
        ]
        left = [n for n in left if n not in free]
    return tuple(left)
