"""No-fit tables: what is known of two items at every offset, for pairs that meet again and again.

In search and in training on fixed tasks the same pairs meet in ever new arrangements. A table costs
some milliseconds; with one for each placed item, a mask is little more than their maximum.
"""

from __future__ import annotations

from collections.abc import Sequence

from packit_sim.core.caches import bounded_cache
from packit_sim.engine.collision import collides_memo
from packit_sim.engine.items import ItemInBox, PlacedItem
from packit_sim.engine.screening import States, screen_offsets
from packit_sim.engine.screening_kernels import BLOCKED, FREE, OPEN, merge
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item

TABLES_BUDGET = 256 * 2**20
"""Bytes in the process's cache of tables, about 10 kB each."""

PAIRS_BUDGET = 250_000
"""Pairs of which the process counts the meetings."""

MEETINGS = 32
"""How often two items meet in mask queries before they get a table: about when what the queries
cost without one comes to what it costs. So too after their table had to go."""


class NoFit:
    """The states of a pair of items by offset; an open one is decided when it is asked for.

    states: uint8 [x, y, z] for the second item at (x, y, z) - reach grid steps from the first.
    """

    def __init__(self, first: Item, second: Item) -> None:
        self.states = screen_offsets(first, second)
        x, y, z = second.voxels.number.shape
        self.reach: Triple = (x - 1, y - 1, z - 1)

    def merge_into(self, states: States, placed: PlacedItem, item: Item) -> None:
        """Raises the states of an item's locations to what this placed one makes of them."""
        merge(states, self.states, self.reach, placed.location, self._sign(placed, item))

    def conflict(self, placed: PlacedItem, candidate: PlacedItem) -> bool:
        """Whether the two can't both stand where they are, exactly."""
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
            self.states[x, y, z] = BLOCKED if collides_memo(placed, candidate) else FREE
        return bool(self.states[x, y, z] == BLOCKED)

    def _sign(self, placed: PlacedItem, item: Item) -> int:
        """1 where the placed item is the table's first, -1 where it is its second."""
        return 1 if placed.item.key <= item.key else -1


def tables(placed: Sequence[ItemInBox], item: Item) -> list[NoFit] | None:
    """Look up the tables of an item and each placed one.

    None if a placed item is off the grid, or if a pair has no table and did not meet often enough.
    """
    if not all(isinstance(other, PlacedItem) for other in placed):
        return None
    pairs = [_ordered(other.item, item) for other in placed]
    kept = [_table.peek(*pair) for pair in pairs]
    earned = True
    for pair, table in zip(pairs, kept, strict=True):
        if table is None:
            earned &= _meetings(*pair).another() > MEETINGS
    if not earned:
        return None
    return [table or _table(*pair) for pair, table in zip(pairs, kept, strict=True)]


class _Meetings:
    """How often a pair met since it last got a table."""

    def __init__(self) -> None:
        self._count = 0

    def another(self) -> int:
        self._count += 1
        return self._count

    def forget(self) -> None:
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
    _meetings(first, second).forget()
    return NoFit(first, second)
