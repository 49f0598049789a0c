"""What all boxes have in common, whether their items stay on the grid or settle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import ArgumentError
from packit_sim.engine import feasibility
from packit_sim.engine.feasibility import ORIGIN, Mask, checked_location
from packit_sim.engine.items import BoxState, ItemT, PlacedItem
from packit_sim.engine.occupancy import Occupancy
from packit_sim.geometry import rotations
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import BOX_CELLS, CELL, Triple, box_cells, grid_nodes
from packit_sim.geometry.poses import Floats
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import unpack


class BaseBox(ABC, Generic[ItemT]):
    """A box into which items are placed on the grid, wherever they end.

    Parameters
    ----------
    cells : sequence of int, default: (100, 100, 100)
        Cells along x, y and z, whole grid steps. A cell is 1/100 of a box unit.

    Raises
    ------
    ArgumentError
        If the cells are not possible.
    """

    def __init__(self, cells: Sequence[int] = BOX_CELLS) -> None:
        self._occupancy: Occupancy[ItemT] = Occupancy(box_cells(cells))

    @property
    def cells(self) -> Triple:
        """The cells along x, y and z."""
        return self._occupancy.cells

    @property
    def nodes(self) -> Triple:
        """The grid nodes along x, y and z: the shape of masks."""
        return grid_nodes(self.cells)

    @property
    def size(self) -> Floats:
        """The extents, (3,) in box units."""
        return np.array(self.cells) * CELL

    @property
    def placed(self) -> tuple[ItemT, ...]:
        """The items, in the order of placing."""
        return self._occupancy.placed

    @property
    @abstractmethod
    def density(self) -> float:
        """The volume that counts, over the box's volume."""

    @property
    def outer(self) -> npt.NDArray[np.bool_]:
        """The cells that contain an outer fine cell of an item: bool over `cells`."""
        return unpack(self.outer_words)

    @property
    def outer_words(self) -> Words:
        """The same as words [x, y, z], one for 4 x 4 x 4 cells (see `bits`)."""
        return self._occupancy.outer_words

    def feasible(self, item: Item) -> Mask:
        """Compute the exact mask of feasible locations: bool over the grid nodes, [x, y, z]."""
        return feasibility.feasible(self._occupancy, item)

    def blbf(self, item: Item, start: Triple = ORIGIN) -> Triple | None:
        """Find the bottom-left-back-fill location.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        start : Triple, default: (0, 0, 0)
            Where to begin, if nothing before it is feasible: for example the answer when the box
            contained fewer items, since an occupied location never becomes free again.

        Returns
        -------
        Triple or None
            The location (i, j, k), or None if the item fits nowhere.
        """
        return feasibility.blbf(self._occupancy, item, start)

    def feasible_rotations(self, item: Item) -> npt.NDArray[np.bool_]:
        """Compute the masks of all 24 rotations of an item: bool [rotation, x, y, z]."""
        return np.stack([self.feasible(item.turned(n)) for n in range(rotations.COUNT)])

    def feasible_in_any(self, item: Item) -> Mask:
        """Compute the union of the masks of all 24 rotations: bool [x, y, z]."""
        return feasibility.feasible_in_any(self._occupancy, item)

    def rotations_at(self, item: Item, location: Sequence[int]) -> npt.NDArray[np.bool_]:
        """Compute the rotations in which an item is feasible at a location: bool (24,).

        Raises InfeasibleError if the location is no node of the grid.
        """
        node = checked_location(self.cells, location)
        turned = (item.turned(n) for n in range(rotations.COUNT))
        return np.array([self._is_feasible(PlacedItem(item, node)) for item in turned])

    def is_feasible(self, item: Item, location: Sequence[int]) -> bool:
        """Decide whether an item is feasible at a location: the mask's value there.

        Raises InfeasibleError if the location is no node of the grid.
        """
        return self._is_feasible(PlacedItem(item, checked_location(self.cells, location)))

    @abstractmethod
    def put(self, item: Item, location: Sequence[int]) -> float:
        """Place an item, and return the increase of the volume that counts, in box units cubed.

        Raises InfeasibleError, and changes nothing, if it is not feasible there.
        """

    def snapshot(self) -> BoxState[ItemT]:
        """Return the state of the box, a value. Costs next to nothing."""
        return BoxState(self.cells, self.placed)

    def restore(self, snapshot: BoxState[ItemT]) -> None:
        """Return to a snapshot of a box of the same cells. Raises ArgumentError for other cells."""
        if snapshot.cells != self.cells:
            raise ArgumentError(
                f"a snapshot of a box of {snapshot.cells} cells can't be restored "
                f"in one of {self.cells}"
            )
        kept = 0
        for ours, theirs in zip(self.placed, snapshot.placed, strict=False):
            if ours != theirs:
                break
            kept += 1
        self._occupancy.truncate(kept)
        for placed in snapshot.placed[kept:]:
            self._occupancy.add(placed)

    def __repr__(self) -> str:
        name, items = type(self).__name__, len(self.placed)
        return f"{name}({self.cells}, {items} items, density {self.density:.3f})"

    def _is_feasible(self, candidate: PlacedItem) -> bool:
        return feasibility.is_feasible(self._occupancy, candidate)
