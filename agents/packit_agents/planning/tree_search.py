"""Monte Carlo tree search over any of the sub-tasks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from packit_agents.planning.budgets import Budget
from packit_agents.planning.rollouts import Best, fill_up, go_on, proposals
from packit_sim.core.errors import ArgumentError
from packit_sim.game.agents import Agent, OnProgress
from packit_sim.game.episode import Episode, Stage, State

EXPLORATION = 0.3
"""Weight of what was tried little, beside returns of 0 to 1."""

BRANCHES = 24
"""The likeliest actions of a node that are ever tried."""

STAGE_NAMES = {stage.name.lower(): stage for stage in Stage}


@dataclass
class _Node:
    """A choice. priors: of its actions. children: of those that were tried."""

    state: State
    actions: list[int]
    priors: list[float]
    children: dict[int, _Node] = field(default_factory=dict)
    visits: int = 0
    best: float = 0.0
    is_closed: bool = False

    def select(self) -> int | None:
        """The action to try next; None where everything below is known."""
        root = np.sqrt(self.visits + 1)
        values: dict[int, float] = {}
        for action, prior in zip(self.actions, self.priors, strict=True):
            child = self.children.get(action)
            if child is None:
                values[action] = self.best + EXPLORATION * prior * root
            elif not child.is_closed:
                values[action] = child.best + EXPLORATION * prior * root / (1 + child.visits)
        return max(values, key=values.__getitem__) if values else None


@dataclass(frozen=True)
class TreeSearch:
    """Monte Carlo tree search of a game for one: the tree keeps the best return below each node.

    Selection weighs that return against the policy's probabilities and how little an action was
    tried (PUCT: Rosin, 2011; Silver et al., 2017); the maximum in the place of the mean is that of
    single-player searches (Schadd et al., 2008). A leaf is played to its end by the policies,
    passing over shapes for which there is no room. Where the tree is known to its ends, it stops.

    budget: rollouts or time. stages: the sub-tasks that it chooses; the others are the policies'.
    """

    budget: Budget
    stages: frozenset[Stage] = frozenset({Stage.SHAPE})

    @classmethod
    def parse(cls, value: str) -> TreeSearch:
        """Of "200" or "10s", with ":shape,rotation" for stages. Raises ValueError that says so."""
        budget, _, names = value.partition(":")
        chosen = names.split(",") if names else ["shape"]
        for name in chosen:
            if name not in STAGE_NAMES:
                raise ArgumentError(
                    f"there is no sub-task {name!r}: choose from {', '.join(STAGE_NAMES)}"
                )
        return cls(Budget.parse(budget), frozenset(STAGE_NAMES[name] for name in chosen))

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        best = Best(on_progress)
        clock = self.budget.start()
        go_on(agent, episode, rng, self.stages)
        root = self._node(agent, episode, rng)
        if root.is_closed:
            return
        while not (best.is_complete or root.is_closed or (best.rollouts and clock.is_over())):
            path, node = [root], root
            action = node.select()
            while action is not None:
                episode.restore(node.state)
                episode.step(action)
                go_on(agent, episode, rng, self.stages)
                if action not in node.children:
                    node.children[action] = self._node(agent, episode, rng)
                    path.append(node.children[action])
                    break
                node = node.children[action]
                path.append(node)
                action = node.select()
            fill_up(agent, episode, rng)
            best.add(episode)
            clock.rollouts += 1
            self._tell(path, episode.total)
        best.restore(episode)

    def _node(self, agent: Agent, episode: Episode, rng: np.random.Generator) -> _Node:
        state = episode.state()
        if episode.end is not None:
            return _Node(state, [], [], is_closed=True)
        found = proposals(agent, episode, rng, BRANCHES)
        weights = np.exp([score - found[0][1] for _, score in found])
        return _Node(state, [action for action, _ in found], (weights / weights.sum()).tolist())

    def _tell(self, path: list[_Node], total: float) -> None:
        """Counts a rollout along its path, and closes what is known to its ends."""
        for node in reversed(path):
            node.visits += 1
            node.best = max(node.best, total)
            known = [child.is_closed for child in node.children.values()]
            node.is_closed = len(known) == len(node.actions) and all(known)
