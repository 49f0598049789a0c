"""Limits on where the centre of gravity of a box's items is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from packit_sim.core.checks import check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.nesting.search_frames import in_search_frame, search_frame
from packit_sim.parts.packings.bounds import AMOUNTS, DISTANCES
from packit_sim.parts.packings.item_types import ItemType

_PAIRS = 40
"""Random pairs of items among which the one is chosen whose exchange balances best."""


class Posed(Protocol):
    """Poses of items, and which of them are in a box: `Poses` or a `State`."""

    @property
    def inside(self) -> Ints: ...

    @property
    def turned(self) -> Ints: ...

    @property
    def places(self) -> Floats: ...


@dataclass(frozen=True, eq=False)
class Balance:
    """A limit on where the centre of gravity of a knapsack's items is.

    Attributes
    ----------
    weights : sequence of float
        The weight of one of each type.
    centres : sequence of sequence of float
        The centre of gravity (3,) of each type, in its mesh's coordinates.
    reach : tuple of float
        The largest distances from the middle of the container along x and y.
    """

    weights: Sequence[float]
    centres: Sequence[Sequence[float]]
    reach: tuple[float, float]

    def of_items(
        self, types: Sequence[ItemType], turns: Floats, numbers: Ints, size: Sequence[float]
    ) -> ItemBalance:
        """Return the same limit for items of some types.

        Parameters
        ----------
        turns : ndarray of float64, shape (m, 3, 3)
            The rotations of the search.
        numbers : ndarray of int64, shape (n,)
            The type of each item.
        size : sequence of float
            The sides of the container.

        Returns
        -------
        ItemBalance
            The limit.

        Raises
        ------
        ArgumentError
            If it is of other types, or a number is out of range.
        """
        if not len(self.weights) == len(self.centres) == len(types):
            raise ArgumentError(f"a balance needs a weight and a centre for {len(types)} items")
        for weight in self.weights:
            check_range("a weight of a balance", weight, AMOUNTS)
        for each in self.reach:
            check_range("a reach of a balance", each, DISTANCES)
        searched = [in_search_frame(each) for each in types]
        centres = np.array(
            [
                search_frame(own) @ centre - (each.low + each.high) / 2
                for own, each, centre in zip(types, searched, self.centres, strict=True)
            ]
        )
        offsets = np.einsum("mij,tj->tmi", turns, centres)[..., :2]
        weights = np.array(self.weights, float)[numbers]
        return ItemBalance(weights, offsets[numbers], np.array(size[:2]) / 2, np.array(self.reach))


@dataclass(frozen=True, eq=False)
class ItemBalance:
    """A limit on where the centre of gravity of the items in a box is.

    Attributes
    ----------
    weights : ndarray of float64, shape (n,)
    offsets : ndarray of float64, shape (n, m, 2)
        The way from each item's origin to its centre of gravity, in each rotation.
    middle, reach : ndarray of float64, shape (2,)
        Where the centre has to be, and how far it may be off.
    """

    weights: Floats
    offsets: Floats
    middle: Floats
    reach: Floats

    def centres(self, poses: Posed, items: Ints) -> Floats:
        """Return the centres of gravity (k, 2) of some items, from the middle."""
        own = self.offsets[items, poses.turned[items]]
        return np.asarray(poses.places[items, :2] + own - self.middle)

    def off(self, poses: Posed) -> Floats:
        """Return the centre of gravity (2,) of the items inside, from the middle."""
        items = self.inside(poses)
        return self._mean(self.weights[items], self.centres(poses, items))

    def inside(self, poses: Posed) -> Ints:
        """Return the items inside."""
        return np.flatnonzero(poses.inside[: len(self.weights)])

    def beyond(self, off: Floats) -> Floats:
        """Return how much farther off than they may be some centres (..., 2) are, in reaches."""
        reach = np.maximum(self.reach, 1e-300)
        return np.asarray(np.maximum(np.abs(off) / reach - 1, 0).max(axis=-1))

    def is_kept(self, poses: Posed) -> bool:
        """Return whether the items inside keep the limit."""
        return not self.beyond(self.off(poses))

    def excess(self, poses: Posed, values: Floats) -> Ints:
        """Return the items to take out (see the function `excess`)."""
        items = self.inside(poses)
        own = self.weights[items], self.centres(poses, items), values[items]
        return np.asarray(items[excess(*own, self.reach)])

    def pair(self, poses: Posed, choices: np.random.Generator) -> tuple[int, int]:
        """Choose two of at least two items inside whose exchange of places balances all of them."""
        items = self.inside(poses)
        pairs = choices.integers(len(items), size=(_PAIRS, 2))
        weights, centres = self.weights[items], self.centres(poses, items)
        one, other = pairs.T
        moment = (weights[one] - weights[other])[:, None] * (centres[other] - centres[one])
        off = self._mean(weights, centres) + moment / max(float(weights.sum()), 1e-300)
        i, j = items[pairs[self.beyond(off).argmin()]].tolist()
        return i, j

    @staticmethod
    def _mean(weights: Floats, centres: Floats) -> Floats:
        total = float(weights.sum())
        return weights @ centres / total if total > 0 else np.zeros(2)


def excess(weights: Floats, centres: Floats, values: Floats, reach: Floats) -> Ints:
    """Choose items to leave out until the centre of gravity of the others is near the middle.

    Parameters
    ----------
    weights : ndarray of float64, shape (n,)
        The weight of each item.
    centres : ndarray of float64, shape (n, 2)
        Its centre of gravity, from the middle.
    values : ndarray of float64, shape (n,)
        Its value.
    reach : ndarray of float64, shape (2,)
        How far from the middle their common centre may be.

    Returns
    -------
    ndarray of int64
        The numbers of the items to leave out: each time the one of least value for what it gains.
    """
    kept = np.ones(len(weights), bool)
    goes: list[int] = []
    moments = weights[:, None] * centres
    limit = np.maximum(reach, 1e-300)
    while kept.any():
        total, moment = weights[kept].sum(), moments[kept].sum(axis=0)
        beyond = np.abs(moment) - limit * total  # above 0 where the limit is broken
        if total <= 0 or (beyond <= 0).all():
            break
        after = np.abs(moment - moments[kept]) - limit * (total - weights[kept, None])
        before = (np.maximum(beyond, 0) / limit).sum()
        gains = before - (np.maximum(after, 0) / limit).sum(axis=1)
        # The heaviest item on the side that is too heavy gains something; rounding may hide that.
        prices = np.maximum(values[kept], 1e-300) / np.maximum(gains, 1e-300)
        worst = int(np.flatnonzero(kept)[prices.argmin()])
        kept[worst] = False
        goes.append(worst)
    return np.array(goes, np.int64)
