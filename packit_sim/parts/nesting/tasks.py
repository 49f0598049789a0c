"""The packing problem as arrays, its budget and its solutions."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.balance import ItemBalance
from packit_sim.parts.nesting.limits import ItemLimits
from packit_sim.parts.nesting.problem import State, state_of
from packit_sim.parts.nesting.settings import SearchSettings

ClockName = Literal["wall", "processor"]
"""The clock of a time limit: wall time, or the processor time of each worker."""

CLOCKS: dict[ClockName, Callable[[], float]] = {
    "wall": time.perf_counter,
    "processor": time.thread_time,
}
"""Functions that read each clock in the calling thread."""


class SearchBudget:
    """A limit of time or of passes for one round of a search.

    Parameters
    ----------
    seconds : float
        Time limit in seconds, from now on.
    passes : int, optional
        Pass limit, instead of the time limit.
    done : float
        Share of the whole search that is over when the round begins.
    whole : float, optional
        The seconds or passes of the whole search, if not only those of the round.
    stop : threading.Event, optional
        Ends the round as soon as it is set.
    clock : str
        The clock of the seconds (see `CLOCKS`), read in the thread that uses this budget.
    latest : float
        Seconds, from now on, after which no further item is put into a box: at the end of the
        whole search.
    """

    def __init__(
        self,
        seconds: float,
        passes: int | None = None,
        done: float = 0.0,
        whole: float | None = None,
        stop: threading.Event | None = None,
        clock: ClockName = "wall",
        latest: float = math.inf,
    ) -> None:
        self._now = CLOCKS[clock]
        self._start = self._now()
        self._end = self._start + seconds
        self._latest = self._start + latest
        self._passes = passes
        self._taken = 0
        self._done = done
        self._whole = whole or passes or seconds
        self._stop = stop

    @property
    def is_spent(self) -> bool:
        """True if nothing is left."""
        if self._is_stopped:
            return True
        if self._passes is None:
            return self._now() >= self._end
        return self._taken >= self._passes

    @property
    def is_late(self) -> bool:
        """True if the whole search should have ended."""
        return self._is_stopped or (self._passes is None and self._now() >= self._latest)

    @property
    def seconds_left(self) -> float:
        """Seconds until it is late; infinite with a limit of passes."""
        return max(0.0, self._latest - self._now()) if self._passes is None else math.inf

    @property
    def _is_stopped(self) -> bool:
        return self._stop is not None and self._stop.is_set()

    @property
    def progress(self) -> float:
        """The share of the whole search that is over."""
        spent = self._now() - self._start if self._passes is None else self._taken
        return self._done + spent / max(self._whole, 1e-9)

    def take(self, most: int) -> int:
        """Take up to `most` passes out of the budget; return their number."""
        if self._passes is None:
            return most
        passes = min(most, self._passes - self._taken)
        self._taken += passes
        return passes


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of items.

    Attributes
    ----------
    inside : ndarray of uint8, shape (n,)
        1 for items that are in a box.
    turned : ndarray of int64, shape (n,)
        The numbers of their rotations.
    places : ndarray of float64, shape (n, 3)
        The positions of their origins.
    """

    inside: Ints
    turned: Ints
    places: Floats

    @classmethod
    def of(cls, state: State) -> Poses:
        """Copy the poses of a state."""
        return cls(state.inside.copy(), state.turned.copy(), state.places.copy())

    def changed(self, items: Ints, inside: int) -> Poses:
        """Return the same poses with some items put inside (1) or taken out (0)."""
        now = self.inside.copy()
        now[items] = inside
        return Poses(now, self.turned, self.places)

    def only(self, items: Ints) -> Poses:
        """Return the poses of some items."""
        return Poses(self.inside[items], self.turned[items], self.places[items])

    def moved(self, items: Ints, poses: Poses) -> Poses:
        """Return the same poses but for those of some items."""
        inside, turned, places = self.inside.copy(), self.turned.copy(), self.places.copy()
        inside[items], turned[items], places[items] = poses.inside, poses.turned, poses.places
        return Poses(inside, turned, places)


@dataclass(frozen=True, eq=False)
class Solution:
    """Items without conflicts.

    Attributes
    ----------
    score : tuple of float
        Costs to minimise, in lexicographic order.
    poses : Poses
        The items' poses.
    boxes : ndarray of float64, shape (b, 4)
        The boxes (see `boxes_of`).
    """

    score: tuple[float, ...]
    poses: Poses
    boxes: Floats


@dataclass(eq=False)
class SearchTask:
    """A packing problem: items, container sizes and fixed obstacles.

    Attributes
    ----------
    numbers : ndarray of int64, shape (n + m,)
        The types of the n items, then those of the m obstacles, which never move.
    volumes, values : ndarray of float64, shape (n,)
        The items' volumes and values.
    sizes : tuple of tuple of float
        The sides of the container; the height of a strip is infinite. For bins, the sides of each
        available size, the largest first.
    obstacles : ndarray of float64, shape (m, 3)
        The positions of the obstacles.
    start : Poses, optional
        Poses to begin with, of a valid packing or of items that are not in conflict.
    limits : ItemLimits
        Limits on what is in the box, of a knapsack.
    balance : ItemBalance, optional
        A limit on where its centre of gravity is.
    """

    numbers: Ints
    volumes: Floats
    values: Floats
    sizes: tuple[tuple[float, float, float], ...]
    settings: SearchSettings = field(default_factory=SearchSettings)
    obstacles: Floats = field(default_factory=lambda: np.empty((0, 3)))
    start: Poses | None = None
    limits: ItemLimits = field(default_factory=ItemLimits)
    balance: ItemBalance | None = None

    @property
    def size(self) -> tuple[float, float, float]:
        """The sides of the container, or of the largest."""
        return self.sizes[0]

    @property
    def count(self) -> int:
        """The number of items."""
        return len(self.volumes)

    @property
    def is_limited(self) -> bool:
        """True if more than the space limits what is in a box."""
        return self.limits.count > 0 or self.balance is not None

    @property
    def unplaced(self) -> Poses:
        """Poses with the obstacles in their positions and no item inside."""
        n, m = self.count, len(self.obstacles)
        places = np.concatenate((np.zeros((n, 3)), self.obstacles))
        inside: Ints = np.repeat(np.array([0, 1], np.uint8), [n, m])
        return Poses(inside, np.zeros(n + m, np.int64), places)

    def state(self, has_weights: bool = True) -> State:
        """Return a state of all items at the origin (see `state_of`)."""
        return state_of(self.numbers.tolist(), self.count, has_weights)

    def only(self, items: Ints) -> SearchTask:
        """Return the task of some of the items, without limits and poses to begin with."""
        numbers = np.concatenate((self.numbers[items], self.numbers[self.count :]))
        own = numbers, self.volumes[items], self.values[items], self.sizes
        return SearchTask(*own, self.settings, self.obstacles)

    def addable(self, inside: Ints, items: Ints) -> Ints:
        """Return those items, in their order, that the limits allow besides those inside."""
        return self.limits.addable(inside[: self.count] > 0, items)

    @cached_property
    def order(self) -> Ints:
        """The items by value per volume, the highest first, and by volume where that is equal.

        Where limits run out before the space does, they count instead of the volume.
        """
        return self.order_by(self.limits.costs(self.values, self.volumes, math.prod(self.size)))

    def order_by(self, costs: Floats) -> Ints:
        """Return the items by value per cost, the highest first, and by volume where equal."""
        return np.lexsort((-self.volumes, -self.values / costs))
