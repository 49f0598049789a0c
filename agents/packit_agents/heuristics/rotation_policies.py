"""How the chosen shape is turned: policies for Rotation-Selection.

Where the location is chosen first, as in PackIt-Easy, they choose among the rotations valid there.
Rotations that tie are ranked in the order of alignment (`rotations.by_alignment`): small extents
along z first, then along x, then the lower index.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from packit_agents.heuristics.action_scores import ActionScores, by_chance, by_rank
from packit_sim.game.episode import Episode
from packit_sim.geometry import rotations
from packit_sim.placement import PlacedItem


@dataclass(frozen=True)
class RandomRotation:
    """Any of the valid rotations, uniformly: all 24 unless the location is chosen first."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(rng.choice(np.flatnonzero(episode.action_mask())))

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """By chance, too."""
        return by_chance(episode.action_mask(), rng)


@dataclass(frozen=True)
class Aligned:
    """Smallest extent along z, second smallest along x, largest along y (Goyal and Deng, 2020).

    Where the location is chosen first and that doesn't fit there, the nearest to it that does.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return next(_valid(episode))

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """By the order of alignment."""
        return by_rank(_valid(episode), rotations.COUNT)


@dataclass(frozen=True)
class FirstFit:
    """The first in the order of alignment in which the shape fits anywhere.

    That is `Aligned` where that fits, and where nothing does.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        first = next(_valid(episode))
        if episode.location is not None:
            return first
        assert episode.shape is not None
        item = episode.task.items[episode.shape]
        fitting = (n for n in _valid(episode) if episode.box.blbf(item.turned(n)) is not None)
        return next(fitting, first)


@dataclass(frozen=True)
class Lowest:
    """The one of all 24 that ends lowest: whose cell box has the lowest top at its BLBF location.

    The first in the order of alignment of those that tie; `Aligned` where the shape fits in none.
    In the spirit of minimum potential energy (HAPE3D: Liu, Liu, Cao and Yi, 2015), which looks at
    the centre of mass instead.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.shape is not None
        item, box = episode.task.items[episode.shape], episode.box
        best = next(_valid(episode))
        lowest = box.cells[2] + 1
        for rotation in _valid(episode):
            turned = item.turned(rotation)
            if turned.cells[2] >= lowest:
                continue  # not even on the floor
            at = episode.location or box.blbf(turned)
            if at is not None and (top := PlacedItem(turned, at).stop[2]) < lowest:
                best, lowest = rotation, top
        return best


def _valid(episode: Episode) -> Iterator[int]:
    """The valid rotations in the order of alignment."""
    assert episode.shape is not None
    valid = episode.action_mask()
    extents = episode.task.items[episode.shape].extents
    return (n for n in rotations.by_alignment(extents) if valid[n])
