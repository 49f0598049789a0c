"""Ruin and recreate: some items leave the box, and all items outside are placed again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_agents.placements.policies import PlacementPolicy
from packit_agents.placements.scored_layout import ScoredLayout
from packit_agents.planning.budgets import Budget
from packit_agents.planning.rollouts import play_on
from packit_sim.box import Box
from packit_sim.core.errors import ArgumentError
from packit_sim.game.episodes.agents import Agent, OnProgress, play_placement
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.game.episodes.policy_registry import UnknownPolicyError
from packit_sim.placement import PlacedItem

MAX_REMOVED = 6
"""Maximum number of items that leave the box at once, as long as better layouts are found."""

PATIENCE = 20
"""Number of layouts without improvement after which one more item may leave at once."""

NEARBY = 0.7
"""Probability that the items that leave are neighbours."""

TEMPERATURE = 0.3
"""Temperature at which placements are drawn."""

LOSS = 0.01
"""Mean loss of return that is accepted at the beginning; it falls to 0."""


@dataclass(frozen=True)
class RuinAndRecreate:
    """Ruin and recreate (Schrimpf et al., 2000) with the placements that a policy prefers.

    The first layout is the agent's own. Then some items leave the box, mostly neighbours, and all
    items outside are placed again, where the policy wants them, with some randomness. The longer no
    better layout was found, the more items may leave, up to all. A layout that is worse is accepted
    with a probability that falls to 0 (simulated annealing). The search stops early once every item
    is placed.

    Parameters
    ----------
    budget : Budget
        Number of layouts, or time.
    """

    budget: Budget

    @classmethod
    def parse(cls, value: str) -> RuinAndRecreate:
        """Parse the budget, such as "200" or "10s" (see `Budget.parse`)."""
        return cls(Budget.parse(value))

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        """Play an episode from a choice of a shape, and leave it at the best end that was found.

        Parameters
        ----------
        agent : Agent
            The agent, whose policies choose placements.
        on_progress : OnProgress
            Called after each layout.

        Raises
        ------
        UnknownPolicyError
            If the agent does not choose placements.
        ArgumentError
            If the episode is played with physics or for values.
        """
        policy = agent.policy(Stage.SHAPE)
        if not isinstance(policy, PlacementPolicy):
            raise UnknownPolicyError(
                f"agent {agent.name!r} can't ruin and recreate: its policies don't choose "
                "placements, as champion's do"
            )
        if episode.rules.moves_items:
            raise ArgumentError("ruin and recreate needs items that stay on the grid: no physics")
        if episode.rules.values:
            raise ArgumentError("ruin and recreate packs as much volume as it can: no values")
        clock = self.budget.start()
        items = [episode.task.items[n] for n in np.flatnonzero(episode.outside).tolist()]
        assert isinstance(episode.box, Box)
        box = episode.box.emptied()
        box.restore(episode.box.snapshot())
        layout = ScoredLayout(items, box, tuple(episode.rules.allowed_rotations))
        volume = episode.task.volume
        layout.fill(policy.scorer, rng)
        best = current = _Filled(layout.placed, layout.volume)
        since_best = 0
        clock.rollouts += 1
        on_progress(clock.rollouts, episode.total + best.volume / volume)
        while len(best.placed) < len(items) and not clock.is_over():
            loss = LOSS * clock.share_left**2 * rng.exponential()
            min_volume = current.volume - loss * volume
            layout.restart(_ruined(current.placed, MAX_REMOVED + since_best // PATIENCE, rng))
            layout.fill(policy.scorer, rng, TEMPERATURE, min_volume)
            found = _Filled(layout.placed, layout.volume)
            if found.volume >= min_volume:
                current = found
            since_best += 1
            if found.volume > best.volume:
                best, since_best = found, 0
            clock.rollouts += 1
            on_progress(clock.rollouts, episode.total + best.volume / volume)
        for _, placed in best.placed:
            # Only a learned box may answer otherwise than before: there the order matters.
            if episode.box.is_feasible(placed.item, placed.location):
                play_placement(episode, placed)
        play_on(agent, episode, rng, stages=())


@dataclass(frozen=True)
class _Filled:
    """A layout into which no other item fits."""

    placed: list[tuple[int, PlacedItem]]
    volume: float


def _ruined(
    placed: list[tuple[int, PlacedItem]], max_removed: int, rng: np.random.Generator
) -> list[tuple[int, PlacedItem]]:
    """Leave out some items: mostly one and its neighbours."""
    count = int(rng.integers(1, min(max_removed, len(placed)) + 1))
    if rng.random() < NEARBY:
        centers = np.array([item.center for _, item in placed])
        first = centers[int(rng.integers(len(placed)))]
        order = np.argsort(np.linalg.norm(centers - first, axis=1), kind="stable")
    else:
        order = rng.permutation(len(placed))
    removed = set(order[:count].tolist())
    return [each for n, each in enumerate(placed) if n not in removed]
