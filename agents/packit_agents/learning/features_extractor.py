"""A features extractor for stable-baselines3, which encodes all shapes with the same weights.

Shapes of tensors: b observations in a batch, n slots for shapes in each, w features.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from packit_agents.learning.blocks import blocks
from packit_sim.core.errors import ArgumentError

_EACH_SHAPE = ("shapes", "extents", "volumes", "placement_features")
"""Observation fields with a row for each shape."""

_WHOLE = ("box", "item", "stage", "rotations")
"""Observation fields about the box, the chosen item and the stage."""


class ShapeSetExtractor(BaseFeaturesExtractor):
    """Extract features from the observations "features" and "placement-features".

    One network, shared by all shapes, encodes each shape that is outside the box. The maximum over
    the shapes and the encoded box give the features of the state; these and the encoded shape give
    the features of each shape.

    Parameters
    ----------
    observation_space : spaces.Dict
        The observation space of the environment.
    width : int
        Number of features of each layer, and of the state.
    shape_features : int
        Number of features of each shape.

    Raises
    ------
    ArgumentError
        If the environment has other observations, or a setting is less than 1.

    Notes
    -----
    The output is float32 (b, n * `shape_features` + `width`): first the features of the shapes in
    the order of the observation, 0 for shapes in the box, then those of the state. If the shapes
    change places, their features do the same, and the features of the state stay the same.

    "action_mask" and "locations" are not read: an algorithm with masks applies them to the actions.
    """

    def __init__(
        self, observation_space: spaces.Dict, width: int = 64, shape_features: int = 1
    ) -> None:
        check_features(observation_space, type(self).__name__)
        for name, value in (("width", width), ("shape_features", shape_features)):
            if value < 1:
                raise ArgumentError(
                    f"extractor setting {name} = {value} is not possible: 1 or more"
                )
        slots = _size(observation_space["outside"])
        super().__init__(observation_space, slots * shape_features + width)
        known = observation_space.spaces
        self._each = [name for name in _EACH_SHAPE if name in known]
        self._whole = [name for name in _WHOLE if name in known]
        inputs = 1 + sum(_size(known[name]) for name in self._each) // slots
        self.shapes = blocks(inputs, width, 1)
        self.whole = blocks(sum(_size(known[name]) for name in self._whole), width, 1)
        self.state = blocks(2 * width, width, 0)
        self.scores = nn.Sequential(blocks(2 * width, width, 1), nn.Linear(width, shape_features))

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Compute the features.

        Parameters
        ----------
        observations : Mapping[str, Tensor]
            Observation fields (b, ...), as stable-baselines3 prepares them: floats, discrete
            fields as one-hot vectors.

        Returns
        -------
        Tensor
            The features, float32 (b, n * shape_features + w).
        """
        outside = observations["outside"].bool()
        chosen = observations["chosen"].flatten(1)[:, : outside.shape[1]]  # (b, n)
        rows, _ = outside.nonzero(as_tuple=True)
        inputs = [observations[name][outside].reshape(len(rows), -1) for name in self._each]
        encoded = self.shapes(torch.cat([*inputs, chosen[outside].unsqueeze(1)], 1))
        shapes = encoded.new_zeros(*outside.shape, encoded.shape[1])
        shapes[outside] = encoded
        whole = torch.cat([observations[name].flatten(1) for name in self._whole], 1)
        pooled = shapes.amax(1)  # features are at least 0, and 0 for shapes in the box
        state = self.state(torch.cat([pooled, self.whole(whole)], 1))
        scored = self.scores(torch.cat([encoded, state[rows]], 1))
        features = scored.new_zeros(*outside.shape, scored.shape[1])
        features[outside] = scored
        return torch.cat([features.flatten(1), state], 1)


def _size(space: spaces.Space[object]) -> int:
    """Count the inputs of a field: a discrete one is a one-hot vector."""
    return int(space.n) if isinstance(space, spaces.Discrete) else math.prod(space.shape or ())


def check_features(space: spaces.Space[object], reader: str) -> None:
    """Check that an environment observes features.

    Parameters
    ----------
    space : spaces.Space
        The observation space of the environment.
    reader : str
        The name of the class that reads them, for the message.

    Raises
    ------
    ArgumentError
        If it observes something else.
    """
    known = space.spaces if isinstance(space, spaces.Dict) else {}
    shapes = known.get("shapes")
    if "box" in known and shapes is not None and shapes.dtype == np.float32:
        return
    if shapes is not None:
        found = "heightmaps" if "heightmap" in known else "voxels"
    else:
        found = "one vector" if isinstance(space, spaces.Box) else "no shapes"
    raise ArgumentError(
        f"{reader} needs the observation 'features' or 'placement-features', but the environment "
        f"observes {found}: make it with observation='features', without flattening it"
    )
