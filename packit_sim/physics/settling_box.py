"""A box in which all items settle after each placement.

Items are placed on the grid, at locations that are feasible among the items where they rest, and
released. They end anywhere, in any rotation. Each placement is simulated in a new world, in which
all items start without speed, so that the result depends only on the box's state, and a snapshot is
enough to restore it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from packit_sim.box import BaseBox, Disturbance
from packit_sim.core.debugging import is_checking
from packit_sim.core.errors import InfeasibleError
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.items import BoxState, PlacedItem, PosedItem
from packit_sim.geometry.lattice import BOX_CELLS
from packit_sim.geometry.shapes import Item
from packit_sim.physics.foresight import foreseen_movement
from packit_sim.physics.settings import DISTANCE, PhysicsSettings
from packit_sim.physics.settling import (
    Settled,
    SettledItem,
    farthest,
    fitted_with,
    settle_fitted,
)
from packit_sim.placement import Occupancy, checked_location


class SettlingBox(BaseBox[SettledItem]):
    """A box whose items come to rest after each placement.

    Parameters
    ----------
    cells : sequence of int, default: (100, 100, 100)
        Cells along x, y and z, whole grid steps. A cell is 1/100 of a box unit.
    settings : PhysicsSettings, optional
        The settings of the world. By default a box unit is half a metre.

    Raises
    ------
    ArgumentError
        If the cells are not possible.
    """

    def __init__(
        self, cells: Sequence[int] = BOX_CELLS, settings: PhysicsSettings | None = None
    ) -> None:
        super().__init__(cells)
        self.settings = settings or PhysicsSettings()

    @property
    def counted(self) -> float:
        """The volume of the items that are inside and stable, in cubic box units."""
        return plain_sum(settled.item.volume for settled in self.placed if settled.counts)

    @property
    def density(self) -> float:
        """The volume of the items that are inside and stable, relative to the box's volume."""
        return self.counted / self.volume

    def place(self, item: Item, location: Sequence[int]) -> Settled:
        """Place an item and let all items settle.

        Parameters
        ----------
        item : Item
            The item to place, in its rotation.
        location : sequence of int
            The grid node (i, j, k) at which it is released.

        Returns
        -------
        Settled
            The movements of the items.

        Raises
        ------
        InfeasibleError
            If the item is not feasible there. The box is unchanged.
        PhysicsError
            If the item can't be decomposed into convex pieces (see `decomposition.decompose`).
        """
        candidate = PlacedItem(item, checked_location(self.cells, location))
        if not self._is_feasible(candidate):
            raise InfeasibleError(
                f"{item.shape.id!r} (scale {item.scale:g}, rotation {item.rotation}) at "
                f"{candidate.location} is outside the box, or in conflict with items there"
            )
        settled = self._released(candidate)
        occupancy: Occupancy[SettledItem] = Occupancy(self.cells)
        for after in settled.items:
            occupancy.add(after)
        if is_checking():
            assert len(occupancy.placed) == len(self.placed) + 1
            for before, after in zip(self.placed, occupancy.placed, strict=False):
                assert before.item == after.item
                assert before.landed in (None, after.landed), "an item lands once"
        self._occupancy = occupancy
        return settled

    def disturbance(
        self, item: Item, location: Sequence[int], limit: float = math.inf
    ) -> Disturbance:
        def movement(before: PosedItem, after: PosedItem) -> float:
            return farthest(before.vertices, after.vertices) / DISTANCE

        start = self._with(PlacedItem(item, checked_location(self.cells, location)))
        origins = [one.landed if one.counts and one.landed else one.posed for one in self.placed]
        known = fitted_with(self.placed, start.placed[-1], self.settings)
        return foreseen_movement(start, known.pieces, self.settings, movement, origins, limit)

    def put(self, item: Item, location: Sequence[int]) -> float:
        before = self.counted
        self.place(item, location)
        return self.counted - before

    def _released(self, candidate: PlacedItem) -> Settled:
        """Let all items settle after an item was added."""
        start = self._with(candidate)
        known = fitted_with(self.placed, start.placed[-1], self.settings)
        settled = settle_fitted(start, known, self.settings)
        landed = [*(before.landed for before in self.placed), None]
        items = (
            replace(after, landed=first or after.landed)
            for after, first in zip(settled.items, landed, strict=True)
        )
        return replace(settled, items=tuple(items))

    def _with(self, candidate: PlacedItem) -> BoxState[PosedItem]:
        """Return the items where they are, and one more."""
        before = (settled.posed for settled in self.placed)
        return BoxState(self.cells, (*before, PosedItem.of(candidate)))
