"""Shapes seen in other poses than their own, so that a network does not learn them by heart."""

from __future__ import annotations

import itertools
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from packit_sim.envs.observations import Observation

_POSES = tuple(
    (order, flipped)
    for order in itertools.permutations(range(3))
    for flipped in itertools.product((1, -1), repeat=3)
)
"""The cube's 48 symmetries: an order of the axes, and a direction along each."""


class AugmentedEnv(gym.Wrapper[Observation, Any, Observation, Any]):
    """An environment in whose observations each shape is turned, and maybe mirrored, by chance.

    In each episode anew, drawn from the environment's generator. Only "shapes" of the observations
    is turned. What the environment plays is the same, so that a network for rotations would be
    misled; which shape is to be next hangs little on a pose that `aligned` gives up anyway.
    """

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        seen, info = self.env.reset(seed=seed, options=options)
        drawn = self.env.unwrapped.np_random.integers(len(_POSES), size=len(seen["shapes"]))
        own = zip(seen["shapes"], drawn.tolist(), strict=True)
        self._shapes = np.stack([turned(cubes, pose) for cubes, pose in own])
        return self._turned(seen), info

    def step(self, action: Any) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        seen, reward, terminated, truncated, info = self.env.step(action)
        return self._turned(seen), reward, terminated, truncated, info

    def _turned(self, seen: Observation) -> Observation:
        return {**seen, "shapes": self._shapes.copy()}


def turned(cubes: npt.NDArray[np.float32], pose: int) -> npt.NDArray[np.float32]:
    """Features (c, c, c) of a shape in pose 0 to 47; 0 is its own."""
    order, (x, y, z) = _POSES[pose]
    return cubes.transpose(order)[::x, ::y, ::z]
