"""One episode of packing: the rules of the game, without Gymnasium (paper, section 4.1).

Three sub-tasks in a cycle: choose a shape that is outside, a rotation for it, and a location.
"""

from __future__ import annotations

import enum

import numpy as np
import numpy.typing as npt

from packit_sim import rotations
from packit_sim.box import Box
from packit_sim.caches import cached_property
from packit_sim.errors import InfeasibleError
from packit_sim.lattice import Triple
from packit_sim.packs import Task
from packit_sim.placement import Mask
from packit_sim.shapes import Item


class Stage(enum.IntEnum):
    """The sub-task that comes next."""

    SHAPE = 0
    ROTATION = 1
    LOCATION = 2


class End(enum.StrEnum):
    """Why an episode ended."""

    COMPLETE = "all placed"
    NO_LOCATION = "no room"
    INVALID_ACTION = "invalid action"


class Choice:
    """The item that was chosen, in the rotation that was chosen, and where the box has room."""

    def __init__(self, box: Box, item: Item) -> None:
        self._box = box
        self.item = item

    @cached_property
    def blbf(self) -> Triple | None:
        """The bottom-left-back-fill location, or None where there is no room."""
        return self._box.blbf(self.item)

    @cached_property
    def feasible(self) -> Mask:
        """The exact mask over the grid's nodes."""
        return self._box.feasible(self.item)


class Episode:
    """A task being played.

    outside: bool (n,), which of the task's items are still outside. stage: the next sub-task.
    shape: index of the chosen shape, or None before. choice: the chosen item once its rotation is,
    else None. total: the sum of the rewards so far. end: why it is over, or None.
    """

    def __init__(self, task: Task) -> None:
        self.task = task
        self.box = Box(task.cells)
        self.outside: npt.NDArray[np.bool_] = np.ones(len(task.items), dtype=bool)
        self.stage = Stage.SHAPE
        self.shape: int | None = None
        self.choice: Choice | None = None
        self.total = 0.0
        self.end: End | None = None if task.items else End.COMPLETE

    def action_mask(self) -> npt.NDArray[np.bool_]:
        """The valid actions of this stage: (n shapes,), (24,), or (locations,) in C order."""
        if self.stage is Stage.SHAPE:
            return self.outside.copy()
        if self.stage is Stage.ROTATION:
            return np.ones(rotations.COUNT, dtype=bool)
        assert self.choice is not None
        return self.choice.feasible.ravel().copy()

    def step(self, action: int) -> float:
        """Plays an action of this stage and returns the reward.

        An action that is not valid ends the episode with reward 0. Raises RuntimeError where the
        episode is over already.
        """
        if self.end is not None:
            raise RuntimeError(f"the episode is over: {self.end}")
        if self.stage is Stage.SHAPE:
            return self._choose_shape(int(action))
        if self.stage is Stage.ROTATION:
            return self._choose_rotation(int(action))
        return self._choose_location(int(action))

    def _choose_shape(self, shape: int) -> float:
        if not (0 <= shape < len(self.outside) and self.outside[shape]):
            return self._over(End.INVALID_ACTION)
        self.shape = shape
        self.stage = Stage.ROTATION
        return 0.0

    def _choose_rotation(self, rotation: int) -> float:
        if not 0 <= rotation < rotations.COUNT:
            return self._over(End.INVALID_ACTION)
        assert self.shape is not None
        item = self.task.items[self.shape]
        self.choice = Choice(self.box, Item(item.shape, item.scale, rotation))
        self.stage = Stage.LOCATION
        return 0.0 if self.choice.blbf is not None else self._over(End.NO_LOCATION)

    def _choose_location(self, number: int) -> float:
        assert self.choice is not None and self.shape is not None
        nodes = self.box.nodes
        if not 0 <= number < np.prod(nodes):
            return self._over(End.INVALID_ACTION)
        try:
            self.box.place(self.choice.item, [int(n) for n in np.unravel_index(number, nodes)])
        except InfeasibleError:
            return self._over(End.INVALID_ACTION)
        reward = self.choice.item.volume / self.task.volume
        self.total += reward
        self.outside[self.shape] = False
        self.shape = self.choice = None
        self.stage = Stage.SHAPE
        if not self.outside.any():
            self.end = End.COMPLETE
        return reward

    def _over(self, end: End) -> float:
        self.end = end
        return 0.0
