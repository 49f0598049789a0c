"""Shape policies that were learned: networks that play episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from packit_agents.heuristics.scores import Scores
from packit_agents.learning.weights import read_weights
from packit_sim.envs.episode import Episode
from packit_sim.envs.observations import FeatureObserver, Observation, ProspectObserver

FIELDS = ("shapes", "box", "outside", "prospects")
"""What networks look at, as far as it is observed."""


class LearnedShape:
    """Chooses the shape outside to which a network gives the highest probability.

    file: of weights. Pickled as that alone. Raises WeightsError where it can't be loaded.
    """

    def __init__(self, file: Path | str) -> None:
        self._file = Path(file)
        self._network, self._prospects, self.made = read_weights(self._file)
        self._observer: FeatureObserver | None = None
        self._room: tuple[Any, ...] = ()

    @classmethod
    def parse(cls, value: str) -> LearnedShape:
        """Of the path of a file of weights, as `packit train` writes them."""
        return cls(value)

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(self.scores(episode, rng).argmax())

    def scores(self, episode: Episode, rng: np.random.Generator) -> Scores:
        room = (episode.box.cells, len(episode.outside))
        if self._observer is None or self._room != room:
            kind = ProspectObserver if self._prospects else FeatureObserver
            self._observer, self._room = kind(*room, room[1], ()), room
        seen = self._observer.observe(episode, episode.outside)
        batch = {name: seen[name][None] for name in FIELDS if name in seen}
        return log_probabilities(self._network, batch)[0]

    def __reduce__(self) -> tuple[Any, ...]:
        return LearnedShape, (self._file,)


def log_probabilities(network: nn.Module, seen: Observation) -> Scores:
    """(b, n) of the shapes, -inf for what is not outside; seen: arrays, each b first."""
    with torch.inference_mode():
        tensors = {name: torch.as_tensor(array) for name, array in seen.items()}
        return masked(network(tensors), tensors["outside"]).numpy().astype(np.float64)


def masked(logits: Tensor, outside: Tensor) -> Tensor:
    """Log-softmax over the shapes outside, -inf elsewhere."""
    return logits.masked_fill(~outside.bool(), -torch.inf).log_softmax(1)
