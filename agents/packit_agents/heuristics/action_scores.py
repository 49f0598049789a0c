"""Log-probabilities of actions, by which searches choose alternatives."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

ActionScores = npt.NDArray[np.float64]
"""Log-probabilities (actions,); -inf for an action that is not valid."""


def by_weight(weights: npt.NDArray[np.float64]) -> ActionScores:
    """Make each action as likely as its weight; weight 0 marks an action that is not valid."""
    with np.errstate(divide="ignore"):
        return np.log(weights / weights.sum())


def by_random_weight(valid: npt.NDArray[np.bool_], rng: np.random.Generator) -> ActionScores:
    """Draw a random weight for each valid action, so that all orders are equally likely."""
    return by_weight(rng.exponential(size=len(valid)) * valid)


def by_rank(ranked: Iterable[int], actions: int) -> ActionScores:
    """Give the n-th of the ranked valid actions a weight of 1/n."""
    weights = np.zeros(actions)
    order = list(ranked)
    weights[order] = 1 / np.arange(1, len(order) + 1)
    return by_weight(weights)
