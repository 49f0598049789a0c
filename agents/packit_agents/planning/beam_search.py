"""Beam search over shapes (paper, section 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_agents.planning.rollouts import Best, go_on, proposals
from packit_sim.core.errors import ArgumentError
from packit_sim.game.agents import Agent, OnProgress
from packit_sim.game.episode import Episode


@dataclass(frozen=True)
class BeamSearch:
    """Keeps the `width` likeliest sequences of shapes side by side.

    Each live beam proposes its best `width` shapes; of all proposals the `width` with the highest
    score go on, the sum of the log-probabilities that the shape policy gave to its choices. The
    reward guides nothing: it only tells the best of the ends. With width 1 it is the agent itself.
    """

    width: int

    def __post_init__(self) -> None:
        """Raises ValueError where there is no beam."""
        if self.width < 1:
            raise ArgumentError(f"{self.width} beams are not possible: choose 1 or more")

    @classmethod
    def parse(cls, value: str) -> BeamSearch:
        """Of "4", the width. Raises ValueError that says so."""
        if not value.isdecimal():
            raise ArgumentError(f"its value is the number of beams, such as beam=4, not {value!r}")
        return cls(int(value))

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        best = Best(on_progress)
        live = [(0.0, episode.state())]
        while live:
            candidates = []
            for so_far, state in live:
                episode.restore(state)
                for shape, score in proposals(agent, episode, rng, self.width):
                    candidates.append((so_far + score, state, shape))
            candidates.sort(key=lambda candidate: -candidate[0])
            live = []
            for score, state, shape in candidates[: self.width]:
                episode.restore(state)
                episode.step(shape)
                go_on(agent, episode, rng)
                if episode.end is None:
                    live.append((score, episode.state()))
                else:
                    best.add(episode)
        best.restore(episode)
