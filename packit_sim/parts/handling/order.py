"""Orders of packing: from the lowest part up, as straight moves allow."""

from __future__ import annotations

from collections.abc import Sequence

from packit_sim.core.errors import ArgumentError
from packit_sim.parts.handling.constraints import Constraints
from packit_sim.parts.handling.removal import MOVES, Removal, Route, removal_of
from packit_sim.parts.handling.sweeps import OUT, PartSweeps, sweeps_of
from packit_sim.parts.packings.container_files import form_of
from packit_sim.parts.packings.packing import Packing


def packing_order(packing: Packing, constraints: Constraints | None = None) -> tuple[int, ...]:
    """Return an order in which the parts of a packing can be put in.

    Parameters
    ----------
    constraints : Constraints, optional
        The constraints that it meets: the door through which parts come in and by which moves,
        the stops at which they are delivered, and which parts are fixed.

    Returns
    -------
    tuple of int
        The numbers of the placements, box after box; in each box first the fixed parts, then those
        that are stuck (see `removal`), then all others, those of the last stop first, and of each
        stop from the lowest on.
    """
    sweeps = sweeps_of(packing)
    return order_of(sweeps, range(len(sweeps)), constraints or Constraints())


def order_faults(packing: Packing, constraints: Constraints) -> list[str]:
    """Find what is wrong with the order of the placements, as an order of packing.

    Parameters
    ----------
    constraints : Constraints
        The constraints that the packing meets, with straight moves.

    Returns
    -------
    list of str
        A sentence for each part that can't be put in straight past those before it, or that is
        delivered at a later stop than one of them.
    """
    sweeps, placed = sweeps_of(packing), packing.placements
    out, found = OUT[constraints.door], []
    for n, one in enumerate(placed):
        if n in constraints.fixed:
            continue
        earlier = [m for m in range(n) if placed[m].box == one.box]
        near = (m for m, _ in sweeps.in_the_way(n, earlier, out) if sweeps.meets(n, m, out))
        what = f"part {n + 1}, {packing.types[one.type].name!r},"
        if (blocker := next(near, None)) is not None:
            found.append(f"{what} can't be put in straight past part {blocker + 1}, before it")
        stops = [constraints.stops.get(placed[m].type) for m in (*earlier, n)]
        known = [stop for stop in stops if stop is not None]
        if known and known[-1] > min(known):
            found.append(
                f"{what} is for stop {known[-1]}, but comes after a part for stop {min(known)}"
            )
    return found


def removal_for(sweeps: PartSweeps, kept: Sequence[int], constraints: Constraints) -> Removal:
    """Search for the removal of some parts by the moves that are allowed (see `removal_of`).

    Only straight up where other moves might lead through a wall: in containers that are no boxes.
    """
    is_box = form_of(sweeps.packing.container) == "box"
    return removal_of(
        sweeps,
        kept,
        door=constraints.door,
        moves=MOVES if is_box and not constraints.is_straight else 1,
        fixed=constraints.fixed,
        stops=constraints.stops,
    )


def require_known_ways(what: str, name: str, packing: Packing) -> None:
    """Raise ArgumentError if nobody knows where the opening of a container is: of a mesh."""
    if form_of(packing.container) == "mesh":
        raise ArgumentError(f"{what} are not possible for {name!r}, a mesh: choose a box")


def order_of(sweeps: PartSweeps, kept: Sequence[int], constraints: Constraints) -> tuple[int, ...]:
    """Return an order in which some parts can be put in, as `packing_order`."""
    return ways_in(sweeps, kept, constraints)[0]


def ways_in(
    sweeps: PartSweeps, kept: Sequence[int], constraints: Constraints
) -> tuple[tuple[int, ...], dict[int, Route]]:
    """Return an order in which some parts can be put in, and the way out of each that has one."""
    removal = removal_for(sweeps, kept, constraints)
    order = (*sorted(constraints.fixed.intersection(kept)), *removal.packing_order)
    ordered = tuple(n for own in by_box(sweeps.packing, order) for n in own)
    return ordered, dict(zip(removal.order, removal.routes, strict=True))


def by_box(packing: Packing, order: Sequence[int]) -> list[tuple[int, ...]]:
    """Divide numbers of placements by their boxes; the order in each box stays."""
    boxes = [placement.box for placement in packing.placements]
    return [tuple(n for n in order if boxes[n] == box) for box in sorted({boxes[n] for n in order})]
