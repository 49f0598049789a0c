"""Monte Carlo tree search over any of the sub-tasks."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from packit_agents.planning.budgets import Budget
from packit_agents.planning.rollouts import Best, fill_up, play_on, proposals
from packit_sim.core.errors import ArgumentError
from packit_sim.game.episodes.agents import Agent, OnProgress
from packit_sim.game.episodes.episode import Episode, EpisodeState, Stage

EXPLORATION = 0.3
"""Weight of exploration, relative to returns of 0 to 1."""

BRANCHES = 24
"""Number of the most likely actions of a node that are considered."""

STAGE_NAMES = {stage.name.lower(): stage for stage in Stage}


@dataclass
class _Node:
    """A choice: its actions, their prior probabilities, and a child for each action tried."""

    state: EpisodeState
    actions: list[int]
    priors: list[float]
    children: dict[int, _Node] = field(default_factory=dict)
    visits: int = 0
    best: float = 0.0
    is_closed: bool = False

    def select(self) -> int | None:
        """Select the action to try next; None if everything below is known."""
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
    """Single-player Monte Carlo tree search, guided by the best return below each node.

    From a leaf the policies play to the end, skipping shapes that do not fit. The search stops
    early once every item is placed or the whole tree is explored.

    Parameters
    ----------
    budget : Budget
        Number of rollouts, or time.
    stages : frozenset[Stage]
        The sub-tasks whose actions the search chooses; the policies choose the others.

    Notes
    -----
    Selection weighs the return against the policy's probabilities and the number of visits (PUCT:
    Rosin, 2011; Silver et al., 2017). It uses the maximum instead of the mean, as in other
    single-player searches (Schadd et al., 2008).
    """

    budget: Budget
    stages: frozenset[Stage] = frozenset({Stage.SHAPE})

    @classmethod
    def parse(cls, value: str) -> TreeSearch:
        """Parse the budget and the stages, such as "200", "10s" or "200:shape,rotation".

        Parameters
        ----------
        value : str
            A budget (see `Budget.parse`), and names of stages after a colon; "shape" by default.

        Returns
        -------
        TreeSearch
            The search.

        Raises
        ------
        ArgumentError
            If the budget or a stage is not valid.
        """
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
        play_on(agent, episode, rng, self.stages)
        root = self._node(agent, episode, rng)
        if root.is_closed:
            return
        while not (best.is_complete or root.is_closed or (best.rollouts and clock.is_over())):
            path, node = [root], root
            action = node.select()
            while action is not None:
                episode.restore(node.state)
                episode.step(action)
                play_on(agent, episode, rng, self.stages)
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
            self._back_up(path, episode.total)
        best.restore(episode)

    def _node(self, agent: Agent, episode: Episode, rng: np.random.Generator) -> _Node:
        state = episode.state()
        if episode.end is not None:
            return _Node(state, [], [], is_closed=True)
        found = proposals(agent, episode, rng, BRANCHES)
        weights = np.exp([score - found[0][1] for _, score in found])
        return _Node(state, [action for action, _ in found], (weights / weights.sum()).tolist())

    def _back_up(self, path: list[_Node], total: float) -> None:
        """Count a rollout along its path, and close nodes below which everything is known."""
        for node in reversed(path):
            node.visits += 1
            node.best = max(node.best, total)
            closed = [child.is_closed for child in node.children.values()]
            node.is_closed = len(closed) == len(node.actions) and all(closed)
