"""Ways out: the moves, without turning, by which a part gets away from others.

Straight moves along the axes follow each other, as many as are needed, so that they also go round
corners and along curves. Voxels lead the way (see `offsets`) and prove where there is none; each
move is confirmed by exact sweeps (see `sweeps`). Walls are not in the way.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.parts.handling.offsets import Offsets, offsets_of
from packit_sim.parts.handling.removal import Route, route_out
from packit_sim.parts.handling.sweeps import AXES, Direction, PartSweeps

_ATTEMPTS = (2**16, 30), (2**19, 90), (2**21, 270)
"""Voxels of the part and its offsets in each attempt, and how many moves at most are tried.

The first ones are quick, and suffice for most parts."""

_BLOCKED = 8
"""The additional cost of a move towards a cell that is surely blocked: it ends before it."""


@dataclass(frozen=True)
class WayOut:
    """The answer to whether a part gets away from others.

    Attributes
    ----------
    route : Route, optional
        The moves, if some were found.
    is_proven : bool
        Whether it is certain: the moves are confirmed, or there are none.
    """

    route: Route | None
    is_proven: bool


def way_out(sweeps: PartSweeps, part: int, others: Sequence[int]) -> WayOut:
    """Search for moves that lead a part away from others.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of a packing.
    part : int
        The number of the part that moves.
    others : sequence of int
        The numbers of those that stay, all in the same box.

    Returns
    -------
    WayOut
        The moves, or whether it is proven that there are none.
    """
    there = frozenset(others)
    known = sweeps.ways_out.setdefault(part, [])
    for stayed, found in known:
        if stayed >= there if found.route else stayed <= there:
            return found
    found, stayed = _way_out(sweeps, part, others)
    known.append((stayed, found))
    return found


def _way_out(sweeps: PartSweeps, part: int, others: Sequence[int]) -> tuple[WayOut, frozenset[int]]:
    """Search for moves; return also the parts that decided it."""
    direction, _ = straight_out(sweeps, part, others)
    if direction is not None:
        return WayOut(Route((), direction), True), frozenset(others)
    near = [n for n in others if overlap(sweeps, part, n)]
    for around in [near, list(others)] if 0 < len(near) < len(others) else [list(others)]:
        low = sweeps.low[around].min(axis=0) - sweeps.high[part]
        high = sweeps.high[around].max(axis=0) - sweeps.low[part]
        close = [n for n in others if overlap(sweeps, part, n, low, high)]
        for voxels, tries in _ATTEMPTS:
            offsets = offsets_of(
                sweeps.triangles(part), map(sweeps.triangles, close), low, high, voxels
            )
            if offsets.cost(np.zeros(3)) is None:
                return WayOut(None, True), frozenset(close)
            route = _route(sweeps, part, others, offsets, tries)
            if route is not None:
                return WayOut(route, True), frozenset(others)
    route = route_out(sweeps, part, others)
    return WayOut(route, route is not None), frozenset(others)


def straight_out(
    sweeps: PartSweeps, part: int, others: Iterable[int]
) -> tuple[Direction | None, set[int]]:
    """Search for a direction along an axis in which a part meets none of some others.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of a packing.
    part : int
        The number of the part that moves.
    others : iterable of int
        The numbers of those that stay.

    Returns
    -------
    Direction or None
        The direction, if there is one.
    set of int
        Parts that are in the way in the directions before it.
    """
    holding: set[int] = set()
    for direction in AXES:
        near = (n for n, _ in sweeps.in_the_way(part, others, direction))
        met = next((n for n in near if sweeps.meets(part, n, direction)), None)
        if met is None:
            return direction, holding
        holding.add(met)
    return None, holding


def overlap(
    sweeps: PartSweeps, part: int, other: int, low: Floats | float = 0.0, high: Floats | float = 0.0
) -> bool:
    """Decide whether the bounding boxes of two parts overlap, at any offset of the first."""
    return bool(
        (sweeps.low[part] + low < sweeps.high[other]).all()
        and (sweeps.high[part] + high > sweeps.low[other]).all()
    )


_Moves = tuple[tuple[Direction, float], ...]


def _route(
    sweeps: PartSweeps, part: int, others: Sequence[int], offsets: Offsets, tries: int
) -> Route | None:
    """Search for exact moves, those first that are cheap by their offsets (A*)."""
    order = itertools.count()
    heap: list[tuple[float, int, float, Floats, _Moves, Direction]] = []
    seen = {np.zeros(3).tobytes()}

    def add(length: float, shift: Floats, moves: _Moves) -> None:
        """Add moves in all directions but those of the last move, which passed there."""
        here = offsets.cost(shift)
        last = AXES[moves[-1][0]][0] if moves else None
        for direction, (axis, sign) in AXES.items():
            if axis != last and here is not None:
                there = shift.copy()
                there[axis] += sign * offsets.cell
                ahead = offsets.cost(there)
                cost = here + _BLOCKED if ahead is None else ahead
                heapq.heappush(heap, (length + cost, next(order), length, shift, moves, direction))

    add(0.0, np.zeros(3), ())
    for _ in range(tries):
        if not heap:
            break
        _, _, length, shift, moves, direction = heapq.heappop(heap)
        reach = _reach(sweeps, part, others, direction, shift)
        if reach == math.inf:
            return Route(moves, direction)
        axis, sign = AXES[direction]
        for distance in _stops(reach, offsets.cell):
            there = shift.copy()
            there[axis] += sign * distance
            if offsets.cost(there) is None:
                break
            key = (np.round(there, 9) + 0.0).tobytes()
            if key not in seen:
                seen.add(key)
                step = direction, distance * sweeps.unit
                add(length + distance / offsets.cell, there, (*moves, step))
    return None


def _reach(
    sweeps: PartSweeps, part: int, others: Sequence[int], direction: Direction, shift: Floats
) -> float:
    """Return how far a part can move before it meets another; inf if it meets none."""
    reach = math.inf
    for other, gap in sweeps.in_the_way(part, others, direction, shift):
        if gap >= reach:
            break
        distance = sweeps.distance(part, other, direction, shift, CONTACT_TOLERANCE)
        reach = min(reach, distance)
    return reach - CONTACT_TOLERANCE / 2


def _stops(reach: float, cell: float) -> Iterator[float]:
    """Yield where a move may end: at the edges of cells, and where it meets something."""
    if reach > CONTACT_TOLERANCE:
        count = int(reach / cell)
        yield from (cell * np.arange(1, count + 1)).tolist()
        if reach > cell * count + CONTACT_TOLERANCE:
            yield reach
