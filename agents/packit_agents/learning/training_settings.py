"""What a training of PackNN is: settings, from a file and from the command line."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from packit_agents.learning.networks import NetworkSettings
from packit_sim.core.errors import ArgumentError
from packit_sim.rules import PACKIT, Rules


@dataclass(frozen=True)
class TrainingSettings:
    """What a training is; the defaults are the paper's where it tells them, but for the rate.

    network: of the policy, and of the value.
    observation: "features", or "placement-features".
    augmented: shapes are seen turned and mirrored by chance, another way in each episode.
    mixed: share of the tasks that are mixed of two (see `Mixture`).
    packs, split, library: the tasks; packs may be "fresh", the split is then the library's.
    validation_packs, validation: those that say which weights are the best, a dataset and its
        split; without the first a split of the same packs. validation_tasks: the first so many.
    validate_every: steps.
    rules: those that are played.
    steps: choices in all: of shapes, or where `network.policies` is "all" of any kind.
    teacher: name of the agent that is imitated for the first so many steps, `imitation`.
    imitation_epochs: how many minibatches of all lessons so far are gone over after each rollout,
        as a multiple of those that the rollout has.
    regrets: whether regrets are told, not the teacher's choices alone (see `LabellingEnv`).
    imitation_rate: the learning rate at first, where there is a teacher; it falls linearly to
        `learning_rate` meanwhile.
    learning_rate: of PPO at first; it falls linearly to 0 where `annealed`.
    envs, rollout_steps: environments, and steps of each between two updates.
    minibatch, epochs, gamma, gae_lambda, clip, entropy, value: of PPO.
    seed: says all, on one machine.
    """

    network: NetworkSettings = field(default_factory=NetworkSettings)
    observation: Literal["features", "placement-features"] = "features"
    augmented: bool = False
    mixed: float = 0.0
    packs: str = "everyday-v1"
    split: str | None = "train"
    validation_packs: str | None = None
    validation: str | None = "validation"
    library: str = "everyday"
    rules: Rules = PACKIT
    steps: int = 200_000
    teacher: str | None = None
    imitation: int = 0
    imitation_epochs: int = 4
    regrets: bool = False
    imitation_rate: float = 1e-3
    learning_rate: float = 3e-4
    annealed: bool = True
    envs: int = 8
    rollout_steps: int = 64
    minibatch: int = 64
    epochs: int = 4
    gamma: float = 1.0
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy: float = 0.01
    value: float = 0.5
    validate_every: int = 10_000
    validation_tasks: int = 80
    seed: int = 0

    def __post_init__(self) -> None:
        """Raises ValueError that names the setting that is out of range."""
        shapes_alone = self.network.policies == "shape"
        checks = {
            "validation_packs": self.packs != "fresh" or self.validation_packs is not None,
            "mixed": 0 <= self.mixed <= 1 and (self.packs != "fresh" or not self.mixed),
            "observation": self.observation in ("features", "placement-features"),
            "augmented": not self.augmented or shapes_alone,
            "steps": self.steps >= 1,
            "teacher": (self.teacher is None) == (self.imitation == 0),
            "imitation": 0 <= self.imitation <= self.steps,
            "imitation_epochs": self.imitation_epochs >= 1,
            "regrets": not self.regrets or (self.teacher is not None and shapes_alone),
            "imitation_rate": 0 < self.imitation_rate < math.inf,
            "learning_rate": 0 < self.learning_rate < math.inf,
            "envs": self.envs >= 1,
            "rollout_steps": self.rollout_steps >= 2,
            "minibatch": self.minibatch >= 2,
            "epochs": self.epochs >= 1,
            "gamma": 0 <= self.gamma <= 1,
            "gae_lambda": 0 <= self.gae_lambda <= 1,
            "clip": self.clip > 0,
            "entropy": self.entropy >= 0,
            "value": self.value >= 0,
            "validate_every": self.validate_every >= 1,
            "validation_tasks": self.validation_tasks >= 1,
        }
        for name, holds in checks.items():
            if not holds:
                raise ArgumentError(
                    f"training setting {name} = {getattr(self, name)!r} is not possible"
                )

    def rate(self, left: float) -> float:
        """The learning rate where this share of the steps, 1 to 0, is left."""
        made, taught = self.steps * (1 - left), self.imitation
        if made < taught:
            share = made / taught
            return (1 - share) * self.imitation_rate + share * self.learning_rate
        if not self.annealed or taught == self.steps:
            return self.learning_rate
        return self.learning_rate * self.steps * left / (self.steps - taught)


_TABLES: Mapping[str, type] = {"network": NetworkSettings, "rules": Rules}
"""The settings that have settings of their own."""


def read_settings(config: Path | None, changes: Sequence[str]) -> TrainingSettings:
    """Settings from a TOML file, and from NAME=VALUE, which win; names as of the fields.

    Those of the network are `network.width` and so on, and rules are `rules.easy` and so on; in
    TOML these are tables. Raises ArgumentError that names the setting and the valid choices.
    """
    told: dict[str, Any] = {}
    if config is not None:
        try:
            told = _flat(tomllib.loads(config.read_text()))
        except (OSError, ValueError) as error:
            raise ArgumentError(f"settings can't be read from {config}: {error}") from None
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise ArgumentError(f"{change!r} is no setting: give NAME=VALUE, such as steps=100000")
        told[name] = _value(value)
    defaults = _flat(asdict(TrainingSettings()))
    for name in told:
        if name not in defaults:
            raise ArgumentError(f"there is no setting {name!r}: choose from {', '.join(defaults)}")
    parts: dict[str, dict[str, Any]] = {"": {}, **{table: {} for table in _TABLES}}
    for name, value in told.items():
        table, _, short = name.rpartition(".")
        kind = get_type_hints(_TABLES[table] if table else TrainingSettings)[short]
        parts[table][short] = value if table == "rules" else _checked(name, value, kind)
    return TrainingSettings(
        **parts[""],
        network=NetworkSettings(**parts["network"]),
        rules=Rules.from_json(parts["rules"]),
    )


def _flat(told: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a table as TABLE.NAME, after all others."""
    flat = {name: value for name, value in told.items() if name not in _TABLES}
    for table in _TABLES:
        values = told.get(table, {})
        if not isinstance(values, Mapping):
            raise ArgumentError(f"{table} = {values!r} must be a table of settings")
        flat |= {f"{table}.{name}": value for name, value in values.items()}
    return flat


def _value(text: str) -> Any:
    """A number, true, false, or none, else the text itself."""
    words = {"true": True, "false": False, "none": None}
    if text.lower() in words:
        return words[text.lower()]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _checked(name: str, value: Any, kind: Any) -> Any:
    """A value as what the setting is. Raises ArgumentError where it is something else."""
    choices = get_args(kind) or (kind,)
    if get_origin(kind) is Literal:
        if value not in choices:
            raise ArgumentError(
                f"setting {name} = {value!r} is not known: choose from {', '.join(choices)}"
            )
        return value
    if float in choices and type(value) is int:
        return float(value)
    if type(value) not in choices:
        names = " or ".join("none" if c is type(None) else c.__name__ for c in choices)
        raise ArgumentError(f"setting {name} = {value!r} must be of type {names}")
    return value
