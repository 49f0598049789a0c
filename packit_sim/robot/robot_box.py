"""A box into which an arm puts the items, and which shows them where they really are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from packit_sim import placement
from packit_sim.box import BaseBox, Disturbance
from packit_sim.core.errors import InfeasibleError
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.items import BoxState, PlacedItem, PosedItem
from packit_sim.geometry.lattice import BOX_CELLS, ORIGIN, Triple
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item
from packit_sim.physics.convex.decomposition import require
from packit_sim.physics.foresight import foreseen_movement
from packit_sim.physics.settling import fitted_items, fitted_with
from packit_sim.physics.world import require_engine
from packit_sim.placement import Mask, Occupancy, checked_location
from packit_sim.robot.arms import arm_of
from packit_sim.robot.attempts import attempt, is_over
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.executed_item import ExecutedItem, movement
from packit_sim.robot.grasps import best_grasp


class RobotBox(BaseBox[Any]):
    """A box that an arm packs, one item after the other, in simulated physics.

    Masks are exact among the items where they are, off the grid; in an open loop, among those where
    they were planned. An item that can't be gripped, or has no way into the box, is set aside, and
    stays at the station. It can't be tried again, but it does not end the episode.

    Parameters
    ----------
    cells : sequence of int, default: (100, 100, 100)
        Cells along x, y and z, whole grid steps. A cell is 1/100 of a box unit.
    cell : RobotCell, optional
        The robot cell.

    Raises
    ------
    ArgumentError
        If the arm is not one, or can't reach all of the box.
    MissingPackageError
        If PyBullet is not installed.
    """

    def __init__(self, cells: Sequence[int] = BOX_CELLS, cell: RobotCell | None = None) -> None:
        super().__init__(cells)
        self.cell = cell or RobotCell()
        require_engine()
        require(self.cell.decomposition)
        self._arm = arm_of(self.cell, self.cells)
        self._arm.check(self.cells, 0.0)
        self._tried: tuple[ExecutedItem, ...] = ()

    @property
    def placed(self) -> tuple[ExecutedItem, ...]:
        """All items that were tried, in their order, where they are."""
        return self._tried

    @property
    def density(self) -> float:
        """The volume of the items that are inside, relative to the box's volume."""
        return self._counted / self.volume

    @property
    def _counted(self) -> float:
        return plain_sum(one.item.volume for one in self._tried if one.counts)

    def check(self, items: Sequence[Item]) -> None:
        """Check before any simulation that the arm can lift items, and carry them over the rim.

        Parameters
        ----------
        items : sequence of Item
            The items that it is to pack.

        Raises
        ------
        ArgumentError
            If it can't.
        """
        for item in items:
            self.cell.check_payload(f"{item.shape.id!r} (scale {item.scale:g})", item.volume)
        longest = max((float(item.extents.max()) for item in items), default=0.0)
        self._arm.check(self.cells, longest * self.cell.edge)

    def feasible(self, item: Item) -> Mask:
        if not self._is_gripped(item):
            return np.zeros(self.nodes, dtype=bool)
        mask = super().feasible(item)
        if not self.cell.reachable:
            return mask
        return placement.insertable_mask(self._occupancy.placed, item, mask)

    def candidates(self, item: Item) -> Mask:
        if not self._is_gripped(item):
            return np.zeros(self.nodes, dtype=bool)
        return super().candidates(item)

    def blbf(self, item: Item, start: Triple = ORIGIN, layers: int | None = None) -> Triple | None:
        if not self.cell.reachable:
            return super().blbf(item, start, layers)
        return placement.first(self.feasible(item)[:, :, :layers])

    def feasible_in_any(self, item: Item) -> Mask:
        if not self.cell.reachable:
            return super().feasible_in_any(item)
        return np.logical_or.reduce(self.feasible_rotations(item))

    def put(self, item: Item, location: Sequence[int]) -> float:
        candidate = PlacedItem(item, checked_location(self.cells, location))
        if not self._is_feasible(candidate):
            raise InfeasibleError(
                f"{item.shape.id!r} (scale {item.scale:g}, rotation {item.rotation}) at "
                f"{candidate.location} is outside the box, in conflict with items there, or "
                "can't be held or reached"
            )
        before = self._counted
        self._execute(candidate)
        return self._counted - before

    def disturbance(
        self, item: Item, location: Sequence[int], limit: float = math.inf
    ) -> Disturbance:
        planned = self._lowered(PlacedItem(item, checked_location(self.cells, location)))
        settings = self.cell.world
        if self.cell.open_loop:
            others = origins = [one.planned for one in self._tried]
            known = fitted_items([*others, planned], settings)
        else:
            there = [one for one in self._tried if is_over(self.cells, one.posed)]
            others = [one.posed for one in there]
            origins = [one.posed if one.collapsed else one.landed for one in there]
            known = fitted_with(there, planned, settings)
        start = BoxState(self.cells, (*others, planned))
        gap = self.cell.gap / self.cell.edge
        return foreseen_movement(start, known.pieces, settings, movement, origins, limit, gap)

    def snapshot(self) -> BoxState[ExecutedItem]:
        return BoxState(self.cells, self._tried)

    def restore(self, snapshot: BoxState[Any]) -> None:
        if snapshot.cells != self.cells:
            super().restore(snapshot)  # raises
        self._show(snapshot.placed)

    def _is_gripped(self, item: Item) -> bool:
        return not self.cell.reachable or best_grasp(item, self.cell) is not None

    def _is_feasible(self, candidate: PlacedItem) -> bool:
        if not self._is_gripped(candidate.item) or not super()._is_feasible(candidate):
            return False
        placed = self._occupancy.placed
        return not self.cell.reachable or placement.is_insertable(placed, candidate)

    def _execute(self, candidate: PlacedItem) -> None:
        """Let the arm try to place an item, and see where all items are then."""
        planned = self._lowered(candidate)
        self._show(
            attempt(
                self._tried, candidate, planned, cell=self.cell, cells=self.cells, arm=self._arm
            )
        )

    def _show(self, items: Sequence[ExecutedItem]) -> None:
        """Set the items, and what masks are computed among."""
        self._tried = tuple(items)
        occupancy: Occupancy[Any] = Occupancy(self.cells)
        for one in items:
            if self.cell.open_loop:
                occupancy.add(one.planned)
            elif is_over(self.cells, one.posed):
                occupancy.add(one.posed)
        self._occupancy = occupancy

    def _lowered(self, candidate: PlacedItem) -> PosedItem:
        """Return an item straight below its location, where it touches what masks know of."""
        posed = PosedItem.of(candidate)
        below = [float(posed.bounds[0, 2])]
        below += [placement.free_way(candidate, other) for other in self._occupancy.placed]
        return posed.moved(Motion.shift((0.0, 0.0, -max(min(below), 0.0))))
