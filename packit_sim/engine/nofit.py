"""No-fit tables: the states of pairs of items at all offsets, for pairs that meet often.

In searches, and in training on fixed tasks, the same pairs meet in many arrangements. A table takes
some milliseconds to compute. With one for each placed item, a mask is roughly their maximum.
"""

from __future__ import annotations

from collections.abc import Sequence

from packit_sim.core.caches import bounded_cache
from packit_sim.engine.collision import surfaces_conflict
from packit_sim.engine.screening import States, screen_offsets
from packit_sim.engine.screening_kernels import BLOCKED, FREE, OPEN, merge
from packit_sim.geometry.items import ItemInBox, PlacedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item

TABLES_BUDGET = 128 * 2**20
"""Bytes in the process's cache of tables, about 10 kB each."""

PAIRS_BUDGET = 250_000
"""Pairs in the process's cache of meeting counts."""

MEETINGS_BEFORE_TABLE = 32
"""Mask queries with a pair of items before it gets a table: about the break-even number. It is
counted again after the table left the cache."""


class NoFit:
    """The states of a pair of items by offset; open ones are decided when they are needed.

    Parameters
    ----------
    first : Item
        The item with the smaller key.
    second : Item
        The other item.

    Attributes
    ----------
    states : States
        uint8 [x, y, z] for the second item at (x, y, z) - `reach` grid steps from the first.
    reach : Triple
        Grid steps from the first offset to offset 0.
    """

    def __init__(self, first: Item, second: Item) -> None:
        self.states = screen_offsets(first, second)
        x, y, z = second.voxels.number.shape
        self.reach: Triple = (x - 1, y - 1, z - 1)

    def merge_into(self, states: States, placed: PlacedItem, item: Item) -> None:
        """Raise the states of an item's locations to those that a placed item causes.

        Parameters
        ----------
        states : States
            uint8 [x, y, z] over the item's locations, changed in place.
        item : Item
            The item to place.
        """
        merge(states, self.states, self.reach, placed.location, self._sign(placed, item))

    def conflict(self, placed: PlacedItem, candidate: PlacedItem) -> bool:
        """Decide exactly whether the two items exclude each other where they are."""
        sign = self._sign(placed, candidate.item)
        x, y, z = (
            sign * (there - here) + reach
            for here, there, reach in zip(
                placed.location, candidate.location, self.reach, strict=True
            )
        )
        if not all(0 <= n < size for n, size in zip((x, y, z), self.states.shape, strict=True)):
            return False
        if self.states[x, y, z] == OPEN:
            self.states[x, y, z] = BLOCKED if surfaces_conflict(placed, candidate) else FREE
        return bool(self.states[x, y, z] == BLOCKED)

    def _sign(self, placed: PlacedItem, item: Item) -> int:
        """Return 1 if the placed item is the table's first, -1 if it is the second."""
        return 1 if placed.item.key <= item.key else -1


def no_fit_tables(placed: Sequence[ItemInBox], item: Item) -> list[NoFit] | None:
    """Look up the tables of an item and each placed item.

    Parameters
    ----------
    item : Item
        The item to place.

    Returns
    -------
    list of NoFit or None
        A table for each placed item; None if one of them is off the grid, or if a pair has no table
        and did not meet often enough.
    """
    if not all(isinstance(other, PlacedItem) for other in placed):
        return None
    pairs = [_ordered(other.item, item) for other in placed]
    kept = [_table.peek(*pair) for pair in pairs]
    earned = True
    for pair, table in zip(pairs, kept, strict=True):
        if table is None:
            earned &= _meetings(*pair).increment() > MEETINGS_BEFORE_TABLE
    if not earned:
        return None
    return [table or _table(*pair) for pair, table in zip(pairs, kept, strict=True)]


class _Meetings:
    """Number of meetings of a pair since it last got a table."""

    def __init__(self) -> None:
        self._count = 0

    def increment(self) -> int:
        self._count += 1
        return self._count

    def reset(self) -> None:
        self._count = 0


def _ordered(a: Item, b: Item) -> tuple[Item, Item]:
    return (a, b) if a.key <= b.key else (b, a)


@bounded_cache(
    "pairs that met",
    PAIRS_BUDGET,
    "pairs",
    size=lambda meetings: 1,
    key=lambda first, second: (first.key, second.key),
)
def _meetings(first: Item, second: Item) -> _Meetings:
    return _Meetings()


@bounded_cache(
    "no-fit tables",
    TABLES_BUDGET,
    "bytes",
    size=lambda table: table.states.nbytes,
    key=lambda first, second: (first.key, second.key),
)
def _table(first: Item, second: Item) -> NoFit:
    _meetings(first, second).reset()
    return NoFit(first, second)
