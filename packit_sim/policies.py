"""What an agent is: three policies, one for each sub-task, found by name.

The policies themselves are in other packages, which announce them as entry points; `packit_agents`,
which comes with this one, does so like any other.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Protocol

import numpy as np

from packit_sim.episode import Episode, Stage
from packit_sim.errors import PackItError


class Policy(Protocol):
    """Chooses the next action of one sub-task.

    Called with the episode, which it must not change, and the random generator to draw from.
    A shape policy returns the index of a shape outside, a rotation policy 0 to 23, a location
    policy the C-order index of a feasible location.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int: ...


class UnknownPolicyError(PackItError, ValueError):
    """A policy name that no installed package announces."""


@dataclass(frozen=True)
class Agent:
    """Three policies that play an episode together. name: "shape/rotation/location"."""

    name: str
    shape: Policy
    rotation: Policy
    location: Policy

    @classmethod
    def from_name(cls, name: str) -> Agent:
        """An agent by its policies' names, such as "largest-first/aligned/blbf".

        Raises UnknownPolicyError that lists the valid ones.
        """
        parts = name.split("/")
        if len(parts) != len(Stage):
            raise UnknownPolicyError(
                f"agent {name!r} is not of the form shape/rotation/location, "
                "such as largest-first/aligned/blbf"
            )
        policies = [load_policy(stage, part) for stage, part in zip(Stage, parts, strict=True)]
        return cls(name, *policies)

    def act(self, episode: Episode, rng: np.random.Generator) -> int:
        """The action for the episode's stage."""
        policy = (self.shape, self.rotation, self.location)[episode.stage]
        return policy(episode, rng)


def policy_names(stage: Stage) -> tuple[str, ...]:
    """The installed policies for a sub-task."""
    return tuple(sorted(entry_points(group=_group(stage)).names))


def _group(stage: Stage) -> str:
    return f"packit_sim.{stage.name.lower()}_policies"


def load_policy(stage: Stage, name: str) -> Policy:
    """The policy of this name for a sub-task. Raises UnknownPolicyError that lists the names."""
    found = entry_points(group=_group(stage), name=name)
    if not found:
        raise UnknownPolicyError(
            f"there is no {stage.name.lower()} policy {name!r}: "
            f"choose from {', '.join(policy_names(stage))}"
        )
    policy: Policy = next(iter(found)).load()()
    return policy


def _solution_shape(episode: Episode, rng: np.random.Generator) -> int:
    for shape, _, _ in episode.task.solution:
        if episode.outside[shape]:
            return shape
    raise PackItError("the task has no solution that could be played")


def _solution_rotation(episode: Episode, rng: np.random.Generator) -> int:
    return next(r for shape, r, _ in episode.task.solution if shape == episode.shape)


def _solution_location(episode: Episode, rng: np.random.Generator) -> int:
    location = next(at for shape, _, at in episode.task.solution if shape == episode.shape)
    return int(np.ravel_multi_index(location, episode.box.nodes))


GROUND_TRUTH = Agent("ground-truth", _solution_shape, _solution_rotation, _solution_location)
"""Plays the pack that a task was made of, item by item, by the rules of PackIt or PackIt-Easy."""
