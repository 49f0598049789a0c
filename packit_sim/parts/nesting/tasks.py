"""What is searched for, for how long, and what is found."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.problem import State, state_of

PASSES = 5
"""Passes of a separation between two looks at the clock."""

ClockName = Literal["wall", "processor"]
"""What seconds of a search are: wall time, or processor time of each worker."""

CLOCKS: dict[ClockName, Callable[[], float]] = {
    "wall": time.perf_counter,
    "processor": time.thread_time,
}
"""How each clock is read in one thread."""


@dataclass(frozen=True)
class SearchSettings:
    """The settings of a search; the defaults come from measurements (`benchmarks/nesting`).

    Attributes
    ----------
    samples : int
        Samples of a move.
    patience : int
        Passes without a gain after which a separation gives up.
    exchange_patience : int
        The same, after an exchange of items of a knapsack.
    construction_samples : int
        Samples for each item of a construction.
    shrink : float
        Largest share by which a strip shrinks at a time.
    least_shrink : float
        Smallest share.
    """

    samples: int = 90
    patience: int = 60
    exchange_patience: int = 15
    construction_samples: int = 150
    shrink: float = 0.04
    least_shrink: float = 0.0002


class SearchBudget:
    """Time or passes that a search may take.

    Parameters
    ----------
    seconds : float
        Seconds from now on.
    passes : int, optional
        Passes, instead of the time.
    shares : tuple of float
        The shares of the whole search before and after these.
    stop : threading.Event, optional
        Leaves nothing when it is set.
    clock : str
        The clock of the seconds (see `CLOCKS`), of the thread that makes and asks this.
    """

    def __init__(
        self,
        seconds: float,
        passes: int | None = None,
        shares: tuple[float, float] = (0.0, 1.0),
        stop: threading.Event | None = None,
        clock: ClockName = "wall",
    ) -> None:
        self._seconds = seconds
        self._now = CLOCKS[clock]
        self._end = self._now() + seconds
        self._passes = passes
        self._all_passes = passes or 0
        self._shares = shares
        self._stop = stop

    @property
    def is_spent(self) -> bool:
        """Whether nothing is left."""
        if self._stop is not None and self._stop.is_set():
            return True
        if self._passes is None:
            return self._now() >= self._end
        return self._passes <= 0

    @property
    def progress(self) -> float:
        """Which share of the whole search is spent."""
        if self._passes is None:
            left = (self._end - self._now()) / max(self._seconds, 1e-9)
        else:
            left = self._passes / max(self._all_passes, 1)
        first, last = self._shares
        return last - (last - first) * min(1.0, left)

    def take(self) -> int:
        """Return how many passes may come next, at most `PASSES`."""
        if self._passes is None:
            return PASSES
        passes = min(PASSES, self._passes)
        self._passes -= passes
        return passes


@dataclass(frozen=True, eq=False)
class Poses:
    """Where items are.

    Attributes
    ----------
    inside : ndarray of uint8, shape (n,)
        Whether an item is in a box.
    turned : ndarray of int64, shape (n,)
        The numbers of their rotations.
    places : ndarray of float64, shape (n, 3)
        The places of their origins.
    """

    inside: Ints
    turned: Ints
    places: Floats

    @classmethod
    def of(cls, state: State) -> Poses:
        """Copy the poses of a state."""
        return cls(state.inside.copy(), state.turned.copy(), state.places.copy())

    def changed(self, items: Ints, inside: int) -> Poses:
        """Return the same poses with some items inside, or not."""
        now = self.inside.copy()
        now[items] = inside
        return Poses(now, self.turned, self.places)


@dataclass(frozen=True, eq=False)
class Solution:
    """Items without conflicts.

    Attributes
    ----------
    score : tuple of float
        What is to be as small as possible, the most important number first.
    poses : Poses
        Where the items are.
    boxes : ndarray of float64, shape (b, 4)
        The boxes (see `boxes_of`).
    """

    score: tuple[float, ...]
    poses: Poses
    boxes: Floats


@dataclass(eq=False)
class SearchTask:
    """What is searched for.

    Attributes
    ----------
    numbers : ndarray of int64, shape (n + m,)
        The type of each item, and then of each obstacle, which stays where it is.
    volumes, values : ndarray of float64, shape (n,)
        Their volumes and values.
    sizes : tuple of tuple of float
        The sides of the container; the height of a strip is infinite. For bins those of each size,
        the largest first.
    settings : SearchSettings
        The settings.
    obstacles : ndarray of float64, shape (m, 3)
        The places of the obstacles.
    start : Poses, optional
        Poses to begin with; items that are in conflict there are placed again.
    """

    numbers: Ints
    volumes: Floats
    values: Floats
    sizes: tuple[tuple[float, float, float], ...]
    settings: SearchSettings = field(default_factory=SearchSettings)
    obstacles: Floats = field(default_factory=lambda: np.empty((0, 3)))
    start: Poses | None = None

    @property
    def size(self) -> tuple[float, float, float]:
        """The sides of the container, or of the largest."""
        return self.sizes[0]

    @property
    def count(self) -> int:
        """The number of items."""
        return len(self.volumes)

    @property
    def nowhere(self) -> Poses:
        """Poses of items that are not inside, and of the obstacles."""
        n, m = self.count, len(self.obstacles)
        places = np.concatenate((np.zeros((n, 3)), self.obstacles))
        inside: Ints = np.repeat(np.array([0, 1], np.uint8), [n, m])
        return Poses(inside, np.zeros(n + m, np.int64), places)

    def state(self) -> State:
        """Return a state of all items at the origin."""
        return state_of(self.numbers.tolist(), self.count)

    @cached_property
    def order(self) -> Ints:
        """The items, the most valuable by volume first, and of equal ones the largest."""
        return np.lexsort((-self.volumes, -self.values / self.volumes))
