"""Large-neighbourhood search on the order in which shapes are packed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_agents.planning.budgets import Budget
from packit_agents.planning.rollouts import Best, fill_up, place
from packit_sim.game.agents import Agent, OnProgress
from packit_sim.game.episode import Episode, State

MOST_MOVED = 6
"""Shapes that change their place in the order at once, at most."""


@dataclass(frozen=True)
class _Packed:
    """An order that was packed. states: before each shape. left: shapes that found no room."""

    order: list[int]
    states: list[State]
    left: list[int]
    total: float


@dataclass(frozen=True)
class NeighbourhoodSearch:
    """Large-neighbourhood search (Shaw, 1998) on the order of shapes.

    An order is packed by the rotation and the location policy, shape by shape, passing over those
    for which there is no room. It begins with the agent's own; then some shapes, one of them that
    found no room, are taken out of the order and put in elsewhere, by chance, and the new order
    stays where its return is not less. budget: rollouts or time; it stops early where everything
    is placed.
    """

    budget: Budget

    @classmethod
    def parse(cls, value: str) -> NeighbourhoodSearch:
        """Of "200" or "10s". Raises ValueError that says so."""
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
    """A changed order, and how many of its first shapes are the same."""
    moved = [int(rng.choice(packed.left))]
    others = [shape for shape in packed.order if shape != moved[0]]
    count = min(int(rng.integers(MOST_MOVED)), len(others))
    moved += rng.choice(others, size=count, replace=False).tolist()
    order = [shape for shape in packed.order if shape not in moved]
    for shape in moved:
        order.insert(int(rng.integers(len(order) + 1)), shape)
    pairs = enumerate(zip(order, packed.order, strict=True))
    return order, next((n for n, (new, old) in pairs if new != old), len(order) - 1)


def _pack(
    agent: Agent, episode: Episode, rng: np.random.Generator, order: list[int], states: list[State]
) -> _Packed:
    """Packs an order to the end. states: those known already, before each of its first shapes."""
    states = list(states)
    left = [n for n in order[: len(states) - 1] if states[-1].outside[n]]
    episode.restore(states[-1])
    for shape in order[len(states) - 1 :]:
        if episode.end is None and not place(agent, episode, rng, shape):
            episode.restore(states[-1])
            left.append(shape)
        states.append(episode.state())
    while episode.end is None:
        place(agent, episode, rng, left[0])
    return _Packed(order, states[: len(order)], left, episode.total)
