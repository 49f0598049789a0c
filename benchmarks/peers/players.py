"""PackIt-Sim's agents, by the rules of the game or skipping items as the other peers do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.peers.posed import Posed
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.rules import End

SEED = 0


@dataclass(frozen=True)
class Player:
    """An agent as a peer.

    Parameters
    ----------
    agent : str
        Name of the agent.
    skipping : bool
        Whether it skips an item that does not fit, as the other peers do, instead of stopping.
    """

    agent: str
    skipping: bool = True

    @property
    def name(self) -> str:
        return f"{self.agent}{'' if self.skipping else ', stopping'}"

    def pack(self, task: Task) -> list[Posed]:
        """Play an episode to its end by the rules, or until no item fits."""
        agent, rng = Agent.from_name(self.agent), np.random.default_rng(SEED)
        episode = Episode(task)
        agent.play(episode, rng)
        while self.skipping and _skip(episode):
            while episode.end is None:
                episode.step(agent.act(episode, rng))
        return [Posed(placed.item, placed.center) for placed in episode.box.placed]


def _skip(episode: Episode) -> bool:
    """Drop the shape that does not fit; return whether another one is left."""
    if episode.end is not End.NO_LOCATION:
        return False
    outside = episode.outside.copy()
    outside[episode.shape] = False
    state = episode.state()
    episode.restore(
        replace(
            state,
            outside=tuple(outside.tolist()),
            stage=Stage.SHAPE,
            shape=None,
            rotation=None,
            location=None,
            end=None if outside.any() else End.NO_LOCATION,
        )
    )
    return bool(outside.any())
