"""Observations for networks: without the action mask, or as one vector, by Gymnasium's wrappers.

`action_masks()` is found through any of them with `env.get_wrapper_attr("action_masks")`, which is
how vector environments and sb3-contrib's MaskablePPO ask for it.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import FilterObservation

__all__ = [
    "FlattenFloat32",
    "features_only",
    "flattened",
]

Vector = npt.NDArray[np.float32]


def features_only(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """The environment with observations without "action_mask".

    That mask says which logits to leave out and tells a network nothing, but where locations are
    the agent's it is 15 625 of the inputs. Everything else stays as `observations` describes it.
    Raises TypeError where the observations are no dicts.
    """
    space = env.observation_space
    if not isinstance(space, spaces.Dict):
        raise TypeError(f"the observations must be dicts, not of space {space}")
    return FilterObservation(env, [key for key in space if key != "action_mask"])


def flattened(env: gym.Env[Any, Any]) -> gym.Env[Vector, Any]:
    """The environment with `features_only` as one vector, float32 (n,), for plain networks.

    The keys follow each other in alphabetical order, arrays in C order, "stage" and "chosen" as
    one-hot vectors of 3 and of max_shapes + 1, the last of which says that no shape is chosen.
    Meant for the observations "features" and "none": voxels would be millions of numbers.
    """
    return FlattenFloat32(features_only(env))


class FlattenFloat32(gym.ObservationWrapper[Vector, Any, Any], RecordConstructorArgs):
    """Gymnasium's FlattenObservation, whose vectors are float64 where any part is, in float32."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        flat = spaces.flatten_space(env.observation_space)
        assert isinstance(flat, spaces.Box)
        low, high = (np.asarray(bound, dtype=np.float32) for bound in (flat.low, flat.high))
        self.observation_space = spaces.Box(low, high, dtype=np.float32)

    def observation(self, observation: Any) -> Vector:
        flat = spaces.flatten(self.env.observation_space, observation)
        return np.asarray(flat, dtype=np.float32)
