"""Limits on what one box holds, such as its mass: sums of amounts over the items in it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.optimize import LinearConstraint, linprog, milp

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.packings.bounds import SUM_ROUNDING

_FULL = 0.6
"""Share of a box's volume that items probably fill, for the choice among them."""

_TIES = 1e-3
"""Price of what does not run out, relative to the value: it decides between equal items."""

_SECONDS = 1.0
"""Most time to compute a bound."""


@dataclass(frozen=True, eq=False)
class ItemLimits:
    """Limits on sums over the items in a box.

    Attributes
    ----------
    amounts : ndarray of float64, shape (k, n)
        For each limit, the amount of each item.
    most : ndarray of float64, shape (k,)
        The largest sums.
    """

    amounts: Floats = field(default_factory=lambda: np.empty((0, 0)))
    most: Floats = field(default_factory=lambda: np.empty(0))

    @property
    def count(self) -> int:
        """How many limits there are."""
        return len(self.most)

    def left(self, packed: npt.NDArray[np.bool_]) -> Floats:
        """Return how much (k,) of each limit some items (n,) leave; below 0 if they break it."""
        if not self.count:
            return np.empty(0)
        return self.most * (1 + SUM_ROUNDING) - self.amounts @ packed

    def possible(self, count: int) -> npt.NDArray[np.bool_]:
        """Return which of all items (n,) may be in a box, at least alone."""
        if not self.count:
            return np.ones(count, bool)
        return np.asarray(np.all(self.amounts <= self.most[:, None] * (1 + SUM_ROUNDING), axis=0))

    def addable(self, packed: npt.NDArray[np.bool_], items: Ints) -> Ints:
        """Return those items, in their order, that may all be added to some others (n,)."""
        if not self.count:
            return items
        left, found = self.left(packed), []
        for i in items.tolist():
            after = left - self.amounts[:, i]
            if (after >= 0).all():
                left = after
                found.append(i)
        return np.array(found, np.int64)

    def allow(self, left: Floats, comes: Ints, goes: Ints) -> bool:
        """Return whether some items may replace others, by how much (k,) is left before."""
        if not self.count:
            return True
        more = self.amounts[:, comes].sum(axis=1) - self.amounts[:, goes].sum(axis=1)
        return bool((more <= left).all())

    def excess(self, packed: npt.NDArray[np.bool_], values: Floats) -> Ints:
        """Return the items to take out of some (n,) that break a limit: of least value for it."""
        goes: list[int] = []
        packed = packed.copy()
        while self.count and (broken := self.left(packed) < 0).any():
            inside = np.flatnonzero(packed)
            shares = (self.amounts[broken] / self.most[broken, None])[:, inside].sum(axis=0)
            worst = int(inside[(values[inside] / np.maximum(shares, 1e-300)).argmin()])
            packed[worst] = False
            goes.append(worst)
        return np.array(goes, np.int64)

    def costs(self, values: Floats, volumes: Floats, space: float) -> Floats:
        """Return what each item (n,) takes of a box: its volume, as far as that is what runs out.

        Algorithm: the dual prices of the linear relaxation weigh the volume and the limits, a
        surrogate relaxation of the knapsack of several dimensions (Pirkul, 1987).
        """
        if not self.count:
            return volumes
        table = np.vstack((volumes, self.amounts))
        sums = np.array([_FULL * space, *self.most])
        found = linprog(-values, table, sums, bounds=(0, 1))
        if found.status != 0 or not found.ineqlin.marginals.any():
            return volumes
        prices = _TIES * -found.fun / np.maximum(sums, 1e-300) - found.ineqlin.marginals
        return np.maximum(prices @ table, 1e-300)

    def most_value(self, values: Floats) -> float:
        """Return an upper bound of the value that the limits allow, infinite without any."""
        if not self.count:
            return math.inf
        kinds, counts = np.unique(np.vstack((values, self.amounts)), axis=1, return_counts=True)
        found = milp(
            -kinds[0],
            integrality=np.ones(len(counts)),
            bounds=(0, counts),
            constraints=LinearConstraint(kinds[1:], ub=self.most * (1 + SUM_ROUNDING)),
            options={"time_limit": _SECONDS},
        )
        bound = found.mip_dual_bound
        return math.inf if bound is None else -float(bound)
