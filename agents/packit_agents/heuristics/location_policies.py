"""Where the chosen shape goes: policies for Location-Selection.

All but the random one are deterministic: of the feasible locations that tie, the one that is least
in (z, x, y), as in bottom-left-back fill.

What a location is worth may depend on the rotation. Where the location is chosen first, as in
PackIt-Easy, each is valued with the first rotation in the order of alignment that is feasible
there: the one that `Aligned` is going to choose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from packit_agents.heuristics.action_scores import ActionScores, by_chance, by_rank
from packit_agents.heuristics.contacts import contacts, neighbours
from packit_agents.heuristics.heightmaps import gaps, growth, heightmap, room_below
from packit_sim.game.episode import Episode
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask

Costs = npt.NDArray[np.int64]
"""[x, y, z] over the grid's nodes: less is better."""


@dataclass(frozen=True)
class RandomLocation:
    """Any feasible location, uniformly (Goyal and Deng, 2020)."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.chosen_item is not None
        return int(rng.choice(np.flatnonzero(episode.chosen_item.feasible)))

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """By chance, too."""
        return by_chance(episode.action_mask(), rng)


@dataclass(frozen=True)
class BLBF:
    """Bottom-left-back fill: the feasible location least in (z, x, y) (Goyal and Deng, 2020)."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.chosen_item is not None and episode.chosen_item.blbf is not None
        return _number(episode, episode.chosen_item.blbf)

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """By the order of (z, x, y)."""
        assert episode.chosen_item is not None
        mask = episode.chosen_item.feasible
        z, x, y = mask.transpose(2, 0, 1).nonzero()
        return by_rank(np.ravel_multi_index((x, y, z), mask.shape).tolist(), mask.size)


@dataclass(frozen=True)
class DBLF:
    """Deepest-bottom-left fill: the feasible location least in (y, z, x).

    Karabulut and Inceoglu (2004): deepest, then bottom, then left. The deepest is the farthest
    back, as when a container is loaded from its front. (Work on boxes that are filled from above
    often takes it for the lowest; that DBLF differs from BLBF in ties only.)
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.chosen_item is not None
        y, z, x = episode.chosen_item.feasible.transpose(1, 2, 0).nonzero()
        return _number(episode, (int(x[0]), int(y[0]), int(z[0])))


@dataclass(frozen=True)
class HeightmapMinimisation:
    """The least sum of the heightmap after placing (Wang and Hauser, 2019).

    The heightmap has the top of the highest filled cell in each column of the box's cells.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return _least(episode, partial(growth, heightmap(episode.box.outer_words)))


@dataclass(frozen=True)
class MaximalContact:
    """The most pairs of neighbouring cells, one of the shape, the other filled or beyond a wall.

    Neighbours share a face. The walls are the four at the sides and the floor; the top is open.
    The touching perimeter (Lodi, Martello and Vigo, 1999) is the same in two dimensions.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return _least(episode, partial(_no_contacts, neighbours(episode.box.outer_words)))


@dataclass(frozen=True)
class LeastEmpty:
    """The fewest empty cells straight below the shape.

    In each column of cells these are the ones from its lowest cell down to the first filled one, or
    to the floor. The nearest in the literature is a reward for little empty space under what is
    packed (TAP-Net: Hu, Xu, Chen, Gong, Zhang and Huang, 2020). Where the shape is above all that
    is filled this is what the heightmap grows by, but for the shape's own height: in a kinematic
    box it mostly chooses as `HeightmapMinimisation` does. Below an overhang it doesn't.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return _least(episode, partial(gaps, room_below(episode.box.outer_words)))


def _no_contacts(planes: npt.NDArray[np.uint64], item: Item, mask: Mask) -> Costs:
    return -contacts(planes, item, mask)


def _least(episode: Episode, cost: Callable[[Item, Mask], Costs]) -> int:
    """The feasible location of least cost; of those that tie, the least in (z, x, y)."""
    costs = np.full(episode.box.nodes, np.iinfo(np.int64).max)
    for item, mask in _standings(episode):
        costs[mask] = cost(item, mask)[mask]
    by_height = costs.transpose(2, 0, 1)
    k, i, j = (int(n) for n in np.unravel_index(by_height.argmin(), by_height.shape))
    return _number(episode, (i, j, k))


def _standings(episode: Episode) -> Iterator[tuple[Item, Mask]]:
    """The feasible locations, each once, with the item in the rotation that it is valued with."""
    choice = episode.chosen_item
    assert choice is not None
    if episode.rotation is not None:
        yield choice.item, choice.feasible
        return
    left = choice.feasible.copy()
    for rotation in rotations.by_alignment(choice.item.extents):
        turned = choice.item.turned(rotation)
        mask = episode.box.feasible(turned) & left
        if mask.any():
            yield turned, mask
            left &= ~mask
        if not left.any():
            return


def _number(episode: Episode, location: Triple) -> int:
    return int(np.ravel_multi_index(location, episode.box.nodes))
