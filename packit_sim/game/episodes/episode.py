"""Episodes of the game, without Gymnasium (paper, section 4.1).

Three sub-tasks repeat: choose a shape that is outside, a rotation for it, and a location. In
PackIt-Easy the location is chosen before the rotation. In the online game only the items of a
buffer are visible; the next item arrives when one of them is placed.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import cached_property
from packit_sim.core.checks import as_integer
from packit_sim.core.debugging import is_checking
from packit_sim.core.errors import ArgumentError, InfeasibleError, StateError
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.chosen_item import ChosenItem
from packit_sim.geometry import rotations
from packit_sim.geometry.items import ItemInBox, PlacedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.rules import PACKIT, End, Rules


class Stage(enum.IntEnum):
    """The next sub-task of an episode.

    Examples
    --------
    >>> from packit_sim import Episode, Stage, load_tasks
    >>> episode = Episode(load_tasks("starter")[0])
    >>> episode.stage
    <Stage.SHAPE: 0>
    >>> _ = episode.step(0)  # choose the first shape
    >>> episode.stage is Stage.ROTATION
    True
    """

    SHAPE = 0
    ROTATION = 1
    LOCATION = 2


_ORDER = (Stage.SHAPE, Stage.ROTATION, Stage.LOCATION)
_EASY_ORDER = (Stage.SHAPE, Stage.LOCATION, Stage.ROTATION)


def stages(rules: Rules) -> tuple[Stage, ...]:
    """Return the sub-tasks in the order in which they are played by some rules."""
    return _EASY_ORDER if rules.easy else _ORDER


def ordered(task: Task, rules: Rules) -> Task:
    """Return a task with its items in the order of an episode: online in that of their arrival."""
    return task if rules.buffer is None else task.arriving


def check_task(task: Task, rules: Rules) -> None:
    """Raise ArgumentError, before anything is played, if a task can't be played by some rules."""
    rules.check_items(task.cells, task.items)
    if rules.values and not task.values:
        raise ArgumentError(
            f"the items of task {task.digest} have no values, which the rules {rules} count: "
            "`Task.valued` gives them values"
        )


@dataclass(frozen=True)
class EpisodeState:
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
        True for each item of the task that is still outside.
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
    task : Task
        The task; in the online game with its items in the order of their arrival.
    box : BaseBox
        The box with the items packed so far.
    outside : ndarray
        Bool (n items,), which items of the task are still outside.
    stage : Stage
        The next sub-task.
    shape, rotation, location : int, int, tuple of int
        The choices for the item that is being placed; None where not chosen yet.
    chosen_item : ChosenItem, optional
        That item and its feasible locations, as soon as its location can be chosen: after its
        rotation, in PackIt-Easy after its shape. None before.
    total : float
        The sum of rewards so far.
    end : End, optional
        Why the episode is over; None if it is not.

    Notes
    -----
    In the online game a choice is valid only if the item can still be placed after it: shapes must
    be visible and fit in an allowed rotation, rotations must have a feasible location. The episode
    ends when no visible item can be placed.

    Examples
    --------
    >>> from packit_sim import Episode, load_tasks
    >>> episode = Episode(load_tasks("starter")[0])
    >>> _ = episode.step(3)  # the shape
    >>> _ = episode.step(0)  # its rotation
    >>> mask = episode.action_mask()
    >>> reward = episode.step(int(mask.argmax()))  # its first feasible location
    >>> round(reward, 3)
    0.048
    >>> episode.box
    Box((100, 100, 100), 1 items, density 0.021)
    """

    def __init__(self, task: Task, rules: Rules = PACKIT) -> None:
        check_task(task, rules)
        self.task = ordered(task, rules)
        self.rules = rules
        self.box = rules.new_box(task.cells)
        self.outside: npt.NDArray[np.bool_] = np.ones(len(task.items), dtype=bool)
        self.stage = Stage.SHAPE
        self.shape: int | None = None
        self.rotation: int | None = None
        self.location: Triple | None = None
        self.chosen_item: ChosenItem | None = None
        self.total = 0.0
        self.end: End | None = None
        self._fitting: dict[tuple[str, float, int], tuple[int, Triple | None]] = {}
        self._placements: dict[int, tuple[int, PlacedItem | None]] = {}
        self._placements_among: tuple[ItemInBox, ...] = ()
        self._find_end()

    @property
    def arrived(self) -> int:
        """The number of items that have arrived, in the task's order; all if not online."""
        count = len(self.outside)
        if self.rules.buffer is None:
            return count
        return min(count, count - int(np.count_nonzero(self.outside)) + self.rules.buffer)

    @property
    def visible(self) -> npt.NDArray[np.bool_]:
        """Bool (n items,): which items are outside and have arrived."""
        if self.rules.buffer is None:
            return self.outside.copy()
        return self.outside & (np.arange(len(self.outside)) < self.arrived)

    def visible_alone(self) -> Episode:
        """Create an episode of only the visible items, with the same content of the box.

        It is not online, so that a search that plans ahead in it knows only the visible items.
        """
        items = tuple(self.task.items[n] for n in np.flatnonzero(self.visible).tolist())
        known = Episode(
            replace(self.task, items=items, solution=()), self.rules.changed(buffer=None)
        )
        known.box.restore(self.box.snapshot())
        return known

    def action_mask(self) -> npt.NDArray[np.bool_]:
        """Compute the valid actions of this stage.

        Returns
        -------
        ndarray
            Bool: (n items,) for shapes, (24,) for rotations, or (nodes,) for locations, which are
            the grid nodes in C order.
        """
        if self.stage is Stage.SHAPE:
            if self.rules.buffer is None:
                return self.outside.copy()
            return np.array([bool(seen) and self._fits(n) for n, seen in enumerate(self.visible)])
        if self.stage is Stage.LOCATION:
            assert self.chosen_item is not None
            return self.chosen_item.feasible.ravel().copy()
        mask = np.zeros(rotations.COUNT, dtype=bool)
        allowed = self.rules.allowed_rotations
        if self.location is not None:
            assert self.chosen_item is not None
            mask[allowed] = self.chosen_item.rotations(self.location)[allowed]
        elif self.rules.buffer is None:
            mask[allowed] = True
        else:
            assert self.shape is not None
            mask[allowed] = [self._fits_in(self.task.items[self.shape], n) for n in allowed]
        return mask

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
        and online the first rotation that fits, in the order of alignment. While items are only
        added to the box, an earlier answer is reused if it is still feasible, unless the rules want
        support, which other items may give.

        Parameters
        ----------
        shape : int
            Index of the item in the task.

        Returns
        -------
        PlacedItem or None
            The item where it would be placed; None if it does not fit.
        """
        placed, among = tuple(self.box.placed), self._placements_among
        is_only_more = placed[: len(among)] == among and not self.rules.support
        if placed != among and not is_only_more:
            self._placements.clear()
        self._placements_among = placed
        if shape in self._placements:
            count, found = self._placements[shape]
            if found is None or count == len(placed):
                return found
            if self.box.is_feasible(found.item, found.location):
                assert not is_checking() or found == self._find_placement(self.task.items[shape])
                self._placements[shape] = len(placed), found
                return found
        found = self._find_placement(self.task.items[shape])
        self._placements[shape] = len(placed), found
        return found

    def state(self) -> EpisodeState:
        """Save the state of the episode, for `restore`; it is cheap."""
        choices = self.shape, self.rotation, self.location
        outside = tuple(self.outside.tolist())
        return EpisodeState(
            self._task_digest,
            self.rules,
            self.box.snapshot(),
            outside,
            self.stage,
            *choices,
            self.total,
            self.end,
        )

    def restore(self, state: EpisodeState) -> None:
        """Return to a state of an episode of the same task and rules.

        Parameters
        ----------
        state : EpisodeState
            The value that `state` returned.

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
        self._fitting.clear()
        is_chosen = self.shape is not None and (self.rules.easy or self.rotation is not None)
        self.chosen_item = self._choose_item() if is_chosen else None
        if is_checking():
            self._assert_same_as_box()

    @cached_property
    def _task_digest(self) -> str:
        return self.task.digest

    def _find_placement(self, item: Item) -> PlacedItem | None:
        ranked = self.rules.by_alignment(item)
        is_any = self.rules.easy or self.rules.buffer is not None
        for turned in ranked if is_any else ranked[:1]:
            location = self.box.blbf(turned)
            if location is not None:
                return PlacedItem(turned, location)
        return None

    def _fits(self, shape: int) -> bool:
        """Return whether an item has a feasible location in an allowed rotation."""
        item = self.task.items[shape]
        return any(self._fits_in(item, n) for n in self.rules.allowed_rotations)

    def _fits_in(self, item: Item, rotation: int) -> bool:
        """Return whether an item fits in a rotation: first try where it fitted before."""
        turned, count = item.turned(rotation), len(self.box.placed)
        among, known = self._fitting.get(turned.key, (-1, (0, 0, 0)))
        if known is not None and among != count and not self.box.is_feasible(turned, known):
            known = self.box.blbf(turned)
        assert not is_checking() or (known is None) == (self.box.blbf(turned) is None)
        self._fitting[turned.key] = count, known
        return known is not None

    def _find_end(self) -> None:
        """End the episode if nothing is left, or online if nothing visible can be placed."""
        if not self.outside.any():
            self.end = End.COMPLETE
        elif self.rules.buffer is not None and not any(
            self._fits(n) for n in np.flatnonzero(self.visible).tolist()
        ):
            self.end = End.NO_LOCATION

    def _choose_shape(self, shape: int) -> bool:
        is_valid = bool(0 <= shape < len(self.outside) and self.visible[shape])
        if is_valid and self.rules.buffer is not None:
            is_valid = self._fits(shape)
        if is_valid:
            self.shape = shape
        return is_valid

    def _choose_rotation(self, rotation: int) -> bool:
        is_valid = rotation in self.rules.allowed_rotations
        if is_valid and self.location is not None:
            is_valid = bool(self.action_mask()[rotation])
        elif is_valid and self.rules.buffer is not None:
            assert self.shape is not None
            is_valid = self._fits_in(self.task.items[self.shape], rotation)
        if is_valid:
            self.rotation = rotation
        return is_valid

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
        return ChosenItem(self.box, item, self.rules.allowed_rotations if self.rules.easy else None)

    def _place(self) -> float:
        """Place the chosen item and return the reward."""
        assert self.shape is not None and self.rotation is not None and self.location is not None
        item = self.task.items[self.shape].turned(self.rotation)
        count, before = len(self.box.placed), self._value_of(self.box.placed)
        try:
            gained = self.box.put(item, self.location)
        except InfeasibleError:
            self.end = End.INVALID_ACTION
            return 0.0
        reward = gained / self.task.volume
        if self.rules.values:
            gained = self._value_of(self.box.placed) - before
            reward = gained / plain_sum(self.task.values)
        self.total += reward
        self.outside[self.shape] = False
        self.shape = self.rotation = self.location = self.chosen_item = None
        self.stage = Stage.SHAPE
        if self.box.opens_locations:
            self._fitting.clear()
        if is_checking():
            assert len(self.box.placed) == count + 1
            self._assert_same_as_box()
        self._find_end()
        return reward

    def _value_of(self, placed: Iterable[ItemInBox]) -> float:
        """Add up the values of the items that count; 0 if the rules don't count values."""
        if not self.rules.values:
            return 0.0
        values = self.task.pack.values
        items = (one.item for one in placed if one.counts)
        return plain_sum(values[item.shape.id, item.scale] for item in items)

    def _assert_same_as_box(self) -> None:
        """Compare what is outside, and the rewards, with the last items of the box."""
        inside = [self.task.items[n] for n in np.flatnonzero(~self.outside).tolist()]
        given = len(self.box.placed) - len(inside)
        own = self.box.placed[given:]
        assert given >= 0
        assert sorted(p.item.turned(0).key for p in own) == sorted(i.turned(0).key for i in inside)
        if given and self.rules.moves_items:
            return  # items that were there before may have stopped counting
        if self.rules.values:
            total = plain_sum(self.task.values)
            own_value = self._value_of(own)
            assert math.isclose(self.total * total, own_value, rel_tol=1e-9, abs_tol=1e-12)
            return
        gained = plain_sum(placed.item.volume for placed in own if placed.counts)
        assert math.isclose(self.total * self.task.volume, gained, rel_tol=1e-9, abs_tol=1e-12)
