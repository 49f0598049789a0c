"""Feasible locations of an item in a box, exactly.

Cheap filters come first: cell boxes, then the words of fine cells, and FCL for the few locations
that the words leave open. Items in the box may be on the grid or off it; the candidate is on the
grid. `oracle.oracle` computes the same by a plain loop; the two always agree. "Fits" is defined
in docs/concepts/exactness.md.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.core.counters import count
from packit_sim.core.debugging import is_checking
from packit_sim.core.errors import InfeasibleError
from packit_sim.engine import nofit, screening
from packit_sim.engine.collision import surfaces_conflict, surfaces_conflicts
from packit_sim.engine.occupancy import Occupancy
from packit_sim.engine.screening import (
    Locations,
    open_pairs,
    screen,
    screen_at,
    screen_pair,
)
from packit_sim.engine.screening_kernels import BLOCKED, FREE, OPEN, mark_free, next_unblocked
from packit_sim.geometry import rotations
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import ORIGIN, Triple, grid_nodes
from packit_sim.geometry.shapes import Item

Mask = npt.NDArray[np.bool_]

Decide = Callable[[Item, Locations], npt.NDArray[np.bool_]]
"""Stands in for the meshes: whether an item is feasible at each of n open locations: bool (n,)."""

WALLS = ("right", "front", "top")
"""The walls through which an item on the grid can protrude, by axis."""


def feasible(occupancy: Occupancy[Any], item: Item, decide: Decide | None = None) -> Mask:
    """Compute the exact mask of feasible locations.

    Parameters
    ----------
    occupancy : Occupancy
        The items already in the box.
    item : Item
        The item to place, in its rotation.
    decide : Decide, optional
        Decides the locations that cells leave open; by default the meshes do.

    Returns
    -------
    Mask
        Bool (nx, ny, nz) over the grid nodes, indexed [x, y, z].
    """
    mask = np.zeros(grid_nodes(occupancy.cells), dtype=bool)
    if not fits(occupancy.cells, item):
        return mask
    if decide is None:
        states, tables = _states(occupancy, item)
        undecided = mark_free(states, mask)
        mask[tuple(undecided.T)] = _feasible_at(occupancy, item, tables, undecided)
    else:
        states = screen(occupancy, item)
        undecided = mark_free(states, mask)
        mask[tuple(undecided.T)] = decide(item, undecided)
    count("masks", states.size, len(undecided))
    return mask


def candidates(occupancy: Occupancy[Any], item: Item) -> Mask:
    """Compute the mask of locations that no cells block.

    Parameters
    ----------
    occupancy : Occupancy
        The items already in the box.
    item : Item
        The item to place, in its rotation.

    Returns
    -------
    Mask
        Bool (nx, ny, nz) over the grid nodes, True wherever `feasible` is True.
    """
    mask = np.zeros(grid_nodes(occupancy.cells), dtype=bool)
    if fits(occupancy.cells, item):
        states, _ = _states(occupancy, item)
        x, y, z = states.shape
        np.not_equal(states, BLOCKED, out=mask[:x, :y, :z])
        count("masks", states.size, 0)
    return mask


def feasible_in_any(occupancy: Occupancy[Any], item: Item) -> Mask:
    """Compute the union of the exact masks of all 24 rotations.

    Parameters
    ----------
    occupancy : Occupancy
        The items already in the box.
    item : Item
        The item to place, in any rotation.

    Returns
    -------
    Mask
        Bool (nx, ny, nz) over the grid nodes, indexed [x, y, z].

    Notes
    -----
    The mask of PackIt-Easy (paper, section 4.3). Meshes are only compared at locations that are
    open in some rotation and free in none. There are no tables (see `nofit`): with 24 rotations
    each, two items seldom meet often enough.
    """
    mask = np.zeros(grid_nodes(occupancy.cells), dtype=bool)
    left_open = []
    for turned in map(item.turned, range(rotations.COUNT)):
        if not fits(occupancy.cells, turned):
            continue
        states = screen(occupancy, turned, mask)
        left_open.append((turned, states.size, mark_free(states, mask)))
    for turned, size, locations in left_open:
        undecided = locations[~mask[tuple(locations.T)]]
        mask[tuple(undecided.T)] = ~excluded(occupancy, turned, undecided)
        count("masks", size, len(undecided))
    return mask


def _states(
    occupancy: Occupancy[Any], item: Item
) -> tuple[npt.NDArray[np.uint8], Sequence[nofit.NoFit] | None]:
    """Compute the state of each location inside the box, and the tables that decide open ones."""
    tables = nofit.no_fit_tables(occupancy.placed, item)
    if tables is None:
        return screen(occupancy, item), None
    states = np.full(screening.location_counts(occupancy.cells, item), FREE, dtype=np.uint8)
    for placed, table in zip(occupancy.placed, tables, strict=True):
        table.merge_into(states, placed, item)
    if tables and is_checking():
        screened = screen(occupancy, item)
        assert ((states == screened) | (screened == OPEN)).all()
    return states, tables


def _feasible_at(
    occupancy: Occupancy[Any],
    item: Item,
    tables: Sequence[nofit.NoFit] | None,
    undecided: Locations,
) -> npt.NDArray[np.bool_]:
    """Decide whether the item is feasible at each of the open locations (n, 3): bool (n,)."""
    if tables is None:
        return ~excluded(occupancy, item, undecided)
    candidates = [PlacedItem(item, (i, j, k)) for i, j, k in undecided.tolist()]
    return np.array(
        [
            not any(
                table.conflict(placed, candidate)
                for placed, table in zip(occupancy.placed, tables, strict=True)
            )
            for candidate in candidates
        ],
        dtype=bool,
    )


def blbf(
    occupancy: Occupancy[Any],
    item: Item,
    start: Triple = ORIGIN,
    layers: int | None = None,
    decide: Decide | None = None,
) -> Triple | None:
    """Find the bottom-left-back-fill location: the first feasible one in the order of (z, x, y).

    Parameters
    ----------
    occupancy : Occupancy
        The items already in the box.
    item : Item
        The item to place, in its rotation.
    start : Triple, default: (0, 0, 0)
        The location at which the search starts.
    layers : int, optional
        The layers of nodes to search, from the lowest; all by default.
    decide : Decide, optional
        Decides the locations that cells leave open; by default the meshes do.

    Returns
    -------
    Triple or None
        The location (i, j, k), or None if the item fits nowhere in these layers.
    """
    if not fits(occupancy.cells, item):
        return None
    size = x, y, z = screening.location_counts(occupancy.cells, item)
    if layers is not None and layers < z:
        size = x, y, layers
    box, own = occupancy.arrays, item.voxels.arrays
    i, j, k = start
    number, undecided = (k * size[0] + i) * size[1] + j, 0
    while True:
        i, j, k, number, state = next_unblocked(box, own, size, number)
        if state == OPEN:
            undecided += 1
            if not _is_left_free(occupancy, PlacedItem(item, (i, j, k)), decide):
                continue
        count("searches", number, undecided)
        return None if state == BLOCKED else (i, j, k)


def first(mask: Mask) -> Triple | None:
    """Find the bottom-left-back-fill location of a mask; None if the mask is all False."""
    z, x, y = mask.transpose(2, 0, 1).nonzero()
    return (int(x[0]), int(y[0]), int(z[0])) if len(z) else None


def is_feasible(
    occupancy: Occupancy[Any], candidate: PlacedItem, decide: Decide | None = None
) -> bool:
    """Decide whether an item is feasible at its location: the mask's value there."""
    if not is_inside(occupancy.cells, candidate):
        return False
    state = screen_at(occupancy, candidate)
    count("checks", 1, state == OPEN)
    return state == FREE or (state == OPEN and _is_left_free(occupancy, candidate, decide))


def excluded(occupancy: Occupancy[Any], item: Item, locations: Locations) -> npt.NDArray[np.bool_]:
    """Decide by surfaces whether a placed item excludes the item at each of some locations.

    Parameters
    ----------
    occupancy : Occupancy
        The items already in the box.
    item : Item
        The item to place, in its rotation.
    locations : Locations
        (n, 3) int64, free or open ones. Only pairs that are open are compared.

    Returns
    -------
    ndarray
        Bool (n,).
    """
    found = np.zeros(len(locations), dtype=bool)
    if len(locations) == 0:
        return found
    placed = occupancy.placed
    pairs = open_pairs(occupancy, item, locations)
    counts = np.bincount(pairs[:, 1], minlength=len(placed))
    for m in np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)].tolist():
        numbers = pairs[pairs[:, 1] == m, 0]
        numbers = numbers[~found[numbers]]
        if len(numbers):
            found[numbers] = surfaces_conflicts(item, locations[numbers], placed[m])
    return found


def _is_left_free(occupancy: Occupancy[Any], candidate: PlacedItem, decide: Decide | None) -> bool:
    """Decide whether an item is feasible at one open location, with cached results about pairs."""
    location = np.array([candidate.location])
    if decide is not None:
        return bool(decide(candidate.item, location)[0])
    placed = occupancy.placed
    pairs = open_pairs(occupancy, candidate.item, location)
    return not any(surfaces_conflict(candidate, placed[m]) for m in pairs[:, 1].tolist())


@dataclass(frozen=True)
class Blockers:
    """The walls and items that block an item at a location; false if nothing does.

    Attributes
    ----------
    walls : tuple of str
        The walls through which its cell box protrudes: "right", "front" and "top" (x, y and z).
    items : tuple of int
        Numbers of the placed items with which it is in conflict, in the order of placing.
    above : tuple of int, default: ()
        Numbers of the placed items that it can't pass on its way down from the open top. Empty if
        there are other blockers.
    unsupported : bool, default: False
        Whether nothing else blocks it, but too little of its base rests on something.
    """

    walls: tuple[str, ...]
    items: tuple[int, ...]
    above: tuple[int, ...] = ()
    unsupported: bool = False

    def __bool__(self) -> bool:
        return bool(self.walls or self.items or self.above or self.unsupported)


def blockers(occupancy: Occupancy[PlacedItem], candidate: PlacedItem) -> Blockers:
    """Find each wall and each placed item that blocks an item at its location, exactly."""
    walls = tuple(
        wall
        for wall, stop, size in zip(WALLS, candidate.stop, occupancy.cells, strict=True)
        if stop > size
    )
    location = np.array([candidate.location])
    items = tuple(
        n
        for n, placed in enumerate(occupancy.placed)
        if (state := screen_pair(placed, candidate.item, location)[0]) == BLOCKED
        or (state == OPEN and surfaces_conflict(placed, candidate))
    )
    return Blockers(walls, items)


def fits(cells: Triple, item: Item) -> bool:
    """Decide whether the item's cell box is no larger than a box of this many cells."""
    x, y, z = cells
    a, b, c = item.cells
    return a <= x and b <= y and c <= z


def is_inside(cells: Triple, candidate: PlacedItem) -> bool:
    """Decide whether the candidate's cell box is inside a box of this many cells."""
    return all(stop <= c for stop, c in zip(candidate.stop, cells, strict=True))


def checked_location(cells: Triple, location: Sequence[int]) -> Triple:
    """Convert a location to a triple of ints.

    Parameters
    ----------
    cells : Triple
        The cells of the box along x, y and z.
    location : sequence of int
        The location (i, j, k).

    Returns
    -------
    Triple
        The location.

    Raises
    ------
    InfeasibleError
        If it is not a node of the grid.
    """
    nodes = grid_nodes(cells)
    try:
        i, j, k = (operator.index(n) for n in location)
    except (TypeError, ValueError):
        raise InfeasibleError(
            f"location {location!r} is not possible: it must be three whole numbers"
        ) from None
    if not all(0 <= n < count for n, count in zip((i, j, k), nodes, strict=True)):
        raise InfeasibleError(
            f"location {(i, j, k)} is outside the grid: "
            f"it reaches from (0, 0, 0) to {tuple(n - 1 for n in nodes)}"
        )
    return i, j, k
