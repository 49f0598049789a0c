"""Policies of stable-baselines3 as weights without code, with what rebuilds them.

A model's own file (`model.save`) holds pickles, which run code when they are read. Here the tensors
are safetensors, and the metadata names the classes, which must be known ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from msgspec import Meta, Struct
from safetensors.torch import save
from sb3_contrib.common.maskable.policies import (
    MaskableActorCriticPolicy,
    MaskableMultiInputActorCriticPolicy,
)
from stable_baselines3.common.policies import (
    ActorCriticPolicy,
    BasePolicy,
    MultiInputActorCriticPolicy,
)
from stable_baselines3.common.torch_layers import CombinedExtractor, FlattenExtractor
from stable_baselines3.dqn.policies import DQNPolicy
from stable_baselines3.dqn.policies import MultiInputPolicy as MultiInputDQNPolicy
from torch import Tensor, nn

from packit_agents.learning.features_extractor import ShapeSetExtractor
from packit_agents.learning.weights import SB3_FORMAT, WeightsError, check_shapes
from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError
from packit_sim.core.files import replacing
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.observations import (
    OBSERVERS,
    Observation,
    value_shares,
    with_values,
)
from packit_sim.game.envs.wrappers import MAX_FLAT
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.geometry.lattice import Triple, box_cells

_POLICIES: dict[str, type[BasePolicy]] = {
    "ActorCriticPolicy": ActorCriticPolicy,
    "MultiInputActorCriticPolicy": MultiInputActorCriticPolicy,
    "MaskableActorCriticPolicy": MaskableActorCriticPolicy,
    "MaskableMultiInputActorCriticPolicy": MaskableMultiInputActorCriticPolicy,
    "DQNPolicy": DQNPolicy,
    "MultiInputDQNPolicy": MultiInputDQNPolicy,
}
"""Those of PPO, A2C, MaskablePPO and DQN."""

_EXTRACTORS = {
    kind.__name__: kind for kind in (CombinedExtractor, FlattenExtractor, ShapeSetExtractor)
}
_ACTIVATIONS = {kind.__name__: kind for kind in (nn.Tanh, nn.ReLU, nn.ELU, nn.LeakyReLU, nn.GELU)}

_Width = Annotated[int, Meta(ge=1, le=4096)]
_Layers = list[_Width]


class PolicyRecord(Struct, frozen=True, forbid_unknown_fields=True):
    """What rebuilds a policy, and the observations that it was trained on.

    Attributes
    ----------
    plays : tuple of str
        The sub-tasks that it chooses.
    observed : tuple of str
        The sub-tasks whose choices it observes.
    masked, flat : bool
        Whether it observes the action mask, and one vector instead of a dict.
    layers : list or dict
        The widths of its layers (`net_arch`).
    valued : bool
        Whether it observes the values of the items.
    provenance : dict
        The record of its training.
    """

    policy: str
    observation: Literal["features", "placement-features", "heightmap", "none"]
    cells: Triple
    max_shapes: Annotated[int, Meta(ge=1, le=1000)]
    actions: Annotated[int, Meta(ge=1, le=2**21)]
    plays: tuple[Literal["shape", "rotation", "location"], ...]
    observed: tuple[Literal["rotation", "location"], ...]
    masked: bool
    flat: bool
    layers: _Layers | dict[Literal["pi", "vf"], _Layers]
    activation: str
    extractor: str
    extractor_settings: dict[str, _Width]
    valued: bool = False
    provenance: dict[str, Any] = {}


def write_policy(
    path: Path | str,
    policy: BasePolicy,
    env: gym.Env[Any, Any],
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write a policy of stable-baselines3 as weights, which `learned@PATH` plays with.

    Parameters
    ----------
    path : Path or str
        The file, usually with the suffix .safetensors.
    policy : BasePolicy
        The policy, `model.policy`, of PPO, A2C, MaskablePPO or DQN, with its usual classes and
        extractors, or `ShapeSetExtractor`.
    env : gym.Env
        An environment like those of the training, with the same wrappers.
    provenance : mapping, optional
        The record of its training, in JSON's types.

    Raises
    ------
    ArgumentError
        If the policy was trained on other observations or actions, or has other classes.
    """
    bare = env.unwrapped
    if not isinstance(bare, PackItEnv):
        raise ArgumentError(f"{bare} is not an environment of PackIt-Sim")
    for what in ("observation", "action"):
        ours, theirs = (getattr(one, f"{what}_space") for one in (env, policy))
        if ours != theirs:
            raise ArgumentError(
                f"the policy has the {what} space {theirs}, the environment {ours}: give one like "
                "those of the training, with the same wrappers"
            )
    settings = policy._get_constructor_parameters()
    observer = bare.observer
    names = [stage.name.lower() for stage in bare.plays]
    record = PolicyRecord(
        policy=_name(_POLICIES, type(policy), "policies"),
        observation=_name(OBSERVERS, type(observer), "observations"),  # type: ignore[arg-type]
        cells=observer.cells,
        max_shapes=observer.max_shapes,
        actions=int(bare.action_space.n),
        plays=tuple(names),  # type: ignore[arg-type]
        observed=tuple(stage.name.lower() for stage in observer.stages),  # type: ignore[misc]
        masked=isinstance(env.observation_space, spaces.Dict)
        and "action_mask" in env.observation_space.spaces,
        flat=not isinstance(env.observation_space, spaces.Dict),
        valued=bare.rules.values,
        layers=settings["net_arch"],
        activation=_name(_ACTIVATIONS, settings["activation_fn"], "activations"),
        extractor=_name(_EXTRACTORS, settings["features_extractor_class"], "extractors"),
        extractor_settings=settings["features_extractor_kwargs"],
        provenance=dict(provenance or {}),
    )
    text = typed_json.encode(record)
    typed_json.decode(text, PolicyRecord, ArgumentError, "the policy")  # its layers are of numbers
    rebuilt = Sb3Network(record)
    tensors = _parameters(policy)
    check_shapes(tensors, _parameters(rebuilt.policy), ArgumentError)
    with replacing(Path(path)) as file:
        file.write(save(tensors, {"format": SB3_FORMAT, "version": "1", "record": text}))


def read_policy(
    path: Path, metadata: Mapping[str, str], tensors: Mapping[str, Tensor]
) -> Sb3Network:
    """Rebuild a policy from a file's metadata and tensors.

    Returns
    -------
    Sb3Network
        The policy.

    Raises
    ------
    WeightsError
        If it is of another version, or the metadata and the tensors contradict each other.
    """
    if metadata.get("version") != "1":
        raise WeightsError(f"{path} is of version {metadata.get('version')!r}: this one reads '1'")
    record = typed_json.decode(
        metadata.get("record", ""), PolicyRecord, WeightsError, "the record of the policy"
    )
    try:
        numbers = sum(tensor.numel() for tensor in tensors.values())
        network = Sb3Network(record, max_numbers=numbers)
        check_shapes(tensors, _parameters(network.policy), ValueError)
        network.policy.load_state_dict(dict(tensors), strict=False)
    except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError) as error:
        raise WeightsError(f"{path} contradicts its own metadata: {error}") from None
    return network


class Sb3Network:
    """A policy of stable-baselines3 that scores the actions of an episode.

    Parameters
    ----------
    record : PolicyRecord
        What rebuilds it, with new weights.
    max_numbers : int, optional
        The most numbers that its layers may have, checked before they are built.
    """

    def __init__(self, record: PolicyRecord, max_numbers: int | None = None) -> None:
        self.record = record
        if (size := 2 * record.max_shapes * max(record.cells) ** 2) > MAX_FLAT:
            raise ValueError(f"heightmaps of {size:,} numbers: at most {MAX_FLAT:,} are possible")
        stages = [Stage[name.upper()] for name in record.observed]
        observer = OBSERVERS[record.observation](
            box_cells(record.cells), record.max_shapes, record.actions, stages
        )
        self._observer = observer
        seen = observer.space
        fields = dict((with_values(seen, record.max_shapes) if record.valued else seen).spaces)
        if record.flat or not record.masked:
            del fields["action_mask"]
        self._fields = spaces.Dict(fields)
        if max_numbers is not None and self._layer_numbers() > max_numbers:
            raise ValueError(f"its layers have more numbers than its tensors, {max_numbers:,}")
        space: spaces.Space[Any] = self._fields
        if record.flat:
            space = spaces.Box(-np.inf, np.inf, (spaces.flatdim(self._fields),), np.float32)
        kind = _known(_POLICIES, record.policy)
        self.policy = kind(
            space,
            spaces.Discrete(record.actions),
            lambda _: 0.0,
            net_arch=record.layers,
            activation_fn=_known(_ACTIVATIONS, record.activation),
            features_extractor_class=_known(_EXTRACTORS, record.extractor),
            features_extractor_kwargs=dict(record.extractor_settings),
            **({} if issubclass(kind, DQNPolicy) else {"ortho_init": False}),
        )
        self.policy.set_training_mode(False)

    def plays(self, stage: Stage) -> bool:
        """Return whether it chooses in a sub-task."""
        return stage.name.lower() in self.record.plays

    def logits(self, episode: Episode) -> Tensor:
        """Score the actions of the episode's stage, float32 (1, actions)."""
        record, count = self.record, len(episode.outside)
        if episode.box.cells != record.cells or count > record.max_shapes:
            raise WeightsError(
                f"the policy plays in boxes of {record.cells} cells with at most "
                f"{record.max_shapes} items, not {episode.box.cells} with {count}"
            )
        if record.valued and not episode.task.values:
            raise WeightsError("the policy observes values, which the items of the task don't have")
        valid = np.zeros(record.actions, dtype=bool)
        mask = episode.action_mask()
        valid[: len(mask)] = mask
        observed = self._observer.observe(episode, valid)
        if record.valued:
            observed["values"] = value_shares(episode, record.max_shapes)
        observation = self._seen(observed)
        with torch.inference_mode():
            batch, _ = self.policy.obs_to_tensor(observation)
            if isinstance(self.policy, DQNPolicy):
                values: Tensor = self.policy.q_net(batch)
                return values
            distribution: Any = self.policy.get_distribution(batch).distribution
            return distribution.logits

    def _layer_numbers(self) -> int:
        """Count the weights of the layers after the extractor, for the policy and the value."""
        record, own = self.record, self.record.extractor_settings
        if record.extractor == ShapeSetExtractor.__name__:
            features = record.max_shapes * own.get("shape_features", 1) + own.get("width", 1)
        else:
            features = spaces.flatdim(self._fields)
        chains = record.layers.values() if isinstance(record.layers, dict) else [record.layers]
        return sum(a * b for chain in chains for a, b in pairwise([features, *chain]))

    def _seen(self, observation: Observation) -> Any:
        seen = {name: observation[name] for name in self._fields.spaces}
        if self.record.flat:
            return np.asarray(spaces.flatten(self._fields, seen), dtype=np.float32)
        return seen


def _parameters(policy: BasePolicy) -> dict[str, Tensor]:
    """Return the parameters, each once: `state_dict` lists shared extractors three times."""
    return {name: one.detach().cpu().contiguous() for name, one in policy.named_parameters()}


def _name(known: Mapping[str, Any], kind: Any, what: str) -> str:
    found = next((name for name, one in known.items() if one is kind), None)
    if found is None:
        raise ArgumentError(
            f"{kind.__name__} can't be written as weights: the known {what} are {', '.join(known)}"
        )
    return found


def _known(known: Mapping[str, Any], name: str) -> Any:
    if name not in known:
        raise LookupError(f"{name!r} is not known: choose from {', '.join(known)}")
    return known[name]
