"""What agents, observers and episodes ask of a box, whether items stay on the grid or settle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.engine import feasibility
from packit_sim.engine.feasibility import ORIGIN, Mask
from packit_sim.engine.occupancy import ItemInBox, Occupancy, PlacedItem
from packit_sim.geometry import rotations
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import BOX_CELLS, CELL, Triple, box_cells, grid_nodes
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import unpack


class BaseBox(ABC):
    """A box to which items are brought on the grid, wherever they end.

    cells: cells an axis, whole grid steps; a cell is 1/100 of a unit, so 200 cells make 2 units.
    Raises ValueError where the cells are not possible.
    """

    _occupancy: Occupancy[Any]

    def __init__(self, cells: Sequence[int] = BOX_CELLS) -> None:
        self._occupancy = Occupancy(box_cells(cells))

    @property
    def cells(self) -> Triple:
        return self._occupancy.cells

    @property
    def nodes(self) -> Triple:
        """Grid nodes an axis: the shape of masks."""
        return grid_nodes(self.cells)

    @property
    def size(self) -> npt.NDArray[np.float64]:
        """(3,) in box units."""
        return np.array(self.cells) * CELL

    @property
    @abstractmethod
    def placed(self) -> Sequence[ItemInBox]:
        """What was placed, in that order."""

    @property
    @abstractmethod
    def density(self) -> float:
        """Placed volume over the box's volume."""

    @property
    def outer(self) -> npt.NDArray[np.bool_]:
        """Bool over `cells`: those that hold an outer fine cell of a placed item."""
        return unpack(self.outer_words)

    @property
    def outer_words(self) -> Words:
        """The same as words [x, y, z], one for 4 x 4 x 4 cells (see `bits`)."""
        return self._occupancy.outer_words

    @abstractmethod
    def feasible(self, item: Item) -> Mask:
        """Bool [x, y, z] over the grid's nodes: where the item can stand, exactly."""

    @abstractmethod
    def blbf(self, item: Item, start: Triple = ORIGIN) -> Triple | None:
        """The bottom-left-back-fill location (i, j, k), or None where the item fits nowhere.

        start: where the search may begin, because nothing before it is feasible: such as what was
        found when less was in the box, since room that is gone never comes back.
        """

    def feasible_rotations(self, item: Item) -> npt.NDArray[np.bool_]:
        """Bool [rotation, x, y, z]: where the item can stand in each of the 24 rotations, exactly.

        Whatever the item's own rotation.
        """
        return np.stack([self.feasible(item.turned(n)) for n in range(rotations.COUNT)])

    def feasible_in_any(self, item: Item) -> Mask:
        """Bool [x, y, z]: where the item can stand in at least one of the 24 rotations, exactly."""
        return np.logical_or.reduce(self.feasible_rotations(item))

    def rotations_at(self, item: Item, location: Sequence[int]) -> npt.NDArray[np.bool_]:
        """Bool (24,): the rotations in which the item can stand at a location, exactly.

        Raises InfeasibleError where the location is no node of the grid.
        """
        node = feasibility.checked_location(self.cells, location)
        turned = (item.turned(n) for n in range(rotations.COUNT))
        return np.array([self._can_stand(PlacedItem(item, node)) for item in turned])

    def is_feasible(self, item: Item, location: Sequence[int]) -> bool:
        """Whether the item can stand at a location, exactly: the mask's value there.

        Raises InfeasibleError where the location is no node of the grid.
        """
        return self._can_stand(PlacedItem(item, feasibility.checked_location(self.cells, location)))

    @abstractmethod
    def put(self, item: Item, location: Sequence[int]) -> float:
        """Places an item; returns by how much the volume that counts grew, in box units cubed.

        Raises InfeasibleError, and changes nothing, where it is not feasible.
        """

    @abstractmethod
    def snapshot(self) -> Any:
        """The state of the box, a value to go back to; costs next to nothing."""

    @abstractmethod
    def restore(self, snapshot: Any) -> None:
        """Goes back, or on, to a snapshot of a box of the same cells; else raises ValueError."""

    def __repr__(self) -> str:
        name, items = type(self).__name__, len(self.placed)
        return f"{name}({self.cells}, {items} items, density {self.density:.3f})"

    @abstractmethod
    def _can_stand(self, candidate: PlacedItem) -> bool:
        """Whether it is feasible there, exactly."""
