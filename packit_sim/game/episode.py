"""One episode of packing: the rules of the game, without Gymnasium (paper, section 4.1).

Three sub-tasks in a cycle: choose a shape that is outside, a rotation for it, and a location. In
PackIt-Easy the location comes before the rotation.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.box import Box
from packit_sim.core.caches import cached_property
from packit_sim.core.errors import InfeasibleError, StateError
from packit_sim.datasets.packs import Task
from packit_sim.engine import feasibility
from packit_sim.engine.base_box import BaseBox
from packit_sim.engine.feasibility import Mask
from packit_sim.engine.occupancy import ItemInBox
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item


class Stage(enum.IntEnum):
    """The sub-task that comes next."""

    SHAPE = 0
    ROTATION = 1
    LOCATION = 2


ORDER = (Stage.SHAPE, Stage.ROTATION, Stage.LOCATION)
"""The sub-tasks of PackIt."""

EASY_ORDER = (Stage.SHAPE, Stage.LOCATION, Stage.ROTATION)
"""The sub-tasks of PackIt-Easy."""


class End(enum.StrEnum):
    """Why an episode ended."""

    COMPLETE = "all placed"
    NO_LOCATION = "no room"
    INVALID_ACTION = "invalid action"


class Choice:
    """An item that was chosen, and where the box has room for it in its rotation, or in any.

    item: in the chosen rotation; upright where none is chosen yet.
    """

    def __init__(self, box: BaseBox, item: Item, any_rotation: bool = False) -> None:
        self._box = box
        self._any_rotation = any_rotation
        self.item = item

    @cached_property
    def blbf(self) -> Triple | None:
        """The bottom-left-back-fill location, or None where there is no room."""
        if not self._any_rotation:
            return self._box.blbf(self.item)
        return feasibility.first(self.feasible)

    @cached_property
    def feasible(self) -> Mask:
        """The exact mask over the grid's nodes."""
        if self._any_rotation:
            return self._box.feasible_in_any(self.item)
        return self._box.feasible(self.item)

    def rotations(self, location: Triple) -> npt.NDArray[np.bool_]:
        """Bool (24,): the rotations in which the item is feasible at a location."""
        return self._box.rotations_at(self.item, location)


@dataclass(frozen=True)
class Site:
    """Where a shape would stand, were it the next. item: turned as it would be."""

    item: Item
    location: Triple


@dataclass(frozen=True)
class State:
    """Where an episode stands: a value, to go back to. box: the snapshot of one of its kind."""

    box: Any
    outside: tuple[bool, ...]
    stage: Stage
    shape: int | None
    rotation: int | None
    location: Triple | None
    total: float
    end: End | None


class Episode:
    """A task being played.

    easy: whether by PackIt-Easy's rules. kinematic: whether the box is (see `Box`). cells: of the
    box, if not the task's. box: an empty one of another kind, which then says all of that, such as
    one in which items settle (see `physics.box`). outside: bool (n,), which of the task's items are
    still outside. stage: the next sub-task. shape, rotation, location: what was chosen for the item
    that is being placed, None before. choice: that item, and where there is room, once that is
    asked for: when its rotation is chosen, in PackIt-Easy at once. total: the sum of the rewards so
    far. end: why it is over, or None.
    """

    def __init__(
        self,
        task: Task,
        *,
        easy: bool = False,
        kinematic: bool = False,
        cells: Triple | None = None,
        box: BaseBox | None = None,
    ) -> None:
        self.task = task
        self.easy = easy
        self.box = box or Box(cells or task.cells, kinematic=kinematic)
        self.outside: npt.NDArray[np.bool_] = np.ones(len(task.items), dtype=bool)
        self.stage = Stage.SHAPE
        self.shape: int | None = None
        self.rotation: int | None = None
        self.location: Triple | None = None
        self.choice: Choice | None = None
        self.total = 0.0
        self.end: End | None = None if task.items else End.COMPLETE
        self._sites: dict[int, tuple[int, Site | None]] = {}
        self._sites_among: tuple[ItemInBox, ...] = ()

    def action_mask(self) -> npt.NDArray[np.bool_]:
        """The valid actions of this stage: (n shapes,), (24,), or (locations,) in C order."""
        if self.stage is Stage.SHAPE:
            return self.outside.copy()
        if self.stage is Stage.LOCATION:
            assert self.choice is not None
            return self.choice.feasible.ravel().copy()
        if self.location is None:
            return np.ones(rotations.COUNT, dtype=bool)
        assert self.choice is not None
        return self.choice.rotations(self.location).copy()

    def step(self, action: int) -> float:
        """Plays an action of this stage and returns the reward.

        An action that is not valid ends the episode with reward 0. Raises RuntimeError where the
        episode is over already.
        """
        if self.end is not None:
            raise StateError(f"the episode is over: {self.end}")
        choose = (self._choose_shape, self._choose_rotation, self._choose_location)[self.stage]
        if not choose(int(action)):
            self.end = End.INVALID_ACTION
            return 0.0
        order = EASY_ORDER if self.easy else ORDER
        if self.stage is order[-1]:
            return self._place()
        self.stage = order[order.index(self.stage) + 1]
        if self.stage is Stage.LOCATION:
            self.choice = self._choice()
            if self.choice.blbf is None:
                self.end = End.NO_LOCATION
        return 0.0

    def site(self, shape: int) -> Site | None:
        """Where a shape has room: aligned, at its bottom-left-back-fill location; None without.

        In PackIt-Easy in the first rotation in the order of alignment in which there is room. While
        the box only gets fuller, it is looked for anew only where something stands there meanwhile.
        """
        placed = tuple(self.box.placed)
        if placed[: len(self._sites_among)] != self._sites_among:
            self._sites.clear()
        self._sites_among = placed
        if shape in self._sites:
            among, site = self._sites[shape]
            if site is None or among == len(placed):
                return site
            if self.box.is_feasible(site.item, site.location):
                self._sites[shape] = len(placed), site
                return site
        found = self._find_site(self.task.items[shape])
        self._sites[shape] = len(placed), found
        return found

    def state(self) -> State:
        """Where the episode stands, for `restore`; costs next to nothing."""
        return State(
            self.box.snapshot(),
            tuple(self.outside.tolist()),
            self.stage,
            self.shape,
            self.rotation,
            self.location,
            self.total,
            self.end,
        )

    def restore(self, state: State) -> None:
        """Goes back, or on, to a state of an episode of the same task and rules."""
        self.box.restore(state.box)
        self.outside = np.array(state.outside, dtype=bool)
        self.stage = state.stage
        self.shape, self.rotation, self.location = state.shape, state.rotation, state.location
        self.total, self.end = state.total, state.end
        chosen = self.shape is not None and (self.easy or self.rotation is not None)
        self.choice = self._choice() if chosen else None

    def _find_site(self, item: Item) -> Site | None:
        in_turn = rotations.by_alignment(item.extents)
        for turned in map(item.turned, in_turn if self.easy else in_turn[:1]):
            location = self.box.blbf(turned)
            if location is not None:
                return Site(turned, location)
        return None

    def _choose_shape(self, shape: int) -> bool:
        if not (0 <= shape < len(self.outside) and self.outside[shape]):
            return False
        self.shape = shape
        return True

    def _choose_rotation(self, rotation: int) -> bool:
        if not (0 <= rotation < rotations.COUNT and self.action_mask()[rotation]):
            return False
        self.rotation = rotation
        return True

    def _choose_location(self, number: int) -> bool:
        nodes = self.box.nodes
        if not 0 <= number < np.prod(nodes) or (self.easy and not self.action_mask()[number]):
            return False
        i, j, k = (int(n) for n in np.unravel_index(number, nodes))
        self.location = i, j, k
        return True

    def _choice(self) -> Choice:
        assert self.shape is not None
        item = self.task.items[self.shape]
        if self.rotation is not None:
            item = item.turned(self.rotation)
        return Choice(self.box, item, any_rotation=self.easy)

    def _place(self) -> float:
        """Places the item that was chosen, and returns the reward."""
        assert self.shape is not None and self.rotation is not None and self.location is not None
        item = self.task.items[self.shape].turned(self.rotation)
        try:
            gained = self.box.put(item, self.location)
        except InfeasibleError:
            self.end = End.INVALID_ACTION
            return 0.0
        reward = gained / self.task.volume
        self.total += reward
        self.outside[self.shape] = False
        self.shape = self.rotation = self.location = self.choice = None
        self.stage = Stage.SHAPE
        if not self.outside.any():
            self.end = End.COMPLETE
        return reward
