"""Free space: all locations at which items outside a box still fit, in all rotations.

Free space only shrinks while items are added, so only locations at which an item can meet the one
that was added last are looked at again. Locations that are left may still be infeasible: cells do
not block them, but the meshes decide (`Box.is_feasible`).

In a kinematic box, cells also block what they cover: a location at which an inner cell of the item
would be below an outer cell in the box, or an outer one below an inner one, can't be reached from
above. So the item must not meet the *shadow* of the box, which also fills all cells below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_agents.placements.free_kernels import (
    TurnedArrays,
    fits_far,
    fits_near,
    remove_blocked,
    shadow,
    turn_item,
)
from packit_sim.box import BaseBox
from packit_sim.core.caches import bounded_cache, cached_property
from packit_sim.core.debugging import is_checking
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry import rotations
from packit_sim.geometry.bits import Words, turning_swaps
from packit_sim.geometry.lattice import STEP, Triple, grid_nodes
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import Voxels
from packit_sim.placement import Occupancy, PlacedItem, fits, location_counts

MAX_NODES = 63
"""Grid nodes along y that a row has bits for."""

ALL_ROTATIONS = tuple(range(rotations.COUNT))

TURNED_BUDGET = 512 * 2**20
"""Maximum size of all cached items in their rotations, in bytes."""

_TABLES = [turning_swaps(rotation) for rotation in ALL_ROTATIONS]
_MAX_SWAPS = max(map(len, _TABLES))
_NO_FINE: Words = np.zeros((1, 64, 2), dtype=np.uint64)
"""A page without fine cells, for all bricks of a shadow."""

_SWAPS = np.stack([np.pad(table, ((0, _MAX_SWAPS - len(table)), (0, 0))) for table in _TABLES])
"""The `turning_swaps` of each rotation, with rows of zeros at the end, which have no effect."""


@dataclass(frozen=True, eq=False)
class TurnedItem:
    """An item in those of some rotations in which its cells differ.

    Attributes
    ----------
    items : tuple of Item
        The item in each of these rotations.
    arrays : tuple
        Fields of the `TurnedArrays`.
    """

    items: tuple[Item, ...]
    arrays: tuple[Any, ...]

    @property
    def nbytes(self) -> int:
        """Size of the arrays in bytes."""
        return sum(array.nbytes for array in self.arrays)

    def all_rows(self, cells: Triple) -> Words:
        """Compute the rows of the item in an empty box of this many cells (see `FreeSpace`)."""
        nx, _, nz = grid_nodes(cells)
        rows: Words = np.zeros((len(self.items), nz, nx), dtype=np.uint64)
        for n, (x, y, z) in enumerate(self.arrays[0].tolist()):
            rows[n, :z, :x] = (1 << y) - 1
        return rows


@bounded_cache(
    "items in all rotations",
    TURNED_BUDGET,
    "bytes",
    size=lambda turned: turned.nbytes,
    key=lambda item, allowed, cells: (item.turned(0).key, allowed, cells),
)
def turned_item(item: Item, allowed: tuple[int, ...], cells: Triple) -> TurnedItem:
    """Look up an item in those of the allowed rotations that differ and fit into a box.

    Parameters
    ----------
    allowed : tuple of int
        The rotations. Of those with the same cells the first is kept.
    cells : Triple
        The cells of the box along x, y and z.

    Returns
    -------
    TurnedItem
        The item; without rotations if it fits in none.
    """
    fitting = [turned for turned in map(item.turned, allowed) if fits(cells, turned)]
    order = [t.rotation for t in fitting]
    own_cells = np.array([t.cells for t in fitting], dtype=np.int64).reshape(-1, 3)
    upright = item.turned(0).voxels if fitting else Voxels.of(np.empty((0, 3, 3)), (0, 0, 0))
    kept, *voxels = turn_item(
        upright.arrays,
        own_cells,
        rotations.AXES[order],
        rotations.SIGNS[order],
        _SWAPS[order],
    )
    items = tuple(fitting[n] for n in kept.tolist())
    arrays = TurnedArrays(
        np.array([location_counts(cells, own) for own in items], dtype=np.int64).reshape(-1, 3),
        -(-own_cells[kept] // STEP),
        own_cells[kept],
        *voxels,
    )
    return TurnedItem(items, tuple(arrays))


@dataclass(frozen=True, eq=False)
class LoneItem:
    """An item alone in a box.

    Attributes
    ----------
    cells : tuple of int
        The cells of the box along x, y and z.
    kinematic : bool
        Whether its shadow belongs to it.
    """

    placed: PlacedItem
    cells: Triple
    kinematic: bool

    @cached_property
    def span(self) -> npt.NDArray[np.int64]:
        """First and last brick along x, y and z: (6,)."""
        first = np.array(self.placed.location)
        last = first + -(-np.array(self.placed.item.cells) // STEP) - 1
        if self.kinematic:
            first[2] = 0
        return np.concatenate([first, last])

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """The fields of the `BoxArrays` of the box, in a kinematic one of its shadow."""
        occupancy: Occupancy[PlacedItem] = Occupancy(self.cells)
        occupancy.add(self.placed)
        return shadow_arrays(occupancy.arrays) if self.kinematic else occupancy.arrays


def shadow_arrays(arrays: tuple[Any, ...]) -> tuple[Any, ...]:
    """Compute the shadow of a box, without fine cells: the fields of its `BoxArrays`."""
    _, page, _, nx, ny = arrays
    return shadow(arrays), np.zeros_like(page), _NO_FINE, nx, ny


class TurnedItems:
    """The items of a task, turned when they are first needed: online most never are visible.

    Equal items are one object.
    """

    def __init__(self, items: Sequence[Item], cells: Triple, allowed: tuple[int, ...]) -> None:
        self._items, self._cells, self._allowed = items, cells, allowed
        self._turned: dict[int, TurnedItem] = {}
        self._equal: dict[object, TurnedItem] = {}

    def __getitem__(self, number: int) -> TurnedItem:
        if number not in self._turned:
            item = self._items[number]
            key = item.turned(0).key
            if key not in self._equal:
                self._equal[key] = turned_item(item, self._allowed, self._cells)
            self._turned[number] = self._equal[key]
        return self._turned[number]

    def all_rows(self, number: int) -> Words:
        """Compute the rows of an item in an empty box (see `FreeSpace`)."""
        return self[number].all_rows(self._cells)


class FreeSpace:
    """The locations of items in a box that no cells block, computed when they are first needed.

    Parameters
    ----------
    rows : dict of int to Words
        Words uint64 [rotation, z, x] of items, by number: bit y is a location that may be feasible.
    known : sequence of int
        The number of items in the box that the rows of each item account for.
    """

    def __init__(self, items: TurnedItems, rows: dict[int, Words], known: Sequence[int]) -> None:
        self.items = items
        self._rows = dict(rows)
        self._known = list(known)
        self._shadow: tuple[int, tuple[Any, ...]] | None = None

    @classmethod
    def empty(
        cls, items: Sequence[Item], cells: Triple, allowed: tuple[int, ...] = ALL_ROTATIONS
    ) -> FreeSpace:
        """Create the free space of an empty box.

        Parameters
        ----------
        cells : Triple
            The cells of the box along x, y and z.
        allowed : tuple of int
            The rotations that the items may have; by default all 24.

        Returns
        -------
        FreeSpace
            The space.

        Raises
        ------
        ArgumentError
            If the box has more than 63 grid nodes along y.
        """
        ny = grid_nodes(cells)[1]
        if ny > MAX_NODES:
            raise ArgumentError(
                f"a box with {ny} grid nodes along y is too long for this agent: at most "
                f"{MAX_NODES}"
            )
        return cls(TurnedItems(items, cells, allowed), {}, [0] * len(items))

    def copy(self) -> FreeSpace:
        """Return a space of the same items, which does not change with this one."""
        return FreeSpace(self.items, self._rows, self._known)

    def rows(self, item: int, box: BaseBox[Any]) -> Words:
        """Compute the rows of an item.

        Parameters
        ----------
        box : BaseBox
            The box. The items that were in it at an earlier call must be in it, in this order.

        Returns
        -------
        Words
            uint64 [rotation, z, x]: bit y is a location that no cells block, and that was not
            removed.
        """
        count = len(box.spans)  # an arm may have set items aside
        if item not in self._rows:
            self._rows[item] = self.items.all_rows(item)
        if self._known[item] < count:
            own = self._rows[item].copy()
            spans = box.spans[self._known[item] :]
            remove_blocked(box.arrays, self.items[item].arrays, own, spans)
            if box.kinematic:
                down = spans.copy()
                down[:, 2] = 0
                remove_blocked(self.shadow(box), self.items[item].arrays, own, down)
            self._rows[item], self._known[item] = own, count
        if is_checking():
            self._assert_same_as_whole(item, box)
        return self._rows[item]

    def shadow(self, box: BaseBox[Any]) -> tuple[Any, ...]:
        """Return the fields of the `BoxArrays` of a box's shadow (see `rows` for the box)."""
        count = len(box.spans)
        if self._shadow is None or self._shadow[0] != count:
            self._shadow = count, shadow_arrays(box.arrays)
        return self._shadow[1]

    def fits_after(self, item: int, other: LoneItem) -> bool:
        """Return whether an item still fits somewhere after another one is added.

        Parameters
        ----------
        item : int
            The item, whose rows are known for the items in the box.
        other : LoneItem
            The other one.

        Returns
        -------
        bool
            False if cells block all of the item's locations.
        """
        arrays, rows = self.items[item].arrays, self._rows[item]
        return bool(fits_far(arrays, rows, other.span) or fits_near(other.arrays, arrays, rows))

    def remove(self, item: int, rotation: int, location: Triple) -> None:
        """Remove a location that the meshes exclude.

        Parameters
        ----------
        rotation : int
            The rotation, as an index of `TurnedItem.items`.
        """
        i, j, k = location
        rows = self._rows[item].copy()
        rows[rotation, k, i] &= ~(np.uint64(1) << np.uint64(j))
        self._rows[item] = rows

    def _assert_same_as_whole(self, item: int, box: BaseBox[Any]) -> None:
        """Compare an item's rows with those that all items of the box leave it, from none known."""
        turned, rows = self.items[item], self._rows[item]
        whole = self.items.all_rows(item)
        if len(box.placed):
            remove_blocked(box.arrays, turned.arrays, whole, box.spans)
        assert not (rows & ~whole).any(), "no location becomes free again"
        removed = whole & ~rows
        for n, k, i in np.argwhere(removed).tolist():
            for j in range(MAX_NODES):
                if int(removed[n, k, i]) >> j & 1:
                    placed = turned.items[n], (i, j, k)
                    assert not box.is_feasible(*placed), "the meshes exclude it"
