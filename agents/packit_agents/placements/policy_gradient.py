"""Training of a `PlacementNetwork` by policy gradient, with torch.

Group-relative policy optimisation (Shao et al., 2024): each task is played several times. The
difference between the return of a play and the mean of its group is the advantage of all its
decisions. The ratio of probabilities is clipped as in PPO (Schulman et al., 2017). No value network
is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from packit_agents.placements.network import LAYERS, PlacementNetwork
from packit_agents.placements.playing import MAX_PLACEMENTS, Play


@dataclass(frozen=True)
class StepSettings:
    """The settings of one step of learning from plays.

    Attributes
    ----------
    learning_rate : float
        The learning rate of Adam in the first round; it falls linearly to 0 after the last.
    epochs : int
        The number of passes over the decisions.
    minibatch : int
        Decisions in a step.
    clip : float
        The maximum deviation of the ratio of probabilities from 1.
    """

    learning_rate: float = 6e-3
    epochs: int = 3
    minibatch: int = 512
    clip: float = 0.2


class _Network(nn.Module):
    """The same as `PlacementNetwork`, for the placements of several states."""

    def __init__(self, network: PlacementNetwork) -> None:
        super().__init__()
        self.tensors = nn.ParameterDict(
            {
                name.replace(".", "_"): nn.Parameter(torch.tensor(tensor))
                for name, tensor in network.tensors.items()
            }
        )
        for name in ("mean", "scale"):
            self.tensors[name].requires_grad_(False)

    def forward(self, features: Tensor, valid: Tensor) -> Tensor:
        """Compute log-probabilities (states, n) of placements (states, n, features)."""
        t = self.tensors
        hidden = scaled = (features - t["mean"]) / t["scale"]
        for layer in LAYERS:
            hidden = torch.relu(hidden @ t[f"{layer}_weight"].T + t[f"{layer}_bias"])
        scores = (hidden @ t["score_weight"].T + scaled @ t["linear_weight"].T)[..., 0]
        return scores.masked_fill(~valid, -torch.inf).log_softmax(1)


def improve(
    network: PlacementNetwork,
    groups: Sequence[Sequence[Play]],
    settings: StepSettings,
    seed: int,
    rate: float = 1.0,
) -> PlacementNetwork:
    """Make the decisions of better plays more probable.

    Parameters
    ----------
    network : PlacementNetwork
        The network that drew the placements.
    groups : sequence of sequence of Play
        The plays of each task.
    settings : StepSettings
        The settings of learning.
    seed : int
        Seed of the order of the decisions.
    rate : float, optional
        Factor of the learning rate.

    Returns
    -------
    PlacementNetwork
        The improved network; the same one if all plays of each task are equally good.
    """
    advantages, decisions = [], []
    for group in groups:
        totals = np.array([play.total for play in group])
        for play, advantage in zip(group, relative(totals), strict=True):
            decisions += play.decisions
            advantages += [advantage] * len(play.decisions)
    gain = np.array(advantages, dtype=np.float32)
    gain /= gain.std() + 1e-6
    kept = np.flatnonzero(gain)
    if len(kept) == 0:
        return network
    model = _Network(network)
    trained = [parameter for parameter in model.parameters() if parameter.requires_grad]
    optimizer = torch.optim.Adam(trained, rate * settings.learning_rate)
    rng = np.random.default_rng(seed)
    features, valid = _padded([decisions[n].features for n in kept.tolist()])
    chosen = torch.tensor([decisions[n].chosen for n in kept.tolist()])
    gains = torch.tensor(gain[kept])
    with torch.no_grad():
        before = _chosen(model, features, valid, chosen)
    for _ in range(settings.epochs):
        order = torch.tensor(rng.permutation(len(kept)))
        for part in torch.split(order, settings.minibatch):
            after = _chosen(model, features[part], valid[part], chosen[part])
            ratio = torch.exp(after - before[part])
            clipped = ratio.clamp(1 - settings.clip, 1 + settings.clip)
            loss = -torch.minimum(ratio * gains[part], clipped * gains[part]).mean()
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(trained, 1.0)
            optimizer.step()
    tensors = {
        name: model.tensors[name.replace(".", "_")].detach().numpy().copy()
        for name in network.tensors
    }
    return PlacementNetwork(tensors, network.provenance)


def relative(totals: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Compute how much better each play of a group is than their mean."""
    return totals - totals.mean()


def _chosen(model: _Network, features: Tensor, valid: Tensor, chosen: Tensor) -> Tensor:
    """Compute the log-probabilities of the chosen placements."""
    found: Tensor = model(features, valid).gather(1, chosen[:, None])[:, 0]
    return found


def _padded(all_features: list[npt.NDArray[np.float32]]) -> tuple[Tensor, Tensor]:
    features = np.zeros((len(all_features), MAX_PLACEMENTS, all_features[0].shape[1]), np.float32)
    valid = np.zeros(features.shape[:2], dtype=bool)
    for n, own in enumerate(all_features):
        features[n, : len(own)] = own
        valid[n, : len(own)] = True
    return torch.tensor(features), torch.tensor(valid)
