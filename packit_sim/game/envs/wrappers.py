"""Observations for networks: without the action mask, or as one vector, by Gymnasium's wrappers.

`env.get_wrapper_attr("action_masks")` works through all of them; vector environments and the
MaskablePPO of sb3-contrib use it.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from packit_sim.core.errors import ArgumentError

__all__ = [
    "FlattenFloat32",
    "features_only",
    "flattened",
]

Vector = npt.NDArray[np.float32]

MAX_FLAT = 10_000_000
"""Maximum number of values of a flattened observation: 40 MB."""


def features_only(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """Remove "action_mask" from the observations of an environment.

    Parameters
    ----------
    env : gym.Env
        An environment with dicts as observations.

    Returns
    -------
    gym.Env
        The wrapped environment.

    Raises
    ------
    ArgumentError
        If the observations are not dicts.

    Notes
    -----
    The mask is for the logits, not for the network, and has 15,625 inputs if the agent chooses
    locations.
    """
    space = env.observation_space
    if not isinstance(space, spaces.Dict):
        raise ArgumentError(f"the observations must be dicts, not of space {space}")
    return FeaturesOnly(env)


def flattened(env: gym.Env[Any, Any]) -> gym.Env[Vector, Any]:
    """Flatten the observations of an environment, without "action_mask", for plain networks.

    Parameters
    ----------
    env : gym.Env
        An environment with the observations "features", "placement-features" or "none".

    Returns
    -------
    gym.Env
        The wrapped environment. Its observations are vectors, float32 (n,): the fields in
        alphabetical order, arrays in C order, "stage" and "chosen" as one-hot vectors of 3 and of
        max_shapes + 1 numbers. The last of those means that no shape is chosen.

    Raises
    ------
    ArgumentError
        If an observation has more than `MAX_FLAT` numbers, as voxels of the usual box have.
    """
    fields = features_only(env)
    count = spaces.flatdim(fields.observation_space)
    if count > MAX_FLAT:
        raise ArgumentError(
            f"an observation would be a vector of {count:,} numbers, {4 * count / 1e6:,.0f} MB; at "
            f"most {MAX_FLAT:,} are possible: make the environment with observation='features'"
        )
    return FlattenFloat32(fields)


class FeaturesOnly(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """Gymnasium's FilterObservation without "action_mask", which can also be pickled."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        assert isinstance(env.observation_space, spaces.Dict)
        fields = dict(env.observation_space)
        fields.pop("action_mask", None)
        self.observation_space = spaces.Dict(fields)
        self._names = tuple(fields)

    def observation(self, observation: Any) -> Any:
        return {name: observation[name] for name in self._names}


class FlattenFloat32(gym.ObservationWrapper[Vector, Any, Any], RecordConstructorArgs):
    """Gymnasium's FlattenObservation in float32, also if a part of the observation is float64."""

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
