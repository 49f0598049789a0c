"""One episode of packing: how the game is played, without Gymnasium (paper, section 4.1).

Three sub-tasks repeat: choose a shape that is outside, a rotation for it, and a location. In
PackIt-Easy the location is chosen before the rotation.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from packit_sim import placement
from packit_sim.box import BaseBox
from packit_sim.core.caches import cached_property
from packit_sim.core.checks import as_integer
from packit_sim.core.errors import ArgumentError, InfeasibleError, StateError
from packit_sim.datasets.packs import Task
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import ItemInBox, Mask, PlacedItem
from packit_sim.rules import PACKIT, End, Rules


class Stage(enum.IntEnum):
    """The next sub-task of an episode."""

    SHAPE = 0
    ROTATION = 1
    LOCATION = 2


_ORDER = (Stage.SHAPE, Stage.ROTATION, Stage.LOCATION)
_EASY_ORDER = (Stage.SHAPE, Stage.LOCATION, Stage.ROTATION)


def stages(rules: Rules) -> tuple[Stage, ...]:
    """Return the sub-tasks in the order in which they are played by some rules."""
    return _EASY_ORDER if rules.easy else _ORDER


class ChosenItem:
    """The item that is being placed, and where it fits.

    Results are computed when they are first needed, and kept. The box must not change meanwhile.

    Parameters
    ----------
    box : BaseBox
        The box to place it in.
    item : Item
        The item in the chosen rotation; in its canonical orientation if none is chosen yet.
    any_rotation : bool
        Whether `blbf` and `feasible` are over all 24 rotations instead of the item's own.
    """

    def __init__(self, box: BaseBox[Any], item: Item, any_rotation: bool = False) -> None:
        self._box = box
        self._any_rotation = any_rotation
        self._rotations: tuple[Triple, npt.NDArray[np.bool_]] | None = None
        self.item = item

    @cached_property
    def blbf(self) -> Triple | None:
        """The bottom-left-back-fill location, None if the item fits nowhere."""
        if not self._any_rotation:
            return self._box.blbf(self.item)
        return placement.first(self.feasible)

    @cached_property
    def feasible(self) -> Mask:
        """The exact mask of feasible locations, bool (nx, ny, nz) over the grid nodes."""
        if self._any_rotation:
            return self._box.feasible_in_any(self.item)
        return self._box.feasible(self.item)

    @cached_property
    def candidates(self) -> Mask:
        """A mask that contains all feasible locations, cheaper than `feasible`: see `Box`.

        It is for policies that look for one location: `is_feasible` decides whether it is feasible.
        """
        if self._any_rotation or "feasible" in self.__dict__:
            return self.feasible
        return self._box.candidates(self.item)

    def is_feasible(self, location: Triple) -> bool:
        """Decide whether a location is feasible.

        Parameters
        ----------
        location : Triple
            The grid node (i, j, k).

        Returns
        -------
        bool
            The value of `feasible` there.
        """
        if self._any_rotation or "feasible" in self.__dict__:
            return bool(self.feasible[location])
        return self._box.is_feasible(self.item, location)

    def rotations(self, location: Triple) -> npt.NDArray[np.bool_]:
        """Compute the rotations in which the item is feasible at a location.

        Parameters
        ----------
        location : Triple
            The grid node (i, j, k).

        Returns
        -------
        ndarray of bool, shape (24,)
            Kept until another location is asked for; it must not be written to.
        """
        if self._rotations is None or self._rotations[0] != location:
            self._rotations = location, self._box.rotations_at(self.item, location)
        return self._rotations[1]


@dataclass(frozen=True)
class State:
    """The whole state of an episode, to return to with `Episode.restore`.

    Attributes
    ----------
    task : str
        The digest of the task.
    rules : Rules
        The rules that are played.
    box : Any
        The state of the episode's box, as its `snapshot()` returns it.
    outside : tuple of bool
        Which items of the task are still outside.
    stage : Stage
        The next sub-task.
    shape, rotation, location : int, int, tuple of int
        The choices for the item that is being placed; None where not chosen yet.
    total : float
        The sum of rewards so far.
    end : End, optional
        Why the episode is over; None if it is not.
    """

    task: str
    rules: Rules
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

    Parameters
    ----------
    task : Task
        The items to pack.
    rules : Rules
        The rules to play by; by default those of the paper.

    Attributes
    ----------
    box : BaseBox
        What is packed so far.
    outside : ndarray
        Bool (n items,), which items of the task are still outside.
    stage : Stage
        The next sub-task.
    shape, rotation, location : int, int, tuple of int
        The choices for the item that is being placed; None where not chosen yet.
    chosen_item : ChosenItem, optional
        That item and where it fits, from when its location can be asked for: once its rotation is
        chosen, in PackIt-Easy once its shape is. None before.
    total : float
        The sum of rewards so far.
    end : End, optional
        Why the episode is over; None if it is not.
    """

    def __init__(self, task: Task, rules: Rules = PACKIT) -> None:
        self.task = task
        self.rules = rules
        self.box = rules.new_box(task.cells)
        self.outside: npt.NDArray[np.bool_] = np.ones(len(task.items), dtype=bool)
        self.stage = Stage.SHAPE
        self.shape: int | None = None
        self.rotation: int | None = None
        self.location: Triple | None = None
        self.chosen_item: ChosenItem | None = None
        self.total = 0.0
        self.end: End | None = None if task.items else End.COMPLETE
        self._placements: dict[int, tuple[int, PlacedItem | None]] = {}
        self._placements_among: tuple[ItemInBox, ...] = ()

    def action_mask(self) -> npt.NDArray[np.bool_]:
        """Compute the valid actions of this stage.

        Returns
        -------
        ndarray
            Bool: (n items,) for shapes, (24,) for rotations, or (nodes,) for locations, which are
            the grid nodes in C order.
        """
        if self.stage is Stage.SHAPE:
            return self.outside.copy()
        if self.stage is Stage.LOCATION:
            assert self.chosen_item is not None
            return self.chosen_item.feasible.ravel().copy()
        if self.location is None:
            return np.ones(rotations.COUNT, dtype=bool)
        assert self.chosen_item is not None
        return self.chosen_item.rotations(self.location).copy()

    def step(self, action: SupportsIndex) -> float:
        """Play an action of this stage.

        Parameters
        ----------
        action : SupportsIndex
            An index into `action_mask()`: an int, or an integer of NumPy. An action that is not
            valid ends the episode.

        Returns
        -------
        float
            The reward; 0 unless an item was placed.

        Raises
        ------
        StateError
            If the episode is over.
        ArgumentError
            If the action is not an integer.
        """
        if self.end is not None:
            raise StateError(f"the episode is over: {self.end}")
        number = as_integer("action", action)
        choose = (self._choose_shape, self._choose_rotation, self._choose_location)[self.stage]
        if not choose(number):
            self.end = End.INVALID_ACTION
            return 0.0
        order = stages(self.rules)
        if self.stage is order[-1]:
            return self._place()
        self.stage = order[order.index(self.stage) + 1]
        if self.stage is Stage.LOCATION:
            self.chosen_item = self._choose_item()
            if self.chosen_item.blbf is None:
                self.end = End.NO_LOCATION
        return 0.0

    def heuristic_placement(self, shape: int) -> PlacedItem | None:
        """Find where the paper's Heuristic would place an item if it was the next.

        The item gets the aligned rotation and the bottom-left-back-fill location; in PackIt-Easy
        the first rotation that fits, in the order of alignment. While items are only added to the
        box, an earlier answer is reused if it is still feasible.

        Parameters
        ----------
        shape : int
            Index of the item in the task.

        Returns
        -------
        PlacedItem or None
            The item where it would be placed; None if it does not fit.
        """
        placed = tuple(self.box.placed)
        if placed[: len(self._placements_among)] != self._placements_among:
            self._placements.clear()
        self._placements_among = placed
        if shape in self._placements:
            among, found = self._placements[shape]
            if found is None or among == len(placed):
                return found
            if self.box.is_feasible(found.item, found.location):
                self._placements[shape] = len(placed), found
                return found
        found = self._find_placement(self.task.items[shape])
        self._placements[shape] = len(placed), found
        return found

    def state(self) -> State:
        """Save the state of the episode, for `restore`; costs next to nothing."""
        choices = self.shape, self.rotation, self.location
        outside = tuple(self.outside.tolist())
        return State(
            self._task_digest,
            self.rules,
            self.box.snapshot(),
            outside,
            self.stage,
            *choices,
            self.total,
            self.end,
        )

    def restore(self, state: State) -> None:
        """Return to a state of an episode of the same task and rules.

        Parameters
        ----------
        state : State
            As `state` returned it.

        Raises
        ------
        ArgumentError
            If it is a state of another task or of other rules. The episode is unchanged.
        """
        if state.task != self._task_digest:
            raise ArgumentError(
                f"a state of the task {state.task} can't be restored in the task "
                f"{self._task_digest}: their items or boxes differ"
            )
        if state.rules != self.rules:
            raise ArgumentError(
                f"a state of the rules {str(state.rules)!r} can't be restored under the rules "
                f"{str(self.rules)!r}"
            )
        self.box.restore(state.box)
        self.outside = np.array(state.outside, dtype=bool)
        self.stage = state.stage
        self.shape, self.rotation, self.location = state.shape, state.rotation, state.location
        self.total, self.end = state.total, state.end
        is_chosen = self.shape is not None and (self.rules.easy or self.rotation is not None)
        self.chosen_item = self._choose_item() if is_chosen else None

    @cached_property
    def _task_digest(self) -> str:
        return self.task.digest

    def _find_placement(self, item: Item) -> PlacedItem | None:
        ranked = item.by_alignment
        for turned in ranked if self.rules.easy else ranked[:1]:
            location = self.box.blbf(turned)
            if location is not None:
                return PlacedItem(turned, location)
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
        if not 0 <= number < math.prod(nodes):
            return False
        if self.rules.easy and not self.action_mask()[number]:
            return False
        i, rest = divmod(number, nodes[1] * nodes[2])
        self.location = i, *divmod(rest, nodes[2])
        return True

    def _choose_item(self) -> ChosenItem:
        assert self.shape is not None
        item = self.task.items[self.shape]
        if self.rotation is not None:
            item = item.turned(self.rotation)
        return ChosenItem(self.box, item, any_rotation=self.rules.easy)

    def _place(self) -> float:
        """Place the chosen item and return the reward."""
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
        self.shape = self.rotation = self.location = self.chosen_item = None
        self.stage = Stage.SHAPE
        if not self.outside.any():
            self.end = End.COMPLETE
        return reward
