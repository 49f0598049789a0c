"""Beam search over shapes (paper, section 5)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from packit_agents.planning.budgets import Budget, Clock
from packit_agents.planning.rollouts import Best, play_on, proposals
from packit_sim.core.errors import ArgumentError
from packit_sim.game.episodes.agents import Agent, OnProgress
from packit_sim.game.episodes.episode import Episode


@dataclass(frozen=True)
class BeamSearch:
    """Beam search over the most likely sequences of shapes.

    Each live beam proposes its best `width` shapes. Of all proposals, the `width` with the highest
    score are kept: the sum of the log-probabilities that the shape policy gave to its choices. The
    reward does not guide the search; it only selects the best end. Width 1 is the agent itself.

    With a time, searches of 1, 2, 4 beams and so on follow each other until it is spent, every item
    is placed, or no sequence of shapes is left out.

    Parameters
    ----------
    width : int
        Number of beams, of the first search if there is a time.
    seconds : float, optional
        Processor time.

    Raises
    ------
    ArgumentError
        If the number is less than 1.
    """

    width: int
    seconds: float | None = None

    def __post_init__(self) -> None:
        if self.width < 1:
            raise ArgumentError(f"{self.width} beams are not possible: choose 1 or more")

    @classmethod
    def parse(cls, value: str) -> BeamSearch:
        """Parse the number of beams, such as "4", or the time, such as "10s".

        Parameters
        ----------
        value : str
            The digits of the number, or a time (see `Budget.parse`).

        Returns
        -------
        BeamSearch
            The search.

        Raises
        ------
        ArgumentError
            If the value is neither.
        """
        if value.endswith("s"):
            return cls(1, Budget.parse(value).seconds)
        if not value.isdecimal():
            raise ArgumentError(
                "its value is the number of beams, such as beam=4, or a time, such as beam=10s, "
                f"not {value!r}"
            )
        return cls(int(value))

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        best = Best(on_progress)
        clock = Budget(seconds=math.inf if self.seconds is None else self.seconds).start()
        start = episode.state()
        width = self.width
        while self._leaves_out(width, agent, episode, rng, best, clock):
            if self.seconds is None or best.is_complete or clock.is_over():
                break
            episode.restore(start)
            width *= 2
        best.restore(episode)

    def _leaves_out(
        self,
        width: int,
        agent: Agent,
        episode: Episode,
        rng: np.random.Generator,
        best: Best,
        clock: Clock,
    ) -> bool:
        """Search with some beams; return whether a sequence of shapes was left out."""
        leaves_out = False
        live = [(0.0, episode.state())]
        while live:
            candidates = []
            for score_before, state in live:
                episode.restore(state)
                found = proposals(agent, episode, rng, width + 1)
                leaves_out |= len(found) > width
                for shape, score in found[:width]:
                    candidates.append((score_before + score, state, shape))
            candidates.sort(key=lambda candidate: -candidate[0])
            leaves_out |= len(candidates) > width
            live = []
            for score, state, shape in candidates[:width]:
                if best.rollouts and clock.is_over():
                    return True
                episode.restore(state)
                episode.step(shape)
                play_on(agent, episode, rng)
                if episode.end is None:
                    live.append((score, episode.state()))
                else:
                    best.add(episode)
        return leaves_out
