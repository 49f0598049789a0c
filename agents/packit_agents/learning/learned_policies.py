"""Policies that were learned: networks that play episodes."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from packit_agents.heuristics.action_scores import ActionScores
from packit_agents.learning.networks import AllPolicies
from packit_agents.learning.weights import WeightsError, read_weights
from packit_sim.envs.observations import FeatureObserver, Observation, PlacementFeatureObserver
from packit_sim.game.episode import Episode, Stage
from packit_sim.geometry.lattice import BOX_CELLS

SHAPE_FIELDS = ("shapes", "box", "outside", "placement_features")
"""What networks look at that choose shapes, as far as it is observed."""

FIELDS = (*SHAPE_FIELDS, "stage", "chosen", "item")
"""What those look at that choose rotations and locations too."""


class _Learned:
    """The action to which a network gives the highest probability.

    file: of weights. weights_digest: where its SHA-256 begins. Pickled as the name alone.
    Raises WeightsError where it can't be loaded, or does not choose what is asked for.
    """

    stage: ClassVar[Stage]

    def __init__(self, file: Path | str) -> None:
        self._file = Path(file)
        self._network, self._placement_features, self.made = read_weights(self._file)
        self.weights_digest = hashlib.sha256(self._file.read_bytes()).hexdigest()[:16]
        if self.stage is not Stage.SHAPE and not isinstance(self._network, AllPolicies):
            raise WeightsError(
                f"{self._file} chooses shapes, no {self.stage.name.lower()}s: it was trained with "
                "network.policies=shape"
            )
        self._observer: FeatureObserver | None = None
        self._room: tuple[Any, ...] = ()

    @classmethod
    def parse(cls, value: str) -> Self:
        """Of the path of a file of weights, as `packit train` writes them."""
        return cls(value)

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(self.scores(episode, rng).argmax())

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        cells = episode.box.cells
        if isinstance(self._network, AllPolicies) and cells != BOX_CELLS:
            raise WeightsError(f"{self._file} plays in boxes of {BOX_CELLS} cells, not {cells}")
        room = (cells, len(episode.outside))
        if self._observer is None or self._room != room:
            kind = PlacementFeatureObserver if self._placement_features else FeatureObserver
            self._observer, self._room = kind(*room, room[1], ()), room
        valid = episode.action_mask()
        seen = self._observer.observe(episode, valid)
        batch = {name: np.asarray(seen[name])[None] for name in FIELDS if name in seen}
        return log_probabilities(self._network, batch, valid[None])[0]

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._file,)


class LearnedShape(_Learned):
    """The shape outside to which a network gives the highest probability: see `_Learned`."""

    stage = Stage.SHAPE


class LearnedRotation(_Learned):
    """The rotation, in the same way."""

    stage = Stage.ROTATION


class LearnedLocation(_Learned):
    """The feasible location, in the same way."""

    stage = Stage.LOCATION


def log_probabilities(
    network: nn.Module, seen: Observation, valid: npt.NDArray[np.bool_]
) -> ActionScores:
    """(b, n) of n actions, -inf for those that are not valid (b, n); seen: arrays, each b first."""
    with torch.inference_mode():
        tensors = {name: torch.as_tensor(array) for name, array in seen.items()}
        logits = network(tensors)[:, : valid.shape[1]]
        return masked(logits, torch.as_tensor(valid)).numpy().astype(np.float64)


def masked(logits: Tensor, valid: Tensor) -> Tensor:
    """Log-softmax over the valid actions, -inf elsewhere."""
    return logits.masked_fill(~valid.bool(), -torch.inf).log_softmax(1)
