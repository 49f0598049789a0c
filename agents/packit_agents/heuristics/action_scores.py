"""Log-probabilities for policies that rank: what searches choose alternatives by."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

ActionScores = npt.NDArray[np.float64]


def by_weight(weights: npt.NDArray[np.float64]) -> ActionScores:
    """Each action as likely as its weight says; weight 0 for one that is not valid."""
    with np.errstate(divide="ignore"):
        return np.log(weights / weights.sum())


def by_chance(valid: npt.NDArray[np.bool_], rng: np.random.Generator) -> ActionScores:
    """Each valid action with a weight by chance, so that any order of them is as likely."""
    return by_weight(rng.exponential(size=len(valid)) * valid)


def by_rank(ranked: Iterable[int], actions: int) -> ActionScores:
    """The n-th of the valid actions, ranked, with a weight of 1/n."""
    weights = np.zeros(actions)
    order = list(ranked)
    weights[order] = 1 / np.arange(1, len(order) + 1)
    return by_weight(weights)
