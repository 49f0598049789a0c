"""Removal of parts from their box: an order, and straight moves for each part.

One part moves at a time, without turning. A part that can be taken out can be put in by the same
moves in reverse, so that the reversed order is an order of packing. Each move is checked exactly
over its whole length (see `sweeps`). Only some of the places where a move may end are tried:
a part that is called stuck might come out by other moves, but no part that is called removable
is stuck.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from packit_sim.core.checks import Range, check_range
from packit_sim.core.choices import Door
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.parts.handling.sweeps import (
    AXES,
    OUT,
    SIDEWAYS,
    Direction,
    PartSweeps,
    check_door,
    sweeps_of,
)
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.packing import Packing

MOVES = 3
"""Largest number of straight moves of a part, the last of which leads out of the box."""

_STEP = 1 / 12
"""Distance between places where a move may end, relative to the container's longest side."""

_ENDS = 8
"""Largest number of other parts past whose ends a move may end, the nearest ones."""


@dataclass(frozen=True)
class Route:
    """The moves of a part out of the box.

    Attributes
    ----------
    moves : tuple of (Direction, float)
        The moves inside the box, in order: where to, and how far, in the container's unit.
    out : Direction
        The direction of the last move, out of the box.
    """

    moves: tuple[tuple[Direction, float], ...]
    out: Direction


@dataclass(frozen=True)
class StuckPart:
    """A part that can't be taken out.

    Attributes
    ----------
    part : int
        The number of its placement.
    by : tuple of int
        The numbers of the remaining parts between it and the door; where any way out counts (see
        `separability`), of those around it.
    is_proven : bool
        Whether it is certain that there is no way out; otherwise none was found.
    """

    part: int
    by: tuple[int, ...]
    is_proven: bool = False


@dataclass(frozen=True)
class Removal:
    """The removal of the parts of a packing, one after another.

    Attributes
    ----------
    order : tuple of int
        The numbers of the placements in the order of removal.
    routes : tuple of Route
        The route of each of them, past those that are still in the box.
    stuck : tuple of StuckPart
        The parts that remain.
    """

    order: tuple[int, ...]
    routes: tuple[Route, ...]
    stuck: tuple[StuckPart, ...]

    @property
    def packing_order(self) -> tuple[int, ...]:
        """An order in which they can be put in, after the stuck parts, which come first."""
        return (*(one.part for one in reversed(self.stuck)), *reversed(self.order))


def removable(
    packing: Packing, *, door: Door = "z+", moves: int = MOVES, fixed: Collection[int] = ()
) -> Removal:
    """Search for an order in which all parts of a packing can be taken out by straight moves.

    Parameters
    ----------
    packing : Packing
        The packing.
    door : str, default: "z+"
        The side of its boxes that is open, such as "x-"; by default the top.
    moves : int, default: 3
        Largest number of straight moves of a part, the last of which leads out of the box; 1 for
        parts that go straight out, so that they can be put in straight.
    fixed : collection of int
        Numbers of placements that stay where they are, such as parts that belong to the box.

    Returns
    -------
    Removal
        The order, box after box, the highest parts first; and the parts that are stuck.

    Raises
    ------
    ArgumentError
        If `moves` is not 1 to 3, there is no such door, or the container is no box: in a cylinder
        parts can only be lifted straight up.
    """
    check_range("moves", moves, Range(1, MOVES))
    check_door(door)
    form = form_of(packing.container)
    if form == "mesh" or (form == "cylinder" and (moves > 1 or door != "z+")):
        choice = "moves=1 through the top, or a box" if form == "cylinder" else "a box"
        raise ArgumentError(
            f"the removal from {packing.container.name!r}, a {form}, is not known: choose {choice}"
        )
    sweeps = sweeps_of(packing)
    return removal_of(sweeps, range(len(sweeps)), door=door, moves=moves, fixed=fixed)


def removal_of(
    sweeps: PartSweeps,
    kept: Sequence[int],
    *,
    door: Door = "z+",
    moves: int = MOVES,
    fixed: Collection[int] = (),
    stops: Mapping[int, int] = MappingProxyType({}),
) -> Removal:
    """Search for an order in which some parts of a packing, alone in it, can be taken out.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of the packing.
    kept : sequence of int
        The numbers of the parts that are in it.
    door : str, default: "z+"
        The side of its boxes that is open.
    moves : int, default: 3
        Largest number of straight moves of a part.
    fixed : collection of int
        The numbers of parts that stay where they are.
    stops : mapping of int to int
        The stop at which parts of a type are delivered, by its number: those of an earlier stop
        are taken out before all others. What is stuck at its stop is no obstacle after it.

    Returns
    -------
    Removal
        The order, and the parts that are stuck.
    """
    order: list[int] = []
    routes: list[Route] = []
    stuck: list[StuckPart] = []
    outs = (OUT[door],)
    placed = sweeps.packing.placements
    stages = {(placed[n].box, stops.get(placed[n].type, 0)) for n in kept if n not in fixed}
    left = sorted(kept, key=lambda n: (-sweeps.low[n, 2], -sweeps.high[n, 2], n))
    for stage in sorted(stages):
        there = [n for n in left if placed[n].box == stage[0]]
        loose = [n for n in there if n not in fixed and stops.get(placed[n].type, 0) == stage[1]]
        while found := next(_free(sweeps, loose, there, outs, moves), None):
            part, route = found
            for numbers in (loose, there, left):
                numbers.remove(part)
            order.append(part)
            routes.append(route)
        stuck += [StuckPart(n, _blockers(sweeps, n, there, outs)) for n in loose]
        left = [n for n in left if n not in loose]
    return Removal(tuple(order), tuple(routes), tuple(stuck))


def _free(
    sweeps: PartSweeps,
    loose: Sequence[int],
    left: Sequence[int],
    outs: tuple[Direction, ...],
    moves: int,
) -> Iterator[tuple[int, Route]]:
    """Yield parts that can be taken out, those with the fewest moves first."""
    there = frozenset(left)
    for number in range(1, moves + 1):
        for part in loose:
            key = part, number, outs
            if key in sweeps.held and sweeps.held[key] <= there:
                continue
            search = _Search(sweeps, part, left, outs)
            route = search.route(number)
            if route is not None:
                yield part, route
            else:
                sweeps.held[key] = frozenset(search.holding)


def route_out(sweeps: PartSweeps, part: int, others: Sequence[int]) -> Route | None:
    """Search for the fewest straight moves that lead a part out, also through the sides.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of the packing.
    part : int
        The number of the part.
    others : sequence of int
        The numbers of the others that are in the box.

    Returns
    -------
    Route or None
        The moves, at most `MOVES`, if there are some.
    """
    search = _Search(sweeps, part, [*others, part], ("up", *SIDEWAYS))
    routes = (search.route(moves) for moves in range(1, MOVES + 1))
    return next((route for route in routes if route is not None), None)


def _sideways(out: Direction) -> tuple[Direction, ...]:
    """Return the directions across another one."""
    directions: tuple[Direction, ...] = (*SIDEWAYS, "up", "down")
    return tuple(each for each in directions if AXES[each][0] != AXES[out][0])


_Way = tuple[tuple[tuple[Direction, float], ...], Floats]
"""Moves, and the shift (3,) to which they lead, relative to the longest side."""


class _Search:
    """The search for a way out of one part.

    holding: the parts that ended a move, or were in the way out.
    """

    def __init__(
        self, sweeps: PartSweeps, part: int, left: Sequence[int], outs: Sequence[Direction]
    ) -> None:
        self._sweeps = sweeps
        self._part = part
        self._left = left
        self._outs = outs
        self._forward = outs[0]
        self._sideways = _sideways(outs[0])
        self.holding: set[int] = set()

    def route(self, moves: int) -> Route | None:
        """Return a route of exactly so many moves, or None."""
        for before, shift in self._ways(moves - 1):
            for direction in self._outs:
                if self._is_clear(direction, shift):
                    return Route(before, direction)
        return None

    def _ways(self, moves: int) -> Iterator[_Way]:
        """Yield where the part gets by exactly so many straight moves inside the box."""
        if moves == 0:
            yield (), np.zeros(3)
            return
        for before, shift in self._ways(moves - 1):
            last = AXES[before[-1][0]][0] if before else None
            for direction in (self._forward, *self._sideways):
                axis, sign = AXES[direction]
                if axis == last or (direction == self._forward and before):
                    continue  # after a slide, a move to the door is of use only if it leads out
                for length in self._stops(direction, shift):
                    there = shift.copy()
                    there[axis] += sign * length
                    yield (*before, (direction, length * self._sweeps.unit)), there

    def _stops(self, direction: Direction, shift: Floats) -> list[float]:
        """Return the lengths of a move that are tried, for example where it passes a part."""
        sweeps, part = self._sweeps, self._part
        axis, sign = AXES[direction]
        low, high = sweeps.low[part] + shift, sweeps.high[part] + shift
        reach = float(low[axis] if sign < 0 else sweeps.size[axis] - high[axis])
        if direction == self._forward or reach == math.inf:  # open: until the part is past others
            ahead = [sweeps.high[n] - low if sign > 0 else high - sweeps.low[n] for n in self._left]
            reach = max(0.0, *(float(each[axis]) for each in ahead))
        for other, gap in sweeps.in_the_way(part, self._left, direction, shift):
            if gap >= reach or reach <= CONTACT_TOLERANCE:
                break
            distance = sweeps.distance(part, other, direction, shift) - CONTACT_TOLERANCE / 2
            if distance < reach:
                self.holding.add(other)
                reach = distance
        if reach <= CONTACT_TOLERANCE:
            return []
        others = [n for n in self._left if n != part]
        if direction != self._forward:
            others = [n for n, _ in sweeps.in_the_way(part, others, self._forward, shift)][:_ENDS]
        if sign > 0:
            ends = np.r_[
                sweeps.high[others, axis] - low[axis], sweeps.low[others, axis] - high[axis]
            ]
        else:
            ends = np.r_[
                high[axis] - sweeps.low[others, axis], low[axis] - sweeps.high[others, axis]
            ]
        ends = np.sort(ends[(ends > CONTACT_TOLERANCE) & (ends <= reach)])[: 2 * _ENDS]
        steps = np.arange(1, int(reach / _STEP) + 1) * _STEP
        return np.unique(np.r_[ends, steps, reach]).tolist()

    def _is_clear(self, direction: Direction, shift: Floats) -> bool:
        """Decide whether the part meets no other one on its way out."""
        near = self._sweeps.in_the_way(self._part, self._left, direction, shift)
        numbers = sorted((n for n, _ in near), key=lambda n: n not in self.holding)
        for other in numbers:
            if self._sweeps.meets(self._part, other, direction, shift):
                self.holding.add(other)
                return False
        return True


def _blockers(
    sweeps: PartSweeps, part: int, left: Sequence[int], outs: Sequence[Direction]
) -> tuple[int, ...]:
    """Return the parts that block a part's straight moves out of the box."""
    found = {
        n
        for direction in outs
        for n, _ in sweeps.in_the_way(part, left, direction)
        if sweeps.meets(part, n, direction)
    }
    return tuple(sorted(found))
