"""Beam search over shapes (paper, section 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_agents.planning.rollouts import Best, play_on, proposals
from packit_sim.core.errors import ArgumentError
from packit_sim.game.agents import Agent, OnProgress
from packit_sim.game.episode import Episode


@dataclass(frozen=True)
class BeamSearch:
    """Beam search over the most likely sequences of shapes.

    Each live beam proposes its best `width` shapes. Of all proposals, the `width` with the highest
    score are kept: the sum of the log-probabilities that the shape policy gave to its choices. The
    reward does not guide the search; it only selects the best end. Width 1 is the agent itself.

    Parameters
    ----------
    width : int
        Number of beams.

    Raises
    ------
    ArgumentError
        If the number is less than 1.
    """

    width: int

    def __post_init__(self) -> None:
        if self.width < 1:
            raise ArgumentError(f"{self.width} beams are not possible: choose 1 or more")

    @classmethod
    def parse(cls, value: str) -> BeamSearch:
        """Parse the number of beams, such as "4".

        Parameters
        ----------
        value : str
            The digits of the number.

        Returns
        -------
        BeamSearch
            The search.

        Raises
        ------
        ArgumentError
            If the value is not a number.
        """
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
            for score_before, state in live:
                episode.restore(state)
                for shape, score in proposals(agent, episode, rng, self.width):
                    candidates.append((score_before + score, state, shape))
            candidates.sort(key=lambda candidate: -candidate[0])
            live = []
            for score, state, shape in candidates[: self.width]:
                episode.restore(state)
                episode.step(shape)
                play_on(agent, episode, rng)
                if episode.end is None:
                    live.append((score, episode.state()))
                else:
                    best.add(episode)
        best.restore(episode)
