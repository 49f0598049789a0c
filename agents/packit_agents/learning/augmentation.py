"""Shapes observed in random poses, so that a network does not memorise them."""

from __future__ import annotations

import itertools
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from packit_sim.game.envs.observations import Observation

_POSES = tuple(
    (order, flipped)
    for order in itertools.permutations(range(3))
    for flipped in itertools.product((1, -1), repeat=3)
)
"""The cube's 48 symmetries: an order of the axes, and a direction along each."""


class AugmentedEnv(gym.Wrapper[Observation, Any, Observation, Any]):
    """An environment whose observations show each shape rotated and mirrored at random.

    A pose is drawn for each shape in each episode, from the environment's generator. Only the field
    "shapes" changes, not the task: the policy `aligned` discards the original pose anyway, but a
    network that chooses rotations would be misled.
    """

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        drawn = self.env.unwrapped.np_random.integers(len(_POSES), size=len(observation["shapes"]))
        poses = zip(observation["shapes"], drawn.tolist(), strict=True)
        self._shapes = np.stack([transformed(cubes, pose) for cubes, pose in poses])
        return self._transformed(observation), info

    def step(self, action: Any) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._transformed(observation), reward, terminated, truncated, info

    def _transformed(self, observation: Observation) -> Observation:
        return {**observation, "shapes": self._shapes.copy()}


def transformed(cubes: npt.NDArray[np.float32], pose: int) -> npt.NDArray[np.float32]:
    """Transform the features of a shape to another pose.

    Parameters
    ----------
    cubes : ndarray
        float32 (c, c, c), the features.
    pose : int
        Number of the pose, 0 to 47; 0 is the original one.

    Returns
    -------
    ndarray
        float32 (c, c, c), a view of the features.
    """
    order, (x, y, z) = _POSES[pose]
    return cubes.transpose(order)[::x, ::y, ::z]
