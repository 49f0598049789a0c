"""The box: its items and their locations; place, undo, snapshot and restore."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Generic, Self

import numpy as np
import numpy.typing as npt

from packit_sim import placement
from packit_sim.core.caches import cached_property
from packit_sim.core.debugging import is_checking
from packit_sim.core.errors import ArgumentError, InfeasibleError
from packit_sim.core.sums import plain_sum
from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.bits import Words
from packit_sim.geometry.items import BoxState, ItemT, PlacedItem
from packit_sim.geometry.lattice import BOX_CELLS, CELL, ORIGIN, STEP, Triple, box_cells, grid_nodes
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxels import unpack
from packit_sim.placement import Blockers, Mask, Occupancy, checked_location


@dataclass(frozen=True)
class Disturbance:
    """How far items move when one is placed, relative to a movement that counts as unstable.

    Attributes
    ----------
    own : float
        Movement of the new item from where it is placed.
    others : float
        Largest movement of another item from where it came to rest.
    piece_steps : int
        What the prediction cost: convex pieces times time steps that were simulated.
    """

    own: float = 0.0
    others: float = 0.0
    piece_steps: int = 0


class BaseBox(ABC, Generic[ItemT]):
    """The base of all boxes, whose items stay on the grid or settle.

    Parameters
    ----------
    cells : sequence of int, default: (100, 100, 100)
        Cells along x, y and z, whole grid steps. A cell is 1/100 of a box unit.

    Attributes
    ----------
    kinematic : bool
        Whether an item must come straight down from above, which only a `Box` can ask for.

    Raises
    ------
    ArgumentError
        If the cells are not possible.
    """

    kinematic: bool = False

    def __init__(self, cells: Sequence[int] = BOX_CELLS) -> None:
        self._occupancy: Occupancy[ItemT] = Occupancy(box_cells(cells))

    @property
    def cells(self) -> Triple:
        """The cells along x, y and z."""
        return self._occupancy.cells

    @property
    def opens_locations(self) -> bool:
        """True if locations may become feasible because an item was placed."""
        return True

    @property
    def nodes(self) -> Triple:
        """The grid nodes along x, y and z: the shape of masks."""
        return grid_nodes(self.cells)

    @property
    def size(self) -> Floats:
        """The extents, (3,) in box units."""
        return np.array(self.cells) * CELL

    @cached_property
    def volume(self) -> float:
        """The volume, in cubic box units."""
        return float(self.size.prod())

    @property
    def placed(self) -> tuple[ItemT, ...]:
        """The items, in the order of placing."""
        return self._occupancy.placed

    @property
    @abstractmethod
    def density(self) -> float:
        """The volume that counts, relative to the box's volume."""

    @property
    def outer(self) -> npt.NDArray[np.bool_]:
        """Bool over `cells`: those that contain an outer fine cell of an item."""
        return unpack(self.outer_words)

    @property
    def outer_words(self) -> Words:
        """The same as words [x, y, z], one for 4 x 4 x 4 cells (see `bits`)."""
        return self._occupancy.outer_words

    @property
    def arrays(self) -> tuple[Any, ...]:
        """The occupied cells as the fields of `BoxArrays`, for kernels."""
        return self._occupancy.arrays

    @property
    def spans(self) -> npt.NDArray[np.int64]:
        """First and last brick of each item along x, y and z: (n, 6)."""
        return self._occupancy.spans

    def feasible(self, item: Item) -> Mask:
        """Compute the exact mask of feasible locations: bool over the grid nodes, [x, y, z]."""
        return placement.feasible(self._occupancy, item)

    def candidates(self, item: Item) -> Mask:
        """Compute a mask that contains all feasible locations: bool over the grid nodes, [x, y, z].

        It is cheaper than `feasible`, because no meshes are compared: cells prove that an item is
        not feasible where the mask is False. `is_feasible` decides about the other locations.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.

        Returns
        -------
        Mask
            The mask. In a kinematic box it is that of `feasible`.
        """
        return placement.candidates(self._occupancy, item)

    def blbf(self, item: Item, start: Triple = ORIGIN, layers: int | None = None) -> Triple | None:
        """Find the bottom-left-back-fill location.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        start : Triple, default: (0, 0, 0)
            The location to begin at, if none before it is feasible: for example the answer when
            the box contained fewer items, since an occupied location never becomes free again.
        layers : int, optional
            The number of layers of nodes to search, from the lowest; all by default.

        Returns
        -------
        Triple or None
            The location (i, j, k), or None if the item fits nowhere.
        """
        return placement.blbf(self._occupancy, item, start, layers)

    def feasible_rotations(self, item: Item) -> npt.NDArray[np.bool_]:
        """Compute the masks of all 24 rotations of an item: bool [rotation, x, y, z]."""
        return np.stack([self.feasible(item.turned(n)) for n in range(rotations.COUNT)])

    def feasible_in_any(self, item: Item) -> Mask:
        """Compute the union of the masks of all 24 rotations: bool [x, y, z]."""
        return placement.feasible_in_any(self._occupancy, item)

    def rotations_at(self, item: Item, location: Sequence[int]) -> npt.NDArray[np.bool_]:
        """Compute the rotations in which an item is feasible at a location.

        Parameters
        ----------
        item : Item
            The item, in any rotation.
        location : sequence of int
            The grid node (i, j, k).

        Returns
        -------
        ndarray
            Bool (24,), by the index of the rotation.

        Raises
        ------
        InfeasibleError
            If the location is not a node of the grid.
        """
        node = checked_location(self.cells, location)
        turned = (item.turned(n) for n in range(rotations.COUNT))
        return np.array([self._is_feasible(PlacedItem(item, node)) for item in turned])

    def is_feasible(self, item: Item, location: Sequence[int]) -> bool:
        """Decide whether an item is feasible at a location: the mask's value there.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        location : sequence of int
            The grid node (i, j, k).

        Returns
        -------
        bool
            Whether it is.

        Raises
        ------
        InfeasibleError
            If the location is not a node of the grid.
        """
        return self._is_feasible(PlacedItem(item, checked_location(self.cells, location)))

    def disturbance(
        self, item: Item, location: Sequence[int], limit: float = math.inf
    ) -> Disturbance:
        """Predict how far items move if one is placed at a location where it is feasible.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        location : sequence of int
            The grid node (i, j, k).
        limit : float
            A movement of other items above which the exact one does not matter.

        Returns
        -------
        Disturbance
            The predicted movements; 0 in a box whose items stay on the grid.
        """
        return Disturbance()

    @abstractmethod
    def put(self, item: Item, location: Sequence[int]) -> float:
        """Place an item and return how much the volume that counts grows.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        location : sequence of int
            The grid node (i, j, k).

        Returns
        -------
        float
            The increase, in cubic box units; it is negative if other items stop counting.

        Raises
        ------
        InfeasibleError
            If the item is not feasible there. The box is unchanged.
        """

    def snapshot(self) -> BoxState[ItemT]:
        """Return the state of the box as a value; this costs next to nothing."""
        return BoxState(self.cells, self.placed)

    def restore(self, snapshot: BoxState[ItemT]) -> None:
        """Return to a snapshot of a box with the same cells; others raise ArgumentError."""
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
        if is_checking():
            assert self.snapshot() == snapshot

    def __repr__(self) -> str:
        name, items = type(self).__name__, len(self.placed)
        return f"{name}({self.cells}, {items} items, density {self.density:.3f})"

    def _is_feasible(self, candidate: PlacedItem) -> bool:
        return placement.is_feasible(self._occupancy, candidate)


class Box(BaseBox[PlacedItem]):
    """A box to pack, by default the unit cube of 100 cells along each axis.

    Parameters
    ----------
    cells : sequence of int, default: (100, 100, 100)
        Cells along x, y and z, whole grid steps. A cell is 1/100 of a box unit.
    kinematic : bool, default: False
        Whether an item must come straight down from the open top (see `insertion`).
    support : float, default: 0
        The least share of an item's base that must rest on something (see `engine.support`).
    boxes : int, default: 1
        The number of equal boxes into which walls divide it along x; no item may cross a wall.

    Raises
    ------
    ArgumentError
        If the cells are not possible, or can't be divided into so many boxes.

    Examples
    --------
    >>> import trimesh
    >>> from packit_sim import Box, Item, Shape
    >>> brick = Item(Shape.from_mesh(trimesh.creation.box((4, 2, 1)), "brick"), scale=0.5)
    >>> box = Box()
    >>> for _ in range(3):
    ...     _ = box.place(brick, box.blbf(brick))
    >>> box
    Box((100, 100, 100), 3 items, density 0.125)
    >>> [placed.location for placed in box.placed]
    [(0, 0, 0), (0, 9, 0), (0, 0, 5)]
    >>> int(box.feasible(brick).sum())  # of 25 x 25 x 25 locations
    1816
    >>> _ = box.undo()
    >>> len(box.placed)
    2
    """

    def __init__(
        self,
        cells: Sequence[int] = BOX_CELLS,
        *,
        kinematic: bool = False,
        support: float = 0.0,
        boxes: int = 1,
    ) -> None:
        super().__init__(cells)
        if self.nodes[0] % boxes:
            raise ArgumentError(f"a box of {self.cells} cells can't be divided into {boxes} boxes")
        self.kinematic = kinematic
        self.support = support
        self.boxes = boxes

    @property
    def opens_locations(self) -> bool:
        return self.support > 0

    @property
    def _is_plain(self) -> bool:
        """True if an item may be wherever it is inside the box and free."""
        return not self.kinematic and not self.support and self.boxes == 1

    @property
    def density(self) -> float:
        """The placed volume, relative to the box's volume."""
        return plain_sum(p.item.volume for p in self.placed) / self.volume

    def feasible(self, item: Item) -> Mask:
        mask = super().feasible(item)
        if self.boxes > 1:
            mask &= self._is_in_one_box(item, np.arange(self.nodes[0]))[:, None, None]
        if self.kinematic:
            mask = placement.insertable_mask(self.placed, item, mask)
        if self.support:
            mask = placement.supported_mask(self.cells, self.placed, item, mask, self.support)
        return mask

    def candidates(self, item: Item) -> Mask:
        return super().candidates(item) if self._is_plain else self.feasible(item)

    def blbf(self, item: Item, start: Triple = ORIGIN, layers: int | None = None) -> Triple | None:
        if self._is_plain:
            return super().blbf(item, start, layers)
        return placement.first(self.feasible(item)[:, :, :layers])

    def feasible_in_any(self, item: Item) -> Mask:
        if self._is_plain:
            return super().feasible_in_any(item)
        return np.logical_or.reduce(self.feasible_rotations(item))

    def why_not(self, item: Item, location: Sequence[int]) -> Blockers:
        """Find what blocks an item at a location.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        location : sequence of int
            The grid node (i, j, k).

        Returns
        -------
        Blockers
            The walls and the items that block it, in a kinematic box also the items above it, and
            whether it lacks support. Its truth value is False if the item is feasible there.

        Raises
        ------
        InfeasibleError
            If the location is not a node of the grid.
        """
        return self._blockers(PlacedItem(item, checked_location(self.cells, location)))

    def place(self, item: Item, location: Sequence[int]) -> PlacedItem:
        """Place an item.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        location : sequence of int
            The grid node (i, j, k) of the min corner of its cell box.

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
            The location to begin at, as for `blbf`.

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
        """Remove the last item and return it; an empty box raises IndexError."""
        if not self.placed:
            raise IndexError("nothing to undo: the box is empty")
        last = self.placed[-1]
        self._occupancy.truncate(len(self.placed) - 1)
        return last

    def emptied(self) -> Self:
        """Create an empty box that decides in the same way."""
        other = copy(self)
        other._occupancy = Occupancy(self.cells)
        return other

    def clear(self) -> None:
        """Remove all items."""
        self._occupancy.truncate(0)

    def _is_in_one_box(self, item: Item, i: Any) -> Any:
        """Return whether an item that begins at a node along x crosses no wall between boxes."""
        nodes = self.nodes[0] // self.boxes
        return i % nodes * STEP + item.cells[0] <= nodes * STEP

    def _is_feasible(self, candidate: PlacedItem) -> bool:
        return (
            self._is_in_one_box(candidate.item, candidate.location[0])
            and super()._is_feasible(candidate)
            and (not self.kinematic or placement.is_insertable(self.placed, candidate))
            and (not self.support or self._support(candidate) >= self.support)
        )

    def _support(self, candidate: PlacedItem) -> float:
        return placement.support(self.cells, self.placed, candidate)

    def _blockers(self, candidate: PlacedItem) -> Blockers:
        found = placement.blockers(self._occupancy, candidate)
        if not found.walls and not self._is_in_one_box(candidate.item, candidate.location[0]):
            found = replace(found, walls=placement.WALLS[:1])
        if found:
            return found
        above = placement.blockers_above(self.placed, candidate) if self.kinematic else ()
        if above:
            return Blockers((), (), above)
        return Blockers((), (), unsupported=self._support(candidate) < self.support)

    def _why_not(self, candidate: PlacedItem) -> str:
        item = candidate.item
        what = f"{item.shape.id!r} (scale {item.scale:g}, rotation {item.rotation})"
        where = f"at {candidate.location}"
        if not placement.is_inside(self.cells, candidate):
            return (
                f"{what} {where} is not inside the box: it needs {item.cells} cells "
                f"from cell {candidate.start} on, the box has {self.cells}"
            )
        found = self._blockers(candidate)
        blocking = ", ".join(
            f"{n} ({self.placed[n].item.shape.id!r})" for n in found.items or found.above
        )
        if found.walls:
            return f"{what} {where} would be in two of the {self.boxes} boxes"
        if found.items:
            return f"{what} {where} is in conflict with placed item {blocking}"
        if found.unsupported:
            return (
                f"{what} {where} has a support of {self._support(candidate):.3g}, the rules want "
                f"{self.support:g}"
            )
        return f"{what} {where} can't come down from above: placed item {blocking} is in the way"
