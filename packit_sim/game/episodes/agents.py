"""Agents: three policies, one for each sub-task, and optionally a search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.game.episodes.episode import Episode, Stage, stages
from packit_sim.game.episodes.policies import Policy
from packit_sim.game.episodes.policy_registry import (
    UnknownPolicyError,
    load_policy,
    load_search,
    policy_names,
)
from packit_sim.geometry.items import PlacedItem
from packit_sim.rules import Rules

OnProgress = Callable[[int, float], None]
"""Function that a search calls with the number of its rollouts so far and their best return."""


class Search(Protocol):
    """A planner: it plays ahead with the model of the game, guided by an agent's policies.

    Notes
    -----
    A search knows all items of the episode that it gets. So it never gets an online one:
    `Agent.play` gives it the visible items alone, before each choice of a shape.
    """

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        """Play an episode from a choice of a shape, and leave it at the best end that was found.

        Parameters
        ----------
        agent : Agent
            The agent that the search belongs to.
        on_progress : OnProgress
            Called after each rollout.
        """
        ...


@dataclass(frozen=True)
class Agent:
    """Three policies that play an episode together, and the search that plans with them, if any.

    Parameters
    ----------
    name : str
        "shape/rotation/location", or "shape/rotation/location+search=value".
    search : Search, optional
        The search; by default the policies play alone.

    Examples
    --------
    >>> from packit_sim import Agent
    >>> Agent.from_name("largest-first/aligned/blbf").search is None
    True
    >>> Agent.from_name("largest-first/aligned/blbf+beam=2").search is None
    False
    >>> Agent.from_name("largest-first/aligned")
    Traceback (most recent call last):
        ...
    packit_sim...UnknownPolicyError: agent 'largest-first/aligned' is not of the form ...
    """

    name: str
    shape: Policy
    rotation: Policy
    location: Policy
    search: Search | None = None

    @classmethod
    def from_name(cls, name: str) -> Agent:
        """Create an agent from the names of its parts.

        Parameters
        ----------
        name : str
            The name, such as "largest-first/aligned/blbf" or "largest-first/aligned/blbf+beam=4". A
            single name, such as "champion" or "best-fit", is that of all three policies.

        Returns
        -------
        Agent
            The agent.

        Raises
        ------
        UnknownPolicyError
            If a part is not known. The message lists the valid ones.
        """
        policies, *search = name.split("+")
        parts = _parts(policies)
        if not _are_known(parts) and _are_known([policies] * len(Stage)):
            parts = [policies] * len(Stage)
        if len(parts) != len(Stage) or len(search) > 1:
            raise UnknownPolicyError(
                f"agent {name!r} is not of the form shape/rotation/location or "
                "shape/rotation/location+search=value, such as largest-first/aligned/blbf+beam=4"
            )
        shape, rotation, location = (
            load_policy(stage, part) for stage, part in zip(Stage, parts, strict=True)
        )
        return cls(name, shape, rotation, location, load_search(search[0]) if search else None)

    @property
    def weights(self) -> str | None:
        """The digests of its policies' weights; None if no policy has weights."""
        return self._digests("weights_digest")

    @property
    def known_weights(self) -> tuple[str | None, ...]:
        """`weights`, and what former versions recorded for the same weights."""
        return self.weights, self._digests("former_weights_digest")

    def _digests(self, attribute: str) -> str | None:
        policies = (self.shape, self.rotation, self.location)
        digests = dict.fromkeys(getattr(policy, attribute, None) for policy in policies)
        return " ".join(digest for digest in digests if digest is not None) or None

    def policy(self, stage: Stage) -> Policy:
        """Return the policy of a sub-task."""
        return (self.shape, self.rotation, self.location)[stage]

    def act(self, episode: Episode, rng: np.random.Generator) -> int:
        """Choose the action for the episode's stage by the policy, without the search."""
        return self.policy(episode.stage)(episode, rng)

    def play(
        self,
        episode: Episode,
        rng: np.random.Generator,
        on_progress: OnProgress = lambda rollouts, best: None,
    ) -> None:
        """Play an episode to its end.

        Parameters
        ----------
        on_progress : OnProgress
            Called by the search, if there is one.

        Raises
        ------
        ArgumentError
            If a search is to plan an online episode with physics, or one with a robot.

        Notes
        -----
        In the online game the search plans again before each choice of a shape, as if the visible
        items were the only ones, with its whole budget each time. The first placement of its best
        plan is played; then progress is reported, with the return so far.
        """
        self.check_rules(episode.rules)
        if self.search is None:
            self._play_until(episode, rng)
        elif episode.rules.buffer is None:
            if episode.end is None:
                self.search(self, episode, rng, on_progress)
        else:
            self._plan_visible(self.search, episode, rng, on_progress)

    def check_rules(self, rules: Rules) -> None:
        """Check that the agent can play by some rules.

        Raises
        ------
        ArgumentError
            If its search would plan with a robot.
        """
        if self.search is not None and rules.robot is not None:
            raise ArgumentError(
                f"agent {self.name!r} can't plan with a robot: each step of its search would be "
                "simulated; leave out the search"
            )

    def _play_until(
        self, episode: Episode, rng: np.random.Generator, stage: Stage | None = None
    ) -> None:
        """Let the policies play at least one action, up to a stage or to the end."""
        while episode.end is None:
            episode.step(self.act(episode, rng))
            if episode.stage is stage:
                return

    def _plan_visible(
        self, search: Search, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        """Play an online episode by a search that knows only the visible items."""
        if episode.rules.physics is not None:
            raise ArgumentError(
                f"agent {self.name!r} can't plan online with physics: a search needs the grid"
            )
        rollouts = 0

        def count(number: int, best: float) -> None:
            nonlocal rollouts
            rollouts += 1

        while episode.end is None:
            known = episode.visible_alone()
            search(self, known, rng, count)
            planned = known.box.placed[len(episode.box.placed) :]
            if planned:
                play_placement(episode, planned[0])
            else:  # its policies choose other rotations than those in which something fits
                self._play_until(episode, rng, Stage.SHAPE)
            on_progress(rollouts, episode.total)


def play_placement(episode: Episode, placed: PlacedItem) -> None:
    """Play the three choices that place a visible item.

    Parameters
    ----------
    episode : Episode
        The episode, at a choice of a shape.
    placed : PlacedItem
        The item, which is feasible there.
    """
    item = placed.item.turned(0)
    visible = np.flatnonzero(episode.visible).tolist()
    chosen = {
        Stage.SHAPE: next(n for n in visible if episode.task.items[n] == item),
        Stage.ROTATION: placed.item.rotation,
        Stage.LOCATION: int(np.ravel_multi_index(placed.location, episode.box.nodes)),
    }
    for stage in stages(episode.rules):
        episode.step(chosen[stage])


def _parts(policies: str) -> list[str]:
    """Split "shape/rotation/location" into three names, each of which may contain a path.

    From the right, a part begins where the name of a policy begins.
    """
    found: list[str] = []
    for stage in (Stage.LOCATION, Stage.ROTATION):
        slashes = [n for n, character in enumerate(policies) if character == "/"][::-1]
        if not slashes:
            break
        names = policy_names(stage)
        starts = (n for n in slashes if _kind(policies[n + 1 :]) in names)
        at = next(starts, slashes[0])
        found.insert(0, policies[at + 1 :])
        policies = policies[:at]
    return [policies, *found]


def _are_known(parts: Sequence[str]) -> bool:
    """Return whether each name is that of an installed policy for its sub-task."""
    return len(parts) == len(Stage) and all(
        _kind(part) in policy_names(stage) for stage, part in zip(Stage, parts, strict=True)
    )


def _kind(policy: str) -> str:
    """Return the name of a policy without its value."""
    return policy.partition("@")[0]


def _solution_shape(episode: Episode, rng: np.random.Generator) -> int:
    for shape, _, _ in episode.task.solution:
        if episode.visible[shape]:
            return shape
    raise PackItError("the task has no solution to play")


def _solution_rotation(episode: Episode, rng: np.random.Generator) -> int:
    return next(r for shape, r, _ in episode.task.solution if shape == episode.shape)


def _solution_location(episode: Episode, rng: np.random.Generator) -> int:
    location = next(at for shape, _, at in episode.task.solution if shape == episode.shape)
    return int(np.ravel_multi_index(location, episode.box.nodes))


GROUND_TRUTH = Agent("ground-truth", _solution_shape, _solution_rotation, _solution_location)
"""The agent that plays the solution of a task, item by item, in PackIt and PackIt-Easy.

Online it places visible items where the solution has them, which the kinematic rule may forbid.
"""
