"""What searches are made of: proposals of a policy, and rollouts that keep the best end."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from packit_sim.game.agents import Agent, OnProgress, Scored, UnknownPolicyError
from packit_sim.game.episode import End, Episode, Stage, State


def proposals(
    agent: Agent, episode: Episode, rng: np.random.Generator, count: int | None = None
) -> list[tuple[int, float]]:
    """The valid actions of the stage with their scores, the best first; at most `count`.

    Of equal ones the first comes first. Raises UnknownPolicyError where the policy has no scores.
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


def go_on(
    agent: Agent,
    episode: Episode,
    rng: np.random.Generator,
    stages: Collection[Stage] = (Stage.SHAPE,),
) -> None:
    """Plays by the policies up to the next of these stages, or to the end."""
    while episode.end is None and episode.stage not in stages:
        episode.step(agent.act(episode, rng))


class Best:
    """The best end of the rollouts so far; the first of equal ones."""

    def __init__(self, on_progress: OnProgress) -> None:
        self._on_progress = on_progress
        self._state: State | None = None
        self.rollouts = 0

    @property
    def total(self) -> float:
        """Its return; less than any before there is one."""
        return -1.0 if self._state is None else self._state.total

    @property
    def is_complete(self) -> bool:
        """Whether nothing is left outside at the best end: no other can be better."""
        return self._state is not None and self._state.end is End.COMPLETE

    def add(self, episode: Episode) -> None:
        """Counts a rollout that has come to its end."""
        assert episode.end is not None
        self.rollouts += 1
        if episode.total > self.total:
            self._state = episode.state()
        self._on_progress(self.rollouts, self.total)

    def restore(self, episode: Episode) -> None:
        """Leaves an episode at the best end."""
        assert self._state is not None
        episode.restore(self._state)


def fill_up(agent: Agent, episode: Episode, rng: np.random.Generator) -> list[int]:
    """A rollout that passes over shapes for which there is no room, until there is room for none.

    At each choice of a shape: the likeliest that can be placed, rotated and located by the
    policies. Returns those shapes, in their order.
    """
    go_on(agent, episode, rng)
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
    """Chooses a shape, and the policies the rest; whether there was room for it."""
    episode.step(shape)
    go_on(agent, episode, rng)
    return episode.end in (None, End.COMPLETE)
