"""Which shape comes next: policies for Shape-Selection.

Of the shapes that tie, the first.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from packit_agents.heuristics.action_scores import ActionScores, by_chance, by_weight
from packit_sim.game.episode import Episode
from packit_sim.geometry.shapes import Item


@dataclass(frozen=True)
class RandomShape:
    """Any of the shapes outside, uniformly (Goyal and Deng, 2020)."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(rng.choice(np.flatnonzero(episode.outside)))

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """By chance, too: so that a search finds the shapes in any order."""
        return by_chance(episode.outside, rng)


class _First(ABC):
    """The shape outside with the largest weight; as likely as its weight says, for a search."""

    @abstractmethod
    def weight(self, item: Item) -> float:
        """More than 0."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(self._weights(episode).argmax())

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        return by_weight(self._weights(episode))

    def _weights(self, episode: Episode) -> ActionScores:
        return np.array([self.weight(item) for item in episode.task.items]) * episode.outside


@dataclass(frozen=True)
class LargestFirst(_First):
    """The shape outside with the largest volume (Goyal and Deng, 2020)."""

    def weight(self, item: Item) -> float:
        return item.volume


@dataclass(frozen=True)
class LargestFittingFirst(LargestFirst):
    """The largest of the shapes outside that have room, in the aligned rotation (ours).

    In PackIt-Easy in any rotation. Where none has room, the largest of all; for a search those
    without are a million times less likely than by their volume.
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
class SmallestFirst(_First):
    """The shape outside with the smallest volume: to compare `LargestFirst` with its opposite."""

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

    Burke, Hellier, Kendall and Whitwell (2006) order by length so, in two dimensions.
    """

    def weight(self, item: Item) -> float:
        return float(item.extents.max())
