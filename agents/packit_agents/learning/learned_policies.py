"""Learned policies: networks that choose actions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from packit_agents.heuristics.action_scores import ActionScores
from packit_agents.learning.networks import AllPolicies
from packit_agents.learning.weights import (
    SB3_FORMAT,
    WeightsError,
    network_of,
    read_tensors,
    weights_digest,
)
from packit_sim.core.files import digest_of
from packit_sim.game.envs.observations import FeatureObserver, Observation, PlacementFeatureObserver
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.geometry.lattice import BOX_CELLS

if TYPE_CHECKING:  # stable-baselines3 is loaded when a file needs it
    from packit_agents.learning.sb3_weights import Sb3Network

SHAPE_FIELDS = ("shapes", "box", "outside", "placement_features")
"""Observation fields of networks that choose shapes, if they are observed."""

FIELDS = (*SHAPE_FIELDS, "stage", "chosen", "item")
"""Observation fields of networks that also choose rotations and locations."""


class _Learned:
    """The most probable action of a network; pickled as the path of its weights."""

    stage: ClassVar[Stage]

    def __init__(self, file: Path | str) -> None:
        self._file = Path(file)
        metadata, tensors = read_tensors(self._file)
        self._sb3: Sb3Network | None = None
        if metadata.get("format") == SB3_FORMAT:
            self._begin_sb3(metadata, tensors)
            return
        self._network, self._placement_features, self.provenance = network_of(
            self._file, metadata, tensors
        )
        self.weights_digest = weights_digest(self._network)
        self.former_weights_digest = digest_of(self._file)[:16]
        if self.stage is not Stage.SHAPE and not isinstance(self._network, AllPolicies):
            raise WeightsError(
                f"{self._file} chooses shapes, not {self.stage.name.lower()}s: it was trained with "
                "network.policies=shape"
            )
        self._observer: FeatureObserver | None = None
        self._sizes: tuple[Any, ...] = ()

    @classmethod
    def parse(cls, value: str) -> Self:
        """Load the weights of a file that `packit train` or `write_policy` wrote.

        Parameters
        ----------
        value : str
            Path of the file.

        Returns
        -------
        Self
            The policy.

        Raises
        ------
        WeightsError
            If the file can't be loaded, or its network does not make this choice.
        """
        return cls(value)

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return int(self.scores(episode, rng).argmax())

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        if self._sb3 is not None:
            valid = episode.action_mask()
            logits = self._sb3.logits(episode)[:, : len(valid)]
            return masked(logits, torch.as_tensor(valid)[None]).numpy().astype(np.float64)[0]
        cells = episode.box.cells
        if isinstance(self._network, AllPolicies) and cells != BOX_CELLS:
            raise WeightsError(f"{self._file} plays in boxes of {BOX_CELLS} cells, not {cells}")
        sizes = (cells, len(episode.outside))
        if self._observer is None or self._sizes != sizes:
            kind = PlacementFeatureObserver if self._placement_features else FeatureObserver
            self._observer, self._sizes = kind(*sizes, sizes[1], ()), sizes
        valid = episode.action_mask()
        observation = self._observer.observe(episode, valid)
        names = [name for name in FIELDS if name in observation]
        batch = {name: np.asarray(observation[name])[None] for name in names}
        return log_probabilities(self._network, batch, valid[None])[0]

    def _begin_sb3(self, metadata: dict[str, str], tensors: dict[str, Tensor]) -> None:
        """Play with a policy of stable-baselines3."""
        from packit_agents.learning.sb3_weights import read_policy

        self._sb3 = read_policy(self._file, metadata, tensors)
        record = self._sb3.record
        if not self._sb3.plays(self.stage):
            raise WeightsError(
                f"{self._file} chooses {', '.join(record.plays)}, not {self.stage.name.lower()}s"
            )
        self.provenance = record.provenance
        self.weights_digest = weights_digest(self._sb3.policy)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._file,)


class LearnedShape(_Learned):
    """The shape outside the box to which a network assigns the highest probability."""

    stage = Stage.SHAPE


class LearnedRotation(_Learned):
    """The rotation to which a network assigns the highest probability."""

    stage = Stage.ROTATION


class LearnedLocation(_Learned):
    """The feasible location to which a network assigns the highest probability."""

    stage = Stage.LOCATION


def log_probabilities(
    network: nn.Module, observations: Observation, valid: npt.NDArray[np.bool_]
) -> ActionScores:
    """Compute log-probabilities of the actions.

    Parameters
    ----------
    observations : dict of ndarray
        Observation fields (b, ...).
    valid : ndarray
        bool (b, n), the valid actions.

    Returns
    -------
    ActionScores
        float64 (b, n), -inf for actions that are not valid.
    """
    with torch.inference_mode():
        tensors = {name: torch.as_tensor(array) for name, array in observations.items()}
        logits = network(tensors)[:, : valid.shape[1]]
        return masked(logits, torch.as_tensor(valid)).numpy().astype(np.float64)


def masked(logits: Tensor, valid: Tensor) -> Tensor:
    """Return the log-softmax over the valid actions, -inf elsewhere."""
    return logits.masked_fill(~valid.bool(), -torch.inf).log_softmax(1)
