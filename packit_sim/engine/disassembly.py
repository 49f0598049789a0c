"""Routes into and out of a packed box: straight moves along the axes, one after another.

An item that can be removed can be inserted, by the reversed route. Each move is checked exactly
over its whole length (see `sweeping`); moves meet at grid locations, and the last one goes up and
out (see `insertion`). Items are not rotated, and only one of them moves at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from packit_sim.core.checks import Range, check_range
from packit_sim.core.sums import plain_sum
from packit_sim.engine import feasibility, insertion
from packit_sim.engine.feasibility import Mask
from packit_sim.engine.occupancy import Occupancy
from packit_sim.engine.sweeping import AxisNumber, free_distance
from packit_sim.geometry.items import Contents, PlacedItem
from packit_sim.geometry.lattice import CELL, MAX_CELLS, MOVES, STEP, Triple

_AXES: tuple[AxisNumber, ...] = (2, 0, 1)
_STEP = STEP * CELL

GridRoute = tuple[Triple, ...]
"""The locations where straight moves begin, from the item's location on; the last move goes up."""


@dataclass(frozen=True)
class Disassembly:
    """Routes of the items into a box and out of it.

    Attributes
    ----------
    volumes : tuple of float
        Volume of each item, in the order of placing.
    into : tuple of (GridRoute or None)
        The route of each item into the box, past those placed before it, in reverse: from its
        location outwards. None if no route with so few moves was found.
    out : tuple of (GridRoute or None)
        The route of each item out of the finished pack.
    interlocked : tuple of int
        Numbers of the items that remain when all items with a route out are removed, repeatedly.
    """

    volumes: tuple[float, ...]
    into: tuple[GridRoute | None, ...]
    out: tuple[GridRoute | None, ...]
    interlocked: tuple[int, ...]

    @property
    def insertable(self) -> float:
        """Share of the volume that can be inserted in the order of placing; 1 without items."""
        return routed_share(self.volumes, self.into)

    @property
    def insertable_from_above(self) -> float:
        """Share of the volume that can be inserted straight down; 1 without items."""
        straight = [route if route and len(route) == 1 else None for route in self.into]
        return routed_share(self.volumes, straight)

    @property
    def removable(self) -> float:
        """Share of the volume that can be removed first from the finished pack; 1 without items."""
        return routed_share(self.volumes, self.out)


def disassemble(box: Contents[PlacedItem], moves: int = MOVES) -> Disassembly:
    """Search for routes of all items into a box and out of it.

    Parameters
    ----------
    box : Contents
        The box and the items in it.
    moves : int, default: 3
        Maximum number of straight moves in a route, the last of which goes up.

    Returns
    -------
    Disassembly
        The routes.

    Raises
    ------
    ArgumentError
        If `moves` is less than 1.
    """
    into = insertion_routes(box, moves)
    placed = box.placed
    out = [
        find_route([*placed[:n], *placed[n + 1 :]], one, box.cells, moves)
        for n, one in enumerate(placed)
    ]
    volumes = tuple(one.item.volume for one in placed)
    return Disassembly(volumes, into, tuple(out), _interlocked(box, out, moves))


def insertion_routes(box: Contents[PlacedItem], moves: int = MOVES) -> tuple[GridRoute | None, ...]:
    """Search for a route of each item past those placed before it.

    Parameters
    ----------
    box : Contents
        The box and the items in it.
    moves : int, default: 3
        Maximum number of straight moves in a route, the last of which goes up.

    Returns
    -------
    tuple of (GridRoute or None)
        The routes, as in `Disassembly.into`.

    Raises
    ------
    ArgumentError
        If `moves` is less than 1.
    """
    check_range("moves", moves, Range(1))
    placed = box.placed
    return tuple(find_route(placed[:n], one, box.cells, moves) for n, one in enumerate(placed))


def routed_share(volumes: Sequence[float], routes: Sequence[GridRoute | None]) -> float:
    """Compute the share of the items' volume that has a route; 1 without items."""
    found = [volume for volume, route in zip(volumes, routes, strict=True) if route]
    return plain_sum(found) / plain_sum(volumes) if volumes else 1.0


def find_route(
    others: Sequence[PlacedItem], candidate: PlacedItem, cells: Triple, moves: int = MOVES
) -> GridRoute | None:
    """Search for a route with the fewest moves from an item's location out of a box.

    Parameters
    ----------
    others : sequence of PlacedItem
        The other items in the box.
    candidate : PlacedItem
        The item, at its location.
    cells : Triple
        The cells of the box along x, y and z.
    moves : int, default: 3
        Maximum number of straight moves, the last of which goes up.

    Returns
    -------
    GridRoute or None
        The route, or None if there is none with so few moves and all turning points on the grid.
        The item may rise above the box's open top, but it never crosses a wall.
    """
    if insertion.is_insertable(others, candidate):
        return (candidate.location,)
    x, y, z = cells
    rise = -(-candidate.item.cells[2] // STEP) * STEP
    tall: Occupancy[PlacedItem] = Occupancy((x, y, min(z + rise, MAX_CELLS)))
    for other in others:
        tall.add(other)
    free = feasibility.feasible(tall, candidate.item)
    ends = insertion.insertable_mask(others, candidate.item, free)
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
                    return _route(before, there)
                reached.append(there)
        corners = reached
    return None


def _straight(others: Sequence[PlacedItem], candidate: PlacedItem, free: Mask) -> Iterator[Triple]:
    """Yield the locations that an item reaches by one straight move."""
    for axis, forward in product(_AXES, (True, False)):
        there = np.array(candidate.location)
        there[axis] += 1 if forward else -1
        reach = None
        while 0 <= there[axis] < free.shape[axis] and free[tuple(there)]:
            if reach is None:  # computed only if the first step is feasible
                reach = _reach(others, candidate, axis, forward)
            if abs(int(there[axis]) - candidate.location[axis]) * _STEP > reach:
                break
            i, j, k = there.tolist()
            yield i, j, k
            there[axis] += 1 if forward else -1


def _reach(
    others: Sequence[PlacedItem], candidate: PlacedItem, axis: AxisNumber, forward: bool
) -> float:
    """Compute how far an item can move before it meets another, in box units."""
    return min(
        (
            free_distance(
                candidate.item, other.item, other.center - candidate.center, axis, forward
            )
            for other in others
            if _may_block(other, candidate, axis)
        ),
        default=np.inf,
    )


def _may_block(other: PlacedItem, candidate: PlacedItem, axis: AxisNumber) -> bool:
    """Decide whether the cell boxes of two items overlap, seen along an axis."""
    across: npt.NDArray[np.bool_] = np.array(other.start) < candidate.stop
    across &= np.array(candidate.start) < other.stop
    across[axis] = True
    return bool(across.all())


def _route(before: dict[Triple, Triple | None], end: Triple) -> GridRoute:
    route = [end]
    while (here := before[route[-1]]) is not None:
        route.append(here)
    return tuple(reversed(route))


def _interlocked(
    box: Contents[PlacedItem], out: Sequence[GridRoute | None], moves: int
) -> tuple[int, ...]:
    """Find the items that remain when all items with a route out are removed, repeatedly."""
    free = [n for n, route in enumerate(out) if route]
    left = [n for n, route in enumerate(out) if not route]
    while free and left:
        free = [
            n
            for n in left
            if find_route([box.placed[m] for m in left if m != n], box.placed[n], box.cells, moves)
        ]
        left = [n for n in left if n not in free]
    return tuple(left)
