"""The paper's heuristics (section 4.3), one small policy each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_sim import rotations
from packit_sim.episode import Episode


@dataclass(frozen=True)
class RandomShape:
    """Any of the shapes outside, uniformly."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(rng.choice(np.flatnonzero(episode.outside)))


@dataclass(frozen=True)
class LargestFirst:
    """The shape outside with the largest volume; the first of those that tie."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        outside = np.flatnonzero(episode.outside)
        return int(max(outside, key=lambda n: episode.task.items[n].volume))


@dataclass(frozen=True)
class RandomRotation:
    """Any of the valid rotations, uniformly: all 24 unless the location is chosen first."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(rng.choice(np.flatnonzero(episode.action_mask())))


@dataclass(frozen=True)
class Aligned:
    """Smallest extent along z, second smallest along x, largest along y.

    Where the location is chosen first and that doesn't fit there, the nearest to it that does.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.shape is not None
        valid = episode.action_mask()
        extents = episode.task.items[episode.shape].extents
        return next(n for n in rotations.by_alignment(extents) if valid[n])


@dataclass(frozen=True)
class RandomLocation:
    """Any feasible location, uniformly."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.choice is not None
        return int(rng.choice(np.flatnonzero(episode.choice.feasible)))


@dataclass(frozen=True)
class BLBF:
    """Bottom-left-back fill: the feasible location least in (z, x, y)."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.choice is not None and episode.choice.blbf is not None
        return int(np.ravel_multi_index(episode.choice.blbf, episode.box.nodes))
