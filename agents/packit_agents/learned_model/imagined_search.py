"""Search in a learned model of the game."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np

from packit_agents.learned_model.contact_network import bundled_network
from packit_agents.learned_model.learned_box import LearnedBox
from packit_agents.planning.rollouts import place, play_on, proposals
from packit_sim.box import Box
from packit_sim.core.errors import ArgumentError
from packit_sim.game.episodes.agents import Agent, OnProgress, Search
from packit_sim.game.episodes.episode import Episode, Stage, stages
from packit_sim.game.episodes.policy_registry import load_search
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import Triple


@dataclass(frozen=True)
class ImaginedSearch:
    """A search that plans with a learned model of what fits, not with the exact engine.

    Another search plans an episode in a `LearnedBox`, where rollouts cost no comparison of meshes.
    Then its plan is played, item by item: where the plan has it, if the model says that it is free
    there in the box as it really is, and else where the agent's policies put it. The exact engine
    only decides about the move that is made. Where the model was wrong about the location, the
    location policy chooses another one. A shape that really fits nowhere, though the model placed
    it, ends the episode, as the rules say.

    Parameters
    ----------
    search : Search
        The search that plans.
    new_box : callable
        Creates the empty box of the plan, with some cells. With `Box` itself the model is perfect.
    """

    search: Search
    new_box: Callable[[Triple], Box]

    @classmethod
    def parse(cls, value: str) -> Self:
        """Parse the search that plans, such as "lns=200"; the model is the bundled one."""
        return cls(load_search(value), partial(LearnedBox, bundled_network().decide))

    def __call__(
        self, agent: Agent, episode: Episode, rng: np.random.Generator, on_progress: OnProgress
    ) -> None:
        rules = episode.rules
        if rules.moves_items or rules.kinematic or rules.support or rules.boxes > 1:
            raise ArgumentError(
                "a search in the learned model needs the rules without physics, kinematic, support "
                f"and several boxes: these are {rules}"
            )
        imagined = Episode(episode.task, rules)
        imagined.box = self.new_box(episode.box.cells)
        imagined.restore(episode.state())
        rollouts = 0

        def count(number: int, best: float) -> None:
            nonlocal rollouts
            rollouts = number

        self.search(agent, imagined, rng, count)
        planned = imagined.box.placed[len(episode.box.placed) :]
        plan = dict(zip(_shapes(imagined, planned), planned, strict=True))
        while episode.end is None:
            imagined.restore(episode.state())
            move = _next_move(agent, imagined, rng, plan)
            if move is None:
                play_on(agent, episode, rng, stages=())
            else:
                _play(agent, episode, rng, *move)
        on_progress(rollouts, episode.total)


def _shapes(episode: Episode, placed: tuple[PlacedItem, ...]) -> list[int]:
    """Return the numbers of placed items in the task; equal items have different numbers."""
    left = list(enumerate(episode.task.items))
    numbers = []
    for each in placed:
        item = each.item.turned(0)
        found = next(pair for pair in left if pair[1] == item and not episode.outside[pair[0]])
        left.remove(found)
        numbers.append(found[0])
    return numbers


def _next_move(
    agent: Agent, imagined: Episode, rng: np.random.Generator, plan: dict[int, PlacedItem]
) -> tuple[int, PlacedItem] | None:
    """Find the first shape, of the plan or else by the shape policy, that the model can place."""
    state = imagined.state()
    others = [shape for shape, _ in proposals(agent, imagined, rng) if shape not in plan]
    for shape in [*plan, *others]:
        if state.outside[shape]:
            planned = plan.get(shape)
            if planned and imagined.box.is_feasible(planned.item, planned.location):
                return shape, planned
            if place(agent, imagined, rng, shape):
                return shape, imagined.box.placed[-1]
            imagined.restore(state)
    return None


def _play(
    agent: Agent, episode: Episode, rng: np.random.Generator, shape: int, planned: PlacedItem
) -> None:
    """Play the choices of a planned placement, and the policies' own where it is not feasible."""
    location = int(np.ravel_multi_index(planned.location, episode.box.nodes))
    wanted = {Stage.SHAPE: shape, Stage.ROTATION: planned.item.rotation, Stage.LOCATION: location}
    for stage in stages(episode.rules):
        if episode.end is not None:
            return
        action = wanted[stage]
        if stage is not Stage.SHAPE and not _is_valid(episode, action):
            action = agent.act(episode, rng)
        episode.step(action)


def _is_valid(episode: Episode, action: int) -> bool:
    """Return whether an action is valid, without a mask where the meshes decide one location."""
    if episode.stage is Stage.LOCATION:
        assert episode.chosen_item is not None
        i, j, k = np.unravel_index(action, episode.box.nodes)
        return episode.chosen_item.is_feasible((int(i), int(j), int(k)))
    return bool(episode.action_mask()[action])
