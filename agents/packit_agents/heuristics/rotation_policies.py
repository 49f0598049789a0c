"""Policies for Rotation-Selection: the rotation of the chosen shape.

If the location is chosen first, as in PackIt-Easy, they choose among the rotations valid there.
Ties go to the first in the order of alignment (`rotations.by_alignment`): smaller extents along z,
then along x, then the lower index.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from packit_agents.heuristics.action_scores import ActionScores, by_random_weight, by_rank
from packit_sim.game.episode import Episode
from packit_sim.geometry import rotations
from packit_sim.placement import PlacedItem


@dataclass(frozen=True)
class RandomRotation:
    """A valid rotation drawn uniformly, from all 24 unless the location is chosen first."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(rng.choice(np.flatnonzero(episode.action_mask())))

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """Rank the valid rotations at random."""
        return by_random_weight(episode.action_mask(), rng)


@dataclass(frozen=True)
class Aligned:
    """Smallest extent along z, second smallest along x, largest along y (Goyal and Deng, 2020).

    If the location is chosen first and that rotation does not fit there, the next that does, in
    the order of alignment.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return next(_valid(episode))

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """Rank the valid rotations in the order of alignment."""
        return by_rank(_valid(episode), rotations.COUNT)


@dataclass(frozen=True)
class FirstFit:
    """The first rotation, in the order of alignment, in which the shape fits anywhere.

    It is the choice of `Aligned` if the shape fits in that rotation, or in none.
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
    """The rotation whose cell box has the lowest top at its BLBF location, of all 24.

    Ties go to the first in the order of alignment. If the shape fits in no rotation, it is the
    choice of `Aligned`.

    Notes
    -----
    Similar to minimum potential energy (HAPE3D: Liu, Liu, Cao and Yi, 2015), which considers the
    centre of mass instead.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.shape is not None
        item, box = episode.task.items[episode.shape], episode.box
        best = next(_valid(episode))
        lowest = box.cells[2] + 1
        for rotation in _valid(episode):
            turned = item.turned(rotation)
            if turned.cells[2] >= lowest:
                continue  # too tall even on the floor
            at = episode.location or box.blbf(turned)
            if at is not None and (top := PlacedItem(turned, at).stop[2]) < lowest:
                best, lowest = rotation, top
        return best


def _valid(episode: Episode) -> Iterator[int]:
    """Yield the valid rotations in the order of alignment."""
    assert episode.shape is not None
    valid = episode.action_mask()
    extents = episode.task.items[episode.shape].extents
    return (n for n in rotations.by_alignment(extents) if valid[n])
