"""Episodes in which items are placed at any position, in any rotation, off the grid."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim import placement
from packit_sim.box import BaseBox
from packit_sim.core.errors import InfeasibleError
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.episode import Stage
from packit_sim.geometry.items import PlacedItem, PosedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import checked_location
from packit_sim.rules import End


class LooseBox(BaseBox[PosedItem]):
    """A box whose items are anywhere, in any rotation; they stay where they are put."""

    @property
    def density(self) -> float:
        """The placed volume, relative to the box's volume."""
        return plain_sum(posed.item.volume for posed in self.placed) / self.volume

    def is_free(self, posed: PosedItem) -> bool:
        """Decide exactly whether an item is inside the box, and in conflict with no item there."""
        return placement.is_valid(self.cells, self.placed, posed)

    def place(self, posed: PosedItem) -> None:
        """Place an item, or raise InfeasibleError if it is not free there."""
        if not self.is_free(posed):
            raise InfeasibleError(
                f"{posed.item.shape.id!r} (scale {posed.item.scale:g}) at {posed.center.round(4)} "
                "is outside the box, or in conflict with items there"
            )
        self._occupancy.add(posed)

    def put(self, item: Item, location: Sequence[int]) -> float:
        self.place(PosedItem.of(PlacedItem(item, checked_location(self.cells, location))))
        return item.volume


class ContinuousEpisode:
    """A task whose items have their turns one by one, each to be placed once or left outside.

    It has what policies for shapes and observers read of an `Episode`.

    Parameters
    ----------
    task : Task
        The items to pack.
    cells : Triple
        The cells of the box along x, y and z.

    Attributes
    ----------
    waiting : ndarray
        Bool (n items,), which items have not had their turn.
    outside : ndarray
        Bool (n items,), which items are outside the box.
    shape : int, optional
        The item whose turn it is; None until one is chosen.
    total : float
        The placed volume, relative to the task's.
    end : End, optional
        Why the episode is over: all items are placed, or the last had its turn and some are
        outside.
    """

    stage = Stage.SHAPE
    rotation = 0
    location = None

    def __init__(self, task: Task, cells: Triple) -> None:
        self.task = task
        self.box = LooseBox(cells)
        self.waiting: npt.NDArray[np.bool_] = np.ones(len(task.items), dtype=bool)
        self.outside: npt.NDArray[np.bool_] = self.waiting.copy()
        self.total = 0.0
        self.end: End | None = None
        self.shape: int | None = None

    @property
    def visible(self) -> npt.NDArray[np.bool_]:
        """Bool (n items,), which items have not had their turn."""
        return self.waiting.copy()

    @property
    def arrived(self) -> int:
        """The number of items; all of them can be seen."""
        return len(self.waiting)

    @property
    def chosen_item(self) -> Any:
        """The item whose turn it is, in its canonical rotation; None at the end."""
        return None if self.shape is None else SimpleNamespace(item=self.item)

    @property
    def item(self) -> Item:
        """The item whose turn it is."""
        assert self.shape is not None
        return self.task.items[self.shape]

    def action_mask(self) -> npt.NDArray[np.bool_]:
        """Return which items can be chosen next: those that have not had their turn."""
        return self.waiting.copy()

    def choose(self, shape: int) -> None:
        """Say whose turn it is: an item that is still waiting."""
        assert self.waiting[shape]
        self.shape = shape

    def step(self, posed: PosedItem | None) -> float:
        """Place the item whose turn it is.

        Parameters
        ----------
        posed : PosedItem, optional
            The item where it is to be; None leaves it outside.

        Returns
        -------
        float
            The reward: its volume relative to the task's, 0 if it is not free there.
        """
        assert self.shape is not None
        self.waiting[self.shape] = False
        reward = 0.0
        if posed is not None:
            with suppress(InfeasibleError):
                self.box.place(posed)
                self.outside[self.shape] = False
                reward = posed.item.volume / self.task.volume
                self.total += reward
        self.shape = None
        if not self.waiting.any():
            self.end = End.NO_LOCATION if self.outside.any() else End.COMPLETE
        return reward
