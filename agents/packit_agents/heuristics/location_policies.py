"""Policies for Location-Selection: they choose the location of the chosen shape.

All but the random one are deterministic: ties go to the first feasible location in (z, x, y)
order, as in bottom-left-back fill.

The cost of a location may depend on the rotation. If the location is chosen first, as in
PackIt-Easy, each location is assessed with the first rotation in the order of alignment that is
feasible there, the one that `Aligned` will choose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from packit_agents.heuristics.action_scores import ActionScores, by_random_weight, by_rank
from packit_agents.heuristics.contacts import Neighbours, by_contacts
from packit_agents.heuristics.heightmaps import by_cost, gaps, growth, heightmap, space_below
from packit_sim.game.episodes.episode import Episode
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask


@dataclass(frozen=True)
class RandomLocation:
    """A feasible location drawn uniformly (Goyal and Deng, 2020)."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.chosen_item is not None
        return int(rng.choice(np.flatnonzero(episode.chosen_item.feasible)))

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """Rank the feasible locations at random."""
        return by_random_weight(episode.action_mask(), rng)


@dataclass(frozen=True)
class BLBF:
    """Bottom-left-back fill: the first feasible location in (z, x, y) (Goyal and Deng, 2020)."""

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.chosen_item is not None and episode.chosen_item.blbf is not None
        return _number(episode, episode.chosen_item.blbf)

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """Rank the feasible locations by (z, x, y)."""
        assert episode.chosen_item is not None
        mask = episode.chosen_item.feasible
        z, x, y = mask.transpose(2, 0, 1).nonzero()
        return by_rank(np.ravel_multi_index((x, y, z), mask.shape).tolist(), mask.size)


@dataclass(frozen=True)
class DBLF:
    """Deepest-bottom-left fill: the first feasible location in (y, z, x).

    Notes
    -----
    Karabulut and Inceoglu (2004): deepest, then bottom, then left. The deepest is the farthest
    back, as when a container is loaded from its front. In work on boxes that are filled from above
    it is often the lowest; that variant differs from BLBF in ties only.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.chosen_item is not None
        y, z, x = episode.chosen_item.feasible.transpose(1, 2, 0).nonzero()
        return _number(episode, (int(x[0]), int(y[0]), int(z[0])))


@dataclass(frozen=True)
class HeightmapMinimisation:
    """The smallest sum of the heightmap after placement (Wang and Hauser, 2019).

    The heightmap is the top of the highest filled cell in each column of the box's cells.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        heights = heightmap(episode.box.outer_words)
        return _best(episode, lambda item, mask: by_cost(growth(heights, item, mask), mask))


@dataclass(frozen=True)
class MaximalContact:
    """The most pairs of neighbouring cells, one of the shape, the other filled or beyond a wall.

    Neighbours share a face. The walls are the four sides and the floor; the top is open.

    Notes
    -----
    The touching perimeter (Lodi, Martello and Vigo, 1999) is the same in two dimensions.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        filled = Neighbours.of(episode.box.outer_words)
        return _best(
            episode,
            lambda item, mask: ((-most, at) for most, at in by_contacts(filled, item, mask)),
        )


@dataclass(frozen=True)
class LeastEmpty:
    """The fewest empty cells straight below the shape.

    In each column these are the cells from the shape's lowest cell down to the first filled cell,
    or to the floor.

    Notes
    -----
    The nearest in the literature is a reward for little empty space under the packed items
    (TAP-Net: Hu, Xu, Chen, Gong, Zhang and Huang, 2020). If the shape is above all filled cells,
    the cost is the growth of the heightmap, less the shape's own height: in a kinematic box the
    policy mostly chooses as `HeightmapMinimisation` does. Below an overhang it does not.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        spaces = space_below(episode.box.outer_words)
        return _best(episode, lambda item, mask: by_cost(gaps(spaces, item, mask), mask))


def _best(episode: Episode, ranked: Callable[[Item, Mask], Iterator[tuple[int, Triple]]]) -> int:
    """Find the feasible location of the least cost; ties go to the first in (z, x, y).

    Parameters
    ----------
    ranked : callable
        Yields the costs and the locations of a mask, the best first.

    Returns
    -------
    int
        The number of the location.
    """
    choice = episode.chosen_item
    assert choice is not None
    if episode.rotation is not None:
        locations = (location for _, location in ranked(choice.item, choice.candidates))
        return _number(episode, next(filter(choice.is_feasible, locations)))
    best = (next(ranked(item, mask)) for item, mask in _in_alignment(episode))
    _, location = min(best, key=lambda found: (found[0], found[1][2], found[1]))
    return _number(episode, location)


def _in_alignment(episode: Episode) -> Iterator[tuple[Item, Mask]]:
    """Yield feasible locations, each once, with the item in the rotation to assess it with."""
    choice = episode.chosen_item
    assert choice is not None
    left = choice.feasible.copy()
    for turned in episode.rules.by_alignment(choice.item):
        mask = episode.box.feasible(turned) & left
        if mask.any():
            yield turned, mask
            left &= ~mask
        if not left.any():
            return


def _number(episode: Episode, location: Triple) -> int:
    _, ny, nz = episode.box.nodes
    i, j, k = location
    return (i * ny + j) * nz + k
