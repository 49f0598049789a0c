"""Settings of a training, from a TOML file and the command line."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from packit_agents.learning.networks import NetworkSettings
from packit_sim.core import typed_json
from packit_sim.core.checks import POSITIVE, Range, check_settings
from packit_sim.core.errors import ArgumentError
from packit_sim.rules import PACKIT, Rules

Observed = Literal["features", "placement-features"]

OBSERVATIONS: tuple[str, ...] = get_args(Observed)


@dataclass(frozen=True)
class TrainingSettings:
    """Everything that determines the result of a training.

    The defaults are the paper's where the paper states them, except for the learning rate.

    Attributes
    ----------
    network : NetworkSettings
        The policy and value networks.
    observation : {"features", "placement-features"}
        The observation of the network.
    augmented : bool
        Whether shapes are rotated and mirrored at random, differently in each episode.
    mixed : float
        Share of the tasks that are mixed from the items of two tasks (see `Mixture`).
    packs : str
        Name or path of the training packs, or "fresh" for tasks generated on the fly.
    split : str, optional
        Split of the packs; for fresh tasks, of the library.
    validation_packs : str, optional
        Packs by which the best weights are chosen; None takes another split of `packs`.
    validation : str, optional
        Split of the validation packs.
    library : str
        Name or path of the shape library.
    rules : Rules
        The rules of the episodes.
    steps : int
        Number of decisions: of shapes, or with `network.policies = "all"` of any kind.
    teacher : str, optional
        Name of the agent that is imitated at first.
    imitation : int
        Number of first steps during which the teacher is imitated.
    imitation_epochs : int
        Minibatches drawn from the DAgger dataset after each rollout, as a multiple of those that
        the rollout holds.
    costs : bool
        Whether the labels are the costs of all shapes, instead of the teacher's choice alone (see
        `LabellingEnv`).
    imitation_rate : float
        Initial learning rate if there is a teacher; it decreases linearly to `learning_rate`
        while the teacher is imitated.
    learning_rate : float
        Initial learning rate of PPO.
    annealed : bool
        Whether the learning rate of PPO decreases linearly to 0.
    envs : int
        Number of environments.
    rollout_steps : int
        Steps of each environment between two updates.
    minibatch, epochs, gamma, gae_lambda, clip, entropy, value
        Hyperparameters of PPO.
    validate_every : int
        Steps between two validations.
    validation_tasks : int
        Number of validation tasks, the first of their packs.
    seed : int
        Seed of all random numbers; it makes runs reproducible on one machine.

    Raises
    ------
    ArgumentError
        If a setting is out of range; the message names it.
    """

    network: NetworkSettings = field(default_factory=NetworkSettings)
    observation: Observed = "features"
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
    costs: bool = False
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
        only_shapes = self.network.policies == "shape"
        fresh = self.packs == "fresh"
        check_settings(
            self,
            "training setting",
            validation_packs=(
                not fresh or self.validation_packs is not None,
                "fresh tasks need it",
            ),
            mixed=(self.mixed == 0, "0 for fresh tasks") if fresh else Range(0, 1),
            observation=(
                self.observation in OBSERVATIONS,
                f"choose from {', '.join(OBSERVATIONS)}",
            ),
            augmented=(not self.augmented or only_shapes, 'only with network.policies = "shape"'),
            steps=Range(1),
            teacher=(
                (self.teacher is None) == (self.imitation == 0),
                "a name with imitation above 0, or none with 0",
            ),
            imitation=Range(0, self.steps),
            imitation_epochs=Range(1),
            costs=(
                not self.costs or (self.teacher is not None and only_shapes),
                'only with a teacher and network.policies = "shape"',
            ),
            imitation_rate=POSITIVE,
            learning_rate=POSITIVE,
            envs=Range(1),
            rollout_steps=Range(2),
            minibatch=Range(2),
            epochs=Range(1),
            gamma=Range(0, 1),
            gae_lambda=Range(0, 1),
            clip=Range(0, ends="(]"),
            entropy=Range(0),
            value=Range(0),
            validate_every=Range(1),
            validation_tasks=Range(1),
        )

    def rate(self, left: float) -> float:
        """Compute the learning rate.

        Parameters
        ----------
        left : float
            Share of the steps that are left, from 1 to 0.

        Returns
        -------
        float
            The learning rate at that step.
        """
        done, imitated = self.steps * (1 - left), self.imitation
        if done < imitated:
            share = done / imitated
            return (1 - share) * self.imitation_rate + share * self.learning_rate
        if not self.annealed or imitated == self.steps:
            return self.learning_rate
        return self.learning_rate * self.steps * left / (self.steps - imitated)


def read_settings(config: Path | None, changes: Sequence[str]) -> TrainingSettings:
    """Read settings from a file and from the command line.

    Parameters
    ----------
    config : Path, optional
        A TOML file with the names of the fields; `network` and `rules` are tables.
    changes : sequence of str
        Settings as NAME=VALUE, which take precedence over the file; settings of a table are
        TABLE.NAME, such as `network.width`.

    Returns
    -------
    TrainingSettings
        The settings; those that are not given keep their defaults.

    Raises
    ------
    ArgumentError
        If the file can't be read, or a setting does not exist or is not valid; the message names
        the setting and the valid choices.
    """
    values: dict[str, Any] = {}
    if config is not None:
        try:
            values = tomllib.loads(config.read_text(encoding="utf-8-sig"))
        except (OSError, ValueError, RecursionError) as error:
            raise ArgumentError(f"settings can't be read from {config}: {error}") from None
    for change in changes:
        name, equals, text = change.partition("=")
        if not equals:
            raise ArgumentError(
                f"{change!r} is not a setting: give NAME=VALUE, such as steps=100000"
            )
        table, _, key = name.rpartition(".")
        target = values.setdefault(table, {}) if table else values
        if not isinstance(target, dict):
            raise ArgumentError(f"{table} = {target!r} must be a table of settings")
        target[key] = _value(text)
    typed_json.check_names(values, TrainingSettings, ArgumentError)
    if isinstance(values.get("rules"), dict):
        values["rules"] = Rules.from_json(values["rules"])
    return typed_json.convert(values, TrainingSettings, ArgumentError, "a file of settings")


def _value(text: str) -> Any:
    """Parse a value of TOML; "none" is None, and anything else is the text itself."""
    if text.lower() == "none":
        return None
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        return {"true": True, "false": False}.get(text.lower(), text)
