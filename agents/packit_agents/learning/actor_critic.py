"""The networks as a policy of sb3-contrib's MaskablePPO."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.distributions import MaskableDistribution
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor

from packit_agents.learning.features_extractor import check_features
from packit_agents.learning.networks import NetworkSettings, network
from packit_agents.learning.weights import write_weights
from packit_sim.core.errors import ArgumentError

_ADAM = {"eps": 1e-5, "fused": True}
"""The settings of stable-baselines3, fused into one kernel."""


class ActorCritic(MaskableActorCriticPolicy):
    """PackNN as policy network and as value network, which share no parameters.

    Every shape is scored by the same weights, so what is learned for one slot holds for all.
    `MaskablePPO(ActorCritic, env)` trains it on an environment that observes features.

    Parameters
    ----------
    observation_space : spaces.Dict
        The observation space of the environment, with features.
    lr_schedule : callable
        The learning rate by the share of the steps that are left.
    settings : NetworkSettings, optional
        Settings of both networks; by default those of the paper.
    **others
        Keyword arguments of the base class.

    Raises
    ------
    ArgumentError
        If the environment does not observe features, or its actions are not those of the network.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        lr_schedule: Schedule,
        *,
        settings: NetworkSettings | None = None,
        **others: Any,
    ) -> None:
        self._settings = settings or NetworkSettings()
        check_features(observation_space, type(self).__name__)
        (slots,) = observation_space["outside"].shape or ()
        if self._settings.policies == "shape" and action_space.n != slots:
            raise ArgumentError(
                f"a network that chooses one of {slots} shapes can't play an environment with "
                f"{action_space.n} actions: give the environment a rotation and a location policy, "
                "such as 'aligned' and 'blbf', or the network the setting policies='all'"
            )
        if "optimizer_class" not in others:
            others.setdefault("optimizer_kwargs", _ADAM)
        super().__init__(observation_space, action_space, lr_schedule, **others)

    def write_weights(self, path: Path | str, provenance: Mapping[str, Any] | None = None) -> None:
        """Write the policy network as weights, which `learned@PATH` plays with.

        Parameters
        ----------
        path : Path or str
            The file, usually with the suffix .safetensors.
        provenance : mapping, optional
            The record of its training, in JSON's types.
        """
        write_weights(
            Path(path), self.actor, self._settings, self.placement_features, provenance or {}
        )

    @property
    def placement_features(self) -> int:
        """Number of placement features of each shape, 0 if they are not observed."""
        assert isinstance(self.observation_space, spaces.Dict)
        observed = self.observation_space.spaces.get("placement_features")
        return 0 if observed is None or observed.shape is None else observed.shape[1]

    def _build(self, lr_schedule: Any) -> None:
        self.actor = network(self._settings, self.placement_features)
        self.critic = network(self._settings, self.placement_features, value=True)
        self.optimizer = self.optimizer_class(
            self.parameters(),
            lr=lr_schedule(1),  # type: ignore[call-arg]
            **self.optimizer_kwargs,
        )

    def forward(
        self, obs: Any, deterministic: bool = False, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        distribution = self.get_distribution(obs, action_masks)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, self.predict_values(obs), distribution.log_prob(actions)

    def evaluate_actions(
        self, obs: Any, actions: Tensor, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        distribution = self.get_distribution(obs, action_masks)
        return self.predict_values(obs), distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: Any, action_masks: Any = None) -> MaskableDistribution:
        logits = self.actor(self._fields(obs))
        distribution = self.action_dist.proba_distribution(action_logits=logits)
        if action_masks is not None:
            distribution.apply_masking(action_masks)
        return distribution

    def predict_values(self, obs: Any) -> Tensor:
        values: Tensor = self.critic(self._fields(obs))
        return values

    def _fields(self, obs: Any) -> dict[str, Tensor]:
        """Observation fields as the networks take them: discrete ones (b,), others as floats."""
        assert isinstance(self.observation_space, spaces.Dict)
        return {
            name: obs[name].long().flatten()
            if isinstance(space, spaces.Discrete)
            else obs[name].float()
            for name, space in self.observation_space.spaces.items()
        }

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "settings": self._settings}


def on_device(name: str) -> torch.device:
    """Return the device of this name; for "auto" the GPU if there is one, else the CPU."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (AssertionError, NotImplementedError, RuntimeError) as error:  # as torch reports it
        why = str(error).partition("\n")[0]
        raise ArgumentError(
            f"device {name!r} can't be used: {why}: choose cpu, cuda or auto"
        ) from error
    return device
