"""Separability of packings: whether all parts can be moved apart without turning.

One part moves at a time, past those that remain, along straight or curved ways, and no wall is in
its way: the question is whether parts interlock, not whether a hand can reach them. Parts that
were moved out make room for others. Two parts are *linked* if neither can be moved away from the
other, as two links of a chain.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.core.caches import bounded_cache
from packit_sim.core.check_reports import named
from packit_sim.parts.handling.removal import Removal, Route, StuckPart
from packit_sim.parts.handling.sweeps import PartSweeps, sweeps_of
from packit_sim.parts.handling.ways_out import WayOut, overlap, straight_out, way_out
from packit_sim.parts.packings.packing import Packing

_MOST_NAMED = 10
"""Largest number of linked pairs that a text names."""


@dataclass(frozen=True)
class LinkedPair:
    """Two parts that can't be moved apart from each other without turning.

    Attributes
    ----------
    parts : tuple of (int, int)
        The numbers of their placements.
    is_proven : bool
        Whether it is certain that there is no way; otherwise none was found.
    """

    parts: tuple[int, int]
    is_proven: bool


def separable(packing: Packing, *, fixed: Collection[int] = ()) -> Removal:
    """Search for an order in which all parts of a packing can be moved out without turning.

    Parameters
    ----------
    packing : Packing
        The packing. Its walls are not in the way.
    fixed : collection of int
        Numbers of placements that stay where they are.

    Returns
    -------
    Removal
        The order, box after box; and the parts that are stuck. It finds a way out for each part
        that `removable` finds one for.
    """
    sweeps = sweeps_of(packing)
    return separability_of(sweeps, range(len(sweeps)), fixed=fixed)


def separability_of(
    sweeps: PartSweeps, kept: Sequence[int], *, fixed: Collection[int] = ()
) -> Removal:
    """Search for an order in which some parts of a packing, alone in it, can be moved out.

    Parameters
    ----------
    sweeps : PartSweeps
        The parts of the packing.
    kept : sequence of int
        The numbers of the parts that are in it.
    fixed : collection of int
        The numbers of parts that stay where they are.

    Returns
    -------
    Removal
        As `separable`.
    """
    out: list[tuple[int, Route]] = []
    stuck: list[StuckPart] = []
    for box in sorted({sweeps.packing.placements[n].box for n in kept}):
        left = [n for n in kept if sweeps.packing.placements[n].box == box]
        left.sort(key=lambda n: (-sweeps.low[n, 2], -sweeps.high[n, 2], n))
        for part, route in _ways_out(sweeps, left, fixed):
            left.remove(part)
            out.append((part, route))
        stuck += [_stuck(sweeps, n, left) for n in left if n not in fixed]
    return Removal(tuple(n for n, _ in out), tuple(route for _, route in out), tuple(stuck))


def _ways_out(
    sweeps: PartSweeps, left: Sequence[int], fixed: Collection[int]
) -> Iterator[tuple[int, Route]]:
    """Yield the parts that can be moved out, one after the other; the caller removes them."""
    held: dict[int, set[int]] = {}
    while True:
        moved = False
        for part in [n for n in left if n not in fixed]:
            if part in held and held[part].issubset(left):
                continue
            direction, held[part] = straight_out(sweeps, part, _others(left, part))
            if direction is not None:
                moved = True
                yield part, Route((), direction)
        if moved:
            continue
        loose = [n for n in left if n not in fixed]
        ways = (
            (n, way_out(sweeps, n, _others(left, n))) for n in loose if not _links(sweeps, n, left)
        )
        found = next(((n, way.route) for n, way in ways if way.route is not None), None)
        if found is None:
            return
        yield found


def _stuck(sweeps: PartSweeps, part: int, left: Sequence[int]) -> StuckPart:
    others = _others(left, part)
    links = _links(sweeps, part, left)
    _, holding = straight_out(sweeps, part, others)
    if links:
        is_proven = any(_way_apart(sweeps, part, n).is_proven for n in links)
    else:
        is_proven = way_out(sweeps, part, others).is_proven
    return StuckPart(part, tuple(links or sorted(holding)), is_proven)


def _links(sweeps: PartSweeps, part: int, left: Sequence[int]) -> list[int]:
    """Return the parts from which alone no way was found."""
    near = (n for n in sorted(left) if n != part and overlap(sweeps, part, n))
    return [n for n in near if _way_apart(sweeps, part, n).route is None]


def _others(left: Sequence[int], part: int) -> list[int]:
    return [n for n in left if n != part]


def _way_apart(sweeps: PartSweeps, one: int, other: int) -> WayOut:
    """Search for a way that leads two parts away from each other: the smaller one moves."""
    size = np.prod(sweeps.high[[one, other]] - sweeps.low[[one, other]], axis=1)
    mover, stays = (one, other) if size[0] <= size[1] else (other, one)
    found = way_out(sweeps, mover, (stays,))
    known = sweeps.ways_out.setdefault(stays, [])
    if found.route is None and (frozenset((mover,)), found) not in known:
        known.append((frozenset((mover,)), found))
    return found


@bounded_cache("linked pairs", 64, "packings", lambda _: 1, lambda packing: packing)
def linked_pairs(packing: Packing) -> tuple[LinkedPair, ...]:
    """Find the pairs of parts that can't be moved apart from each other without turning.

    Returns
    -------
    tuple of LinkedPair
        The pairs, as if no other part was there. Pairs for which no way was found, though it is
        not proven that there is none, are in doubt.
    """
    sweeps = sweeps_of(packing)
    boxes = np.array([placement.box for placement in packing.placements], dtype=int)
    found = []
    for one in range(len(sweeps)):
        near = (sweeps.low[one] < sweeps.high[one + 1 :]).all(axis=1)
        near &= (sweeps.high[one] > sweeps.low[one + 1 :]).all(axis=1)
        near &= boxes[one + 1 :] == boxes[one]
        for other in (one + 1 + np.flatnonzero(near)).tolist():
            way = _way_apart(sweeps, one, other)
            if way.route is None:
                found.append(LinkedPair((one, other), way.is_proven))
    return tuple(found)


def links_of_items(packing: Packing) -> str:
    """Name the linked pairs of a packing, by the numbers of its items and the names of their types.

    Returns
    -------
    str
        See `links_in_words`.
    """
    names = [named(n, packing.types[one.type].name) for n, one in enumerate(packing.placements)]
    return links_in_words(linked_pairs(packing), names)


def links_in_words(pairs: Sequence[LinkedPair], names: Sequence[str]) -> str:
    """Name linked pairs.

    Parameters
    ----------
    names : sequence of str
        The names of all placements.

    Returns
    -------
    str
        The names of the parts of each pair, or "none".
    """
    texts = [
        f"{names[a]} and {names[b]}{'' if one.is_proven else ' (not proven)'}"
        for one in pairs[:_MOST_NAMED]
        for a, b in [one.parts]
    ]
    if len(pairs) > _MOST_NAMED:
        texts.append(f"{len(pairs) - _MOST_NAMED} more")
    return "; ".join(texts) or "none"
