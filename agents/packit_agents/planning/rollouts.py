"""Building blocks of searches: proposals of a policy, rollouts, and the best end so far."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from packit_sim.game.episodes.agents import Agent, OnProgress
from packit_sim.game.episodes.episode import Episode, EpisodeState, Stage
from packit_sim.game.episodes.policies import Scored
from packit_sim.game.episodes.policy_registry import UnknownPolicyError
from packit_sim.rules import End


def proposals(
    agent: Agent, episode: Episode, rng: np.random.Generator, count: int | None = None
) -> list[tuple[int, float]]:
    """List the valid actions of the stage with their scores, the best first.

    Parameters
    ----------
    agent : Agent
        The agent whose policy for the stage scores the actions.
    episode : Episode
        The episode, at a choice.
    count : int, optional
        Largest number of actions; all by default.

    Returns
    -------
    list[tuple[int, float]]
        Actions and their scores; ties are in the order of the actions.

    Raises
    ------
    UnknownPolicyError
        If the policy has no scores.
    """
    policy = agent.policy(episode.stage)
    if not isinstance(policy, Scored):
        stage = episode.stage.name.lower()
        raise UnknownPolicyError(
            f"agent {agent.name!r} can't search: its {stage} policy gives no scores to choose by"
        )
    scores = policy.scores(episode, rng)
    ranked = np.argsort(-scores, kind="stable")[:count]
    return [(int(n), float(scores[n])) for n in ranked if scores[n] > -np.inf]


def play_on(
    agent: Agent,
    episode: Episode,
    rng: np.random.Generator,
    stages: Collection[Stage] = (Stage.SHAPE,),
) -> None:
    """Let the policies play up to the next of the given stages, or to the end."""
    while episode.end is None and episode.stage not in stages:
        episode.step(agent.act(episode, rng))


class Best:
    """The best end of the rollouts so far; ties go to the first.

    Parameters
    ----------
    on_progress : OnProgress
        Called after each rollout.
    """

    def __init__(self, on_progress: OnProgress) -> None:
        self._on_progress = on_progress
        self._state: EpisodeState | None = None
        self.rollouts = 0

    @property
    def total(self) -> float:
        """Return of the best end; -1 before the first rollout."""
        return -1.0 if self._state is None else self._state.total

    @property
    def is_complete(self) -> bool:
        """True if every item is placed at the best end, so that no other can be better."""
        return self._state is not None and self._state.end is End.COMPLETE

    def add(self, episode: Episode) -> None:
        """Count a finished rollout, and keep its end if it is the best."""
        assert episode.end is not None
        self.rollouts += 1
        if episode.total > self.total:
            self._state = episode.state()
        self._on_progress(self.rollouts, self.total)

    def restore(self, episode: Episode) -> None:
        """Restore an episode to the best end."""
        assert self._state is not None
        episode.restore(self._state)


def fill_up(agent: Agent, episode: Episode, rng: np.random.Generator) -> list[int]:
    """Play a rollout that skips shapes that do not fit, until no shape fits.

    Each choice of a shape is the most likely one that can be placed; the policies choose its
    rotation and location.

    Parameters
    ----------
    agent : Agent
        The agent whose policies play.
    episode : Episode
        The episode; it is at its end afterwards.

    Returns
    -------
    list[int]
        The shapes that were placed, in their order.
    """
    play_on(agent, episode, rng)
    chosen = []
    while episode.end is None:
        state = episode.state()
        for shape, _ in proposals(agent, episode, rng):
            episode.restore(state)
            if place(agent, episode, rng, shape):
                chosen.append(shape)
                break
    return chosen


def place(agent: Agent, episode: Episode, rng: np.random.Generator, shape: int) -> bool:
    """Choose a shape and let the policies place it; return whether it fitted."""
    episode.step(shape)
    play_on(agent, episode, rng)
    return episode.end in (None, End.COMPLETE)
