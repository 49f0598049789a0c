"""Policies for Shape-Selection: they choose the shape that is packed next.

A shape is valid if it is outside; in the online game only if it is visible and fits. Ties go to the
first shape.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from packit_agents.heuristics.action_scores import (
    ActionScores,
    by_random_weight,
    by_rank,
    by_weight,
)
from packit_sim.game.episodes.episode import Episode
from packit_sim.geometry.shapes import Item


@dataclass(frozen=True)
class RandomShape:
    """One of the valid shapes, drawn uniformly (Goyal and Deng, 2020)."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(rng.choice(np.flatnonzero(episode.action_mask())))

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """Rank the valid shapes at random, so that a search meets them in any order."""
        return by_random_weight(episode.action_mask(), rng)


class _First(ABC):
    """The valid shape with the largest weight; weights are also the likelihoods for a search."""

    @abstractmethod
    def weight(self, item: Item) -> float:
        """Compute an item's weight, greater than 0."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(self._weights(episode).argmax())

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        return by_weight(self._weights(episode))

    def _weights(self, episode: Episode) -> ActionScores:
        return np.array([self.weight(item) for item in episode.task.items]) * episode.action_mask()


@dataclass(frozen=True)
class LargestFirst(_First):
    """The shape outside with the largest volume (Goyal and Deng, 2020)."""

    def weight(self, item: Item) -> float:
        return item.volume


@dataclass(frozen=True)
class LargestFittingFirst(LargestFirst):
    """The largest of the shapes outside that fit in the aligned rotation (ours).

    In PackIt-Easy they may fit in any rotation. If none fits, the largest of all is chosen; for a
    search, shapes that do not fit are a million times less likely than by their volume.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        weights = self._weights(episode)
        largest_first = np.argsort(-weights, kind="stable")[: np.count_nonzero(weights)].tolist()
        return next((n for n in largest_first if episode.heuristic_placement(n)), largest_first[0])

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        weights = self._weights(episode)
        for n in np.flatnonzero(weights).tolist():
            if episode.heuristic_placement(n) is None:
                weights[n] *= 1e-6
        return by_weight(weights)


@dataclass(frozen=True)
class OldestFirst:
    """The valid shape that arrived first; without a buffer the first of the task (ours)."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(episode.action_mask().argmax())

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """Rank the valid shapes in the order of their arrival."""
        valid = np.flatnonzero(episode.action_mask())
        return by_rank(valid.tolist(), len(episode.outside))


@dataclass(frozen=True)
class SmallestFirst(_First):
    """The shape outside with the smallest volume: to compare with largest-first."""

    def weight(self, item: Item) -> float:
        return 1 / item.volume


@dataclass(frozen=True)
class LargestBoxFirst(_First):
    """The shape outside with the largest bounding box by volume (Wang and Hauser, 2019)."""

    def weight(self, item: Item) -> float:
        return float(np.sort(item.extents).prod())


@dataclass(frozen=True)
class LongestFirst(_First):
    """The shape outside whose bounding box has the longest side.

    Notes
    -----
    Burke, Hellier, Kendall and Whitwell (2006) order by length in two dimensions.
    """

    def weight(self, item: Item) -> float:
        return float(item.extents.max())
