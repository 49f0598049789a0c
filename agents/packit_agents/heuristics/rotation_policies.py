"""Policies for Rotation-Selection: they choose the rotation of the chosen shape.

If the location is chosen first, as in PackIt-Easy, they choose among the rotations valid there.
Ties go to the first in the order of alignment (`rotations.by_alignment`): smaller extents along z,
then along x, then the lower index.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from packit_agents.heuristics.action_scores import ActionScores, by_random_weight, by_rank
from packit_sim.game.episodes.episode import Episode
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import STEP
from packit_sim.geometry.shapes import Item


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
        return next(_valid(episode)).rotation

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """Rank the valid rotations in the order of alignment."""
        return by_rank((item.rotation for item in _valid(episode)), rotations.COUNT)


@dataclass(frozen=True)
class FirstFit:
    """The first rotation, in the order of alignment, in which the shape fits anywhere.

    It is the choice of `Aligned` if the shape fits in that rotation, or in none.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        first = next(_valid(episode))
        if episode.location is not None:
            return first.rotation
        fitting = (item for item in _valid(episode) if episode.box.blbf(item) is not None)
        return next(fitting, first).rotation


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
        box = episode.box
        best = next(_valid(episode))
        lowest = box.cells[2] + 1
        for item in _valid(episode):
            height = item.cells[2]
            if height >= lowest:
                continue  # too tall even on the floor
            layers = (lowest - height - 1) // STEP + 1
            at = episode.location or box.blbf(item, layers=layers)
            if at is not None and at[2] < layers:
                best, lowest = item, STEP * at[2] + height
        return best.rotation


def _valid(episode: Episode) -> Iterator[Item]:
    """Yield the chosen item in the valid rotations, in the order of alignment."""
    assert episode.shape is not None
    valid = episode.action_mask().tolist()
    ranked = episode.task.items[episode.shape].by_alignment
    return (item for item in ranked if valid[item.rotation])
