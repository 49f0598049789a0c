"""Large-neighbourhood search on the order in which shapes are packed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_agents.planning.budgets import Budget
from packit_agents.planning.rollouts import Best, fill_up, place
from packit_sim.game.episodes.agents import Agent, OnProgress
from packit_sim.game.episodes.episode import Episode, EpisodeState

MAX_MOVED = 6
"""Maximum number of shapes whose place in the order changes at once."""


@dataclass(frozen=True)
class _Packed:
    """An order that was packed: the state before each shape, and the shapes that did not fit."""

    order: list[int]
    states: list[EpisodeState]
    unplaced: list[int]
    total: float


@dataclass(frozen=True)
class NeighbourhoodSearch:
    """Large-neighbourhood search (Shaw, 1998) on the order of shapes.

    An order is packed by the rotation and the location policy, shape by shape; shapes that do not
    fit are skipped. The first order is the agent's own. Then some shapes, at least one of them a
    shape that did not fit, move to random places of the order, and the new order is kept if its
    return is not less. The search stops early once every item is placed.

    Parameters
    ----------
    budget : Budget
        Number of rollouts, or time.
    """

    budget: Budget

    @classmethod
    def parse(cls, value: str) -> NeighbourhoodSearch:
        """Parse the budget, such as "200" or "10s" (see `Budget.parse`)."""
        return cls(Budget.parse(value))

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        best = Best(on_progress)
        clock = self.budget.start()
        start = episode.state()
        order = fill_up(agent, episode, rng)
        best.add(episode)
        clock.rollouts += 1
        order += [n for n in range(len(episode.outside)) if n not in order]
        kept: _Packed | None = None
        while not clock.is_over() and not best.is_complete:
            tried, same = (order, 0) if kept is None else _neighbour(kept, rng)
            states = [start] if kept is None else kept.states[: same + 1]
            packed = _pack(agent, episode, rng, tried, states)
            best.add(episode)
            clock.rollouts += 1
            if kept is None or packed.total >= kept.total:
                kept = packed
        best.restore(episode)


def _neighbour(packed: _Packed, rng: np.random.Generator) -> tuple[list[int], int]:
    """Draw a changed order; also return how many of its first shapes are unchanged."""
    moved = [int(rng.choice(packed.unplaced))]
    others = [shape for shape in packed.order if shape != moved[0]]
    count = min(int(rng.integers(MAX_MOVED)), len(others))
    moved += rng.choice(others, size=count, replace=False).tolist()
    order = [shape for shape in packed.order if shape not in moved]
    for shape in moved:
        order.insert(int(rng.integers(len(order) + 1)), shape)
    pairs = enumerate(zip(order, packed.order, strict=True))
    return order, next((n for n, (new, old) in pairs if new != old), len(order) - 1)


def _pack(
    agent: Agent,
    episode: Episode,
    rng: np.random.Generator,
    order: list[int],
    states: list[EpisodeState],
) -> _Packed:
    """Pack an order to the end, given the known states before each of its first shapes."""
    states = list(states)
    unplaced = [n for n in order[: len(states) - 1] if states[-1].outside[n]]
    episode.restore(states[-1])
    for shape in order[len(states) - 1 :]:
        if episode.end is None and not place(agent, episode, rng, shape):
            episode.restore(states[-1])
            unplaced.append(shape)
        states.append(episode.state())
    while episode.end is None:
        place(agent, episode, rng, unplaced[0])
    return _Packed(order, states[: len(order)], unplaced, episode.total)
