"""Agents of the environment off the grid: random poses, and the paper's Heuristic.

Each is called with the environment's episode and a random generator, and returns an action.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.game.episodes.continuous import ContinuousEpisode
from packit_sim.geometry.items import PlacedItem, PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion

Action = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RandomPose:
    """A uniform rotation, and a uniform position at which the item's bounding box is inside.

    Parameters
    ----------
    tries : int
        The number of poses to draw, until one is free.
    """

    tries: int = 100

    def __call__(self, episode: ContinuousEpisode, rng: np.random.Generator) -> Action:
        size = np.array(episode.box.cells) * CELL
        action = np.zeros(7)
        for _ in range(self.tries):
            w, x, y, z = _unit(rng.normal(size=4))
            turned = PosedItem.at(episode.item, Motion.from_wxyz((w, x, y, z)))
            low, high = turned.bounds
            if (high - low > size).any():
                continue
            at = rng.uniform(-low, size - high)
            action = np.array([*at, w, x, y, z])
            if episode.box.is_free(turned.moved(Motion.turn(0, at))):
                break
        return action


class GridPose:
    """The paper's Heuristic: the aligned rotation, at the bottom-left-back-fill location.

    Locations are those of the grid, and exact among the items wherever they are. The action for an
    item that fits nowhere has no rotation, and leaves it outside.
    """

    def __call__(self, episode: ContinuousEpisode, rng: np.random.Generator) -> Action:
        turned = episode.item.by_alignment[0]
        location = episode.box.blbf(turned)
        if location is None:
            return np.zeros(7)
        pose = PlacedItem(turned, location).pose
        return np.array([*pose.translation, *pose.wxyz])


def _unit(quaternion: Action) -> list[float]:
    """Scale a quaternion to the length 1."""
    unit: list[float] = (quaternion / np.linalg.norm(quaternion)).tolist()
    return unit
