"""Supports and loads of parts.

Parts are taken where they are after all of them have moved straight down, without turning, until
each rests on the floor or on another part. A part rests on everything that is within a contact
distance below it, seen straight down; equal shares of its weight, and of what rests on it, go to
each of these parts and to the floor. This is a rule, not statics: levers are ignored.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from packit_sim.core.checks import POSITIVE, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.handling.sweeps import PartSweeps, sweeps_of
from packit_sim.parts.packings.packing import Packing

CONTACT = 1e-3
"""Default contact distance, relative to the container's longest side that is not infinite."""


@dataclass(frozen=True)
class Stacking:
    """The supports of the parts of a packing, after they have moved straight down.

    Attributes
    ----------
    parts : tuple of int
        The numbers of the placements that were considered.
    drops : tuple of float
        How far each of them moves down, in the container's unit.
    supports : tuple of tuple of int
        The numbers of the placements on which each of them rests.
    on_floor : tuple of bool
        Whether it rests on the floor.
    """

    parts: tuple[int, ...]
    drops: tuple[float, ...]
    supports: tuple[tuple[int, ...], ...]
    on_floor: tuple[bool, ...]

    def on_top(self, part: int) -> tuple[int, ...]:
        """Return the numbers of the parts that rest directly on a part."""
        rows = zip(self.parts, self.supports, strict=True)
        return tuple(n for n, below in rows if part in below)

    def loads(self, masses: Sequence[float]) -> dict[int, float]:
        """Compute the mass that rests on each part, directly or through others.

        Parameters
        ----------
        masses : sequence of float
            The mass of each placement of the packing, in any unit.

        Returns
        -------
        dict of int to float
            The load of each part by its number. A part's mass and load are shared equally among
            the parts on which it rests and the floor.
        """
        index = {part: n for n, part in enumerate(self.parts)}
        shares = np.zeros((len(self.parts), len(self.parts)))
        for n, (below, floor) in enumerate(zip(self.supports, self.on_floor, strict=True)):
            for part in below:
                shares[index[part], n] = 1 / (len(below) + floor)
        own = np.array([float(masses[part]) for part in self.parts])
        loads = np.linalg.solve(np.eye(len(own)) - shares, shares @ own)  # parts may hook
        return dict(zip(self.parts, loads.tolist(), strict=True))


def stacking(
    packing: Packing, contact: float | None = None, fixed: Collection[int] = ()
) -> Stacking:
    """Find out what each part of a packing rests on.

    Parameters
    ----------
    contact : float, optional
        The contact distance in the container's unit; by default `CONTACT` of its longest side.
    fixed : collection of int
        Numbers of placements that stay where they are, such as parts that belong to the box.

    Returns
    -------
    Stacking
        How far the parts move down, and what they rest on then.

    Raises
    ------
    ArgumentError
        If `contact` is not above 0.
    """
    sweeps = sweeps_of(packing)
    return stacking_of(sweeps, range(len(sweeps)), contact, fixed)


def stacking_of(
    sweeps: PartSweeps,
    kept: Sequence[int],
    contact: float | None = None,
    fixed: Collection[int] = (),
) -> Stacking:
    """Find out what some parts of a packing rest on, alone in it.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of the packing.
    kept : sequence of int
        The numbers of the parts that are in it.
    contact : float, optional
        The contact distance in the container's unit.
    fixed : collection of int
        The numbers of parts that stay where they are; they count as on the floor.

    Returns
    -------
    Stacking
        How far they move down, and what they rest on then.

    Notes
    -----
    A part moves down by at most its height above the floor, and by at most the gap to a part below
    it more than that part does. The largest motions that respect all of this are shortest paths
    from the floor, where the gaps are the lengths: the parts come to rest together, also where two
    hook into each other.
    """
    if contact is not None:
        check_range("contact", contact, POSITIVE)
    near = CONTACT if contact is None else contact / sweeps.unit
    boxes = {n: sweeps.packing.placements[n].box for n in kept}
    gaps: dict[int, dict[int, float]] = {}  # by the lower part, then by the upper one
    for lower in kept:
        others = [n for n in kept if boxes[n] == boxes[lower]]
        above = sweeps.in_the_way(lower, others, "up")
        found = {upper: sweeps.distance(lower, upper, "up") for upper, _ in above}
        gaps[lower] = {
            upper: max(gap - sweeps.drawn_in(lower, upper), 0.0)
            for upper, gap in found.items()
            if gap < math.inf
        }
    floor = {n: 0.0 if n in fixed else max(float(sweeps.low[n, 2]), 0.0) for n in kept}
    drops = _shortest(floor, gaps)
    supports: dict[int, list[int]] = {n: [] for n in kept}
    for lower, uppers in gaps.items():
        for upper, gap in uppers.items():
            if drops[lower] + gap - drops[upper] <= near:
                supports[upper].append(lower)
    return Stacking(
        tuple(kept),
        tuple(drops[n] * sweeps.unit for n in kept),
        tuple(tuple(supports[n]) for n in kept),
        tuple(floor[n] - drops[n] <= near for n in kept),
    )


def lowered(packing: Packing, fixed: Collection[int] = ()) -> Packing:
    """Move all parts straight down until each rests on the floor or on another part.

    Parameters
    ----------
    packing : Packing
        A packing without a clearance.
    fixed : collection of int
        Numbers of placements that stay where they are.

    Returns
    -------
    Packing
        The same parts, as valid as before: no part passes another one.

    Raises
    ------
    ArgumentError
        If the packing has a clearance, which parts that touch would not keep.
    """
    if packing.clearance > 0:
        raise ArgumentError(
            f"a packing with a clearance of {packing.clearance:g} can't be lowered: "
            "parts would touch"
        )
    found = stacking(packing, fixed=fixed)
    placements = []
    for placement, drop in zip(packing.placements, found.drops, strict=True):
        placements.append(replace(placement, pose=placement.pose.shifted((0, 0, -drop))))
    return replace(packing, placements=tuple(placements))


def _shortest(floor: dict[int, float], gaps: dict[int, dict[int, float]]) -> dict[int, float]:
    """Return the shortest paths to all parts, by Dijkstra's algorithm."""
    waiting = [(height, n) for n, height in floor.items()]
    heapq.heapify(waiting)
    found: dict[int, float] = {}
    while waiting:
        drop, n = heapq.heappop(waiting)
        if n in found:
            continue
        found[n] = drop
        for upper, gap in gaps[n].items():
            if upper not in found:
                heapq.heappush(waiting, (drop + gap, upper))
    return found
