"""Backtracking over shapes (paper, section 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_agents.planning.rollouts import Best, play_on, proposals
from packit_sim.core.errors import ArgumentError
from packit_sim.game.episodes.agents import Agent, OnProgress
from packit_sim.game.episodes.episode import Episode, EpisodeState


@dataclass(frozen=True)
class Backtracking:
    """Depth-first search: at each end, replace the last choice of a shape by the next best.

    If no alternative is left there, the search goes back one choice further. It stops early once
    every item is placed or every order was tried.

    Parameters
    ----------
    backtracks : int
        Largest number of times to backtrack; the number of rollouts is one more.

    Raises
    ------
    ArgumentError
        If the number is negative.
    """

    backtracks: int

    def __post_init__(self) -> None:
        if self.backtracks < 0:
            raise ArgumentError(f"{self.backtracks} backtracks are not possible: choose 0 or more")

    @classmethod
    def parse(cls, value: str) -> Backtracking:
        """Parse the number of backtracks, such as "8".

        Parameters
        ----------
        value : str
            The digits of the number.

        Returns
        -------
        Backtracking
            The search.

        Raises
        ------
        ArgumentError
            If the value is not a number.
        """
        if not value.isdecimal():
            raise ArgumentError(
                f"its value is the number of backtracks, such as backtrack=8, not {value!r}"
            )
        return cls(int(value))

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        best = Best(on_progress)
        path: list[tuple[EpisodeState, list[int]]] = []
        while best.rollouts <= self.backtracks:
            while episode.end is None:
                ranked = [shape for shape, _ in proposals(agent, episode, rng)]
                path.append((episode.state(), ranked[1:]))
                episode.step(ranked[0])
                play_on(agent, episode, rng)
            best.add(episode)
            if best.is_complete:
                break
            while path and not path[-1][1]:
                path.pop()
            if not path:
                break
            state, others = path[-1]
            episode.restore(state)
            episode.step(others.pop(0))
            play_on(agent, episode, rng)
        best.restore(episode)
