"""The box: what is placed where. Place, undo, snapshot, restore."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from packit_sim.core.errors import ArgumentError, InfeasibleError
from packit_sim.engine import feasibility, insertion
from packit_sim.engine.base_box import BaseBox
from packit_sim.engine.feasibility import ORIGIN, Blockers, Mask
from packit_sim.engine.occupancy import Occupancy, PlacedItem
from packit_sim.geometry.lattice import BOX_CELLS, Triple
from packit_sim.geometry.shapes import Item


@dataclass(frozen=True)
class BoxState:
    """The whole state of a box: its cells an axis and the placed items, in order. A value."""

    cells: Triple
    placed: tuple[PlacedItem, ...]


class Box(BaseBox):
    """A box to pack, by default the unit cube of 100 cells an axis.

    cells: cells an axis, whole grid steps; a cell is 1/100 of a unit, so 200 cells make 2 units.
    kinematic: whether an item can stand only where it comes straight down from the open top (see
    `lifting`). Raises ValueError where the cells are not possible.
    """

    _occupancy: Occupancy[PlacedItem]

    def __init__(self, cells: Sequence[int] = BOX_CELLS, *, kinematic: bool = False) -> None:
        super().__init__(cells)
        self.kinematic = kinematic

    @property
    def placed(self) -> tuple[PlacedItem, ...]:
        """What is in the box, in the order of placing."""
        return self._occupancy.placed

    @property
    def density(self) -> float:
        """Placed volume over the box's volume."""
        return sum(p.item.volume for p in self.placed) / float(self.size.prod())

    def feasible(self, item: Item) -> Mask:
        mask = feasibility.feasible(self._occupancy, item)
        return insertion.clear(self.placed, item, mask) if self.kinematic else mask

    def blbf(self, item: Item, start: Triple = ORIGIN) -> Triple | None:
        if self.kinematic:
            return feasibility.first(self.feasible(item))
        return feasibility.blbf(self._occupancy, item, start)

    def feasible_in_any(self, item: Item) -> Mask:
        if self.kinematic:
            return super().feasible_in_any(item)
        return feasibility.feasible_in_any(self._occupancy, item)

    def why_not(self, item: Item, location: Sequence[int]) -> Blockers:
        """Which walls and which placed items, by number, keep an item from a location.

        In a kinematic box also which items above it do. Nothing does, and the answer is false,
        where it is feasible. Raises InfeasibleError where the location is no node of the grid.
        """
        return self._blockers(PlacedItem(item, feasibility.checked_location(self.cells, location)))

    def place(self, item: Item, location: Sequence[int]) -> PlacedItem:
        """Places an item. Raises InfeasibleError, and changes nothing, where it is not feasible."""
        placed = PlacedItem(item, feasibility.checked_location(self.cells, location))
        if not self._can_stand(placed):
            raise InfeasibleError(self._why_not(placed))
        self._occupancy.add(placed)
        return placed

    def put(self, item: Item, location: Sequence[int]) -> float:
        return self.place(item, location).item.volume

    def fill(self, item: Item, start: Triple = ORIGIN) -> PlacedItem | None:
        """Places an item at its bottom-left-back-fill location; None where it fits nowhere.

        start: as of `blbf`.
        """
        location = self.blbf(item, start)
        if location is None:
            return None
        placed = PlacedItem(item, location)
        self._occupancy.add(placed)
        return placed

    def undo(self) -> PlacedItem:
        """Takes the last item out again and returns it. Raises IndexError where there is none."""
        if not self.placed:
            raise IndexError("nothing to undo: the box is empty")
        last = self.placed[-1]
        self._occupancy.truncate(len(self.placed) - 1)
        return last

    def clear(self) -> None:
        """Takes everything out."""
        self._occupancy.truncate(0)

    def snapshot(self) -> BoxState:
        return BoxState(self.cells, self.placed)

    def restore(self, snapshot: BoxState) -> None:
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

    def _can_stand(self, candidate: PlacedItem) -> bool:
        return feasibility.is_feasible(self._occupancy, candidate) and (
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
