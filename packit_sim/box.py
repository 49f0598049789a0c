"""The box: which items are where. Place, undo, snapshot, restore."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from packit_sim.core.errors import InfeasibleError
from packit_sim.engine import feasibility, insertion
from packit_sim.engine.base_box import BaseBox
from packit_sim.engine.feasibility import ORIGIN, Blockers, Mask, checked_location
from packit_sim.engine.items import PlacedItem
from packit_sim.geometry.lattice import BOX_CELLS, Triple
from packit_sim.geometry.shapes import Item


class Box(BaseBox[PlacedItem]):
    """A box to pack, by default the unit cube of 100 cells along each axis.

    Parameters
    ----------
    cells : sequence of int, default: (100, 100, 100)
        Cells along x, y and z, whole grid steps. A cell is 1/100 of a box unit.
    kinematic : bool, default: False
        Whether an item must come straight down from the open top (see `insertion`).

    Raises
    ------
    ArgumentError
        If the cells are not possible.
    """

    def __init__(self, cells: Sequence[int] = BOX_CELLS, *, kinematic: bool = False) -> None:
        super().__init__(cells)
        self.kinematic = kinematic

    @property
    def density(self) -> float:
        """The placed volume over the box's volume."""
        return sum(p.item.volume for p in self.placed) / float(self.size.prod())

    def feasible(self, item: Item) -> Mask:
        mask = super().feasible(item)
        return insertion.clear(self.placed, item, mask) if self.kinematic else mask

    def blbf(self, item: Item, start: Triple = ORIGIN) -> Triple | None:
        if self.kinematic:
            return feasibility.first(self.feasible(item))
        return super().blbf(item, start)

    def feasible_in_any(self, item: Item) -> Mask:
        if self.kinematic:
            return np.logical_or.reduce(self.feasible_rotations(item))
        return super().feasible_in_any(item)

    def why_not(self, item: Item, location: Sequence[int]) -> Blockers:
        """Find what keeps an item from a location.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        location : sequence of int
            The grid node (i, j, k).

        Returns
        -------
        Blockers
            The walls and the items that block it, in a kinematic box also the items above it.
            False if the item is feasible there.

        Raises
        ------
        InfeasibleError
            If the location is no node of the grid.
        """
        return self._blockers(PlacedItem(item, checked_location(self.cells, location)))

    def place(self, item: Item, location: Sequence[int]) -> PlacedItem:
        """Place an item.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        location : sequence of int
            The grid node (i, j, k) for the min corner of its cell box.

        Returns
        -------
        PlacedItem
            The item at its location.

        Raises
        ------
        InfeasibleError
            If it is not feasible there. The box is unchanged.
        """
        placed = PlacedItem(item, checked_location(self.cells, location))
        if not self._is_feasible(placed):
            raise InfeasibleError(self._why_not(placed))
        self._occupancy.add(placed)
        return placed

    def put(self, item: Item, location: Sequence[int]) -> float:
        return self.place(item, location).item.volume

    def fill(self, item: Item, start: Triple = ORIGIN) -> PlacedItem | None:
        """Place an item at its bottom-left-back-fill location.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        start : Triple, default: (0, 0, 0)
            Where to begin, as of `blbf`.

        Returns
        -------
        PlacedItem or None
            The item at its location, or None if it fits nowhere.
        """
        location = self.blbf(item, start)
        if location is None:
            return None
        placed = PlacedItem(item, location)
        self._occupancy.add(placed)
        return placed

    def undo(self) -> PlacedItem:
        """Remove the last item and return it. Raises IndexError if the box is empty."""
        if not self.placed:
            raise IndexError("nothing to undo: the box is empty")
        last = self.placed[-1]
        self._occupancy.truncate(len(self.placed) - 1)
        return last

    def clear(self) -> None:
        """Remove all items."""
        self._occupancy.truncate(0)

    def _is_feasible(self, candidate: PlacedItem) -> bool:
        return super()._is_feasible(candidate) and (
            not self.kinematic or insertion.is_clear(self.placed, candidate)
        )

    def _blockers(self, candidate: PlacedItem) -> Blockers:
        found = feasibility.blockers(self._occupancy, candidate)
        if found or not self.kinematic:
            return found
        return Blockers((), (), insertion.above(self.placed, candidate))

    def _why_not(self, candidate: PlacedItem) -> str:
        item = candidate.item
        what = f"{item.shape.id!r} (scale {item.scale:g}, rotation {item.rotation})"
        where = f"at {candidate.location}"
        if not feasibility.is_inside(self.cells, candidate):
            return (
                f"{what} {where} is not inside the box: it needs {item.cells} cells "
                f"from cell {candidate.start} on, the box has {self.cells}"
            )
        found = self._blockers(candidate)
        blocking = ", ".join(
            f"{n} ({self.placed[n].item.shape.id!r})" for n in found.items or found.above
        )
        if found.items:
            return f"{what} {where} is in conflict with placed item {blocking}"
        return f"{what} {where} can't come down from above: placed item {blocking} is in the way"
