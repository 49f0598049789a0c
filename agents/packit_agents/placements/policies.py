"""Policies that choose placements: the shape, its rotation and its location together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Self
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from packit_agents.heuristics.action_scores import ActionScores, by_weight
from packit_agents.placements.free_space import FreeSpace
from packit_agents.placements.network import PlacementNetwork
from packit_agents.placements.placement_features import Placements, choose, placements
from packit_agents.placements.scored_layout import Scorer
from packit_agents.placements.stable_choice import StableChoice
from packit_sim.core.assets import assets_folder
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.placement import ItemInBox

UNSCORED = 1e-6
"""Weight of an action without a scored placement; the placement with the highest score has 1."""


@dataclass(frozen=True, eq=False)
class ComparedPlacements:
    """Placements that were compared, and the best of them.

    Attributes
    ----------
    scores : ndarray
        float32 (n,), the score of each.
    chosen : int
        The best one, which is feasible.
    """

    found: Placements
    scores: npt.NDArray[np.float32]
    chosen: int

    def actions(self, episode: Episode) -> npt.NDArray[np.int64]:
        """Return the action of each placement at the episode's stage: int64 (n,)."""
        if episode.stage is Stage.SHAPE:
            return self.found.items
        if episode.stage is Stage.ROTATION:
            return self.found.rotations
        return np.ravel_multi_index(tuple(self.found.corners[:, 1:].T), episode.box.nodes)


class Planner:
    """Finds the placement with the highest score in the present state of episodes.

    Parameters
    ----------
    scorer : callable
        Scores the placements.
    stable : bool, default: False
        Whether it prefers placements that disturb nothing (see `StableChoice`).
    """

    def __init__(self, scorer: Scorer, stable: bool = False) -> None:
        self.scorer = scorer
        self._stable = stable
        self._known: WeakKeyDictionary[Episode, _Known] = WeakKeyDictionary()

    def compare(self, episode: Episode) -> ComparedPlacements | None:
        """Find the best placement that agrees with what is already chosen.

        Parameters
        ----------
        episode : Episode
            The episode, at any stage.

        Returns
        -------
        ComparedPlacements or None
            The placements that were compared; None if nothing fits.
        """
        known = self._known.setdefault(episode, _Known())
        placed = tuple(episode.box.placed)
        if placed != known.placed:
            known.advance(episode, placed)
        last = known.last
        if last is None or not _agree(last.found, episode)[last.chosen]:
            known.last = self._compare(episode.visible, known, episode)
            if known.last is None and episode.stage is not Stage.SHAPE:
                # The chosen shape is none of the largest.
                alone = np.arange(len(episode.visible)) == episode.shape
                known.last = self._compare(alone, known, episode)
        return known.last

    def scores(self, episode: Episode) -> ActionScores:
        """Compute the log-probabilities of the stage's actions.

        An action is as likely as the best placement with it; that of the chosen placement, for
        which the agent looks ahead, is e times as likely as any other.

        Parameters
        ----------
        episode : Episode
            The episode, at any stage.

        Returns
        -------
        ActionScores
            The log-probabilities.
        """
        valid = episode.action_mask()
        compared = self.compare(episode)
        if compared is None:
            return by_weight(valid.astype(float))
        agree, actions = _agree(compared.found, episode), compared.actions(episode)
        scores = compared.scores[agree].astype(float)
        weights = np.full(len(valid), UNSCORED)
        np.maximum.at(weights, actions[agree], np.exp(scores - scores.max()))
        weights[actions[compared.chosen]] = np.e
        return by_weight(weights * valid)

    def _compare(
        self, items: npt.NDArray[np.bool_], known: _Known, episode: Episode
    ) -> ComparedPlacements | None:
        while len(found := placements(episode.box, known.space, items)):
            agree = _agree(found, episode)
            if not agree.any():
                break
            scores = self.scorer(found.features)
            order = (n for n in np.argsort(-scores, kind="stable").tolist() if agree[n])
            feasible = (n for n in order if found.is_feasible(n, episode.box))
            if self._stable:
                chosen = known.choice(found, feasible, episode.box)
            else:
                chosen = choose(found, feasible)
            if chosen is not None:
                return ComparedPlacements(found, scores, chosen)
        return None


class _Known:
    """The cache of an episode: the free space, the last comparison, and the cost of foresight."""

    def __init__(self) -> None:
        self.placed: tuple[ItemInBox, ...] | None = None
        self.last: ComparedPlacements | None = None
        self.choice = StableChoice()
        self._spaces: list[tuple[tuple[ItemInBox, ...], FreeSpace]] = []

    @property
    def space(self) -> FreeSpace:
        return self._spaces[-1][1]

    def advance(self, episode: Episode, placed: tuple[ItemInBox, ...]) -> None:
        """Compute the space of the present state from that of an earlier one."""
        while self._spaces and placed[: len(self._spaces[-1][0])] != self._spaces[-1][0]:
            self._spaces.pop()
        if episode.rules.support:  # what the last items support was removed from the space before
            self._spaces.clear()
        if not self._spaces:
            allowed = tuple(episode.rules.allowed_rotations)
            self._spaces.append(
                ((), FreeSpace.empty(episode.task.items, episode.box.cells, allowed))
            )
        before, space = self._spaces[-1]
        if len(before) < len(placed):
            self._spaces.append((placed, space.copy()))
        self.placed, self.last = placed, None


def _agree(found: Placements, episode: Episode) -> npt.NDArray[np.bool_]:
    """Return which placements have the shape, the rotation and the location chosen already."""
    agree = np.ones(len(found), dtype=bool)
    if episode.stage is not Stage.SHAPE:
        agree &= found.items == episode.shape
        if episode.rotation is not None:
            agree &= found.rotations == episode.rotation
        if episode.location is not None:
            agree &= (found.corners[:, 1:] == episode.location).all(axis=1)
    return agree


class PlacementPolicy:
    """One of the three choices of the placement that a network scores highest.

    Parameters
    ----------
    file : Path or str
        The network's weights.
    stable : bool, default: False
        Whether placements that disturb nothing come first, in a box whose items move.
    """

    def __init__(self, file: Path | str, stable: bool = False) -> None:
        self._file = Path(file)
        self._stable = stable
        self._planner = _planner(self._file.resolve(), stable)
        network = self._planner.scorer
        assert isinstance(network, PlacementNetwork)
        self.weights_digest = network.digest

    @classmethod
    def parse(cls, value: str) -> Self:
        """Load the weights of a file.

        Parameters
        ----------
        value : str
            Path of the file.

        Returns
        -------
        Self
            The policy.

        Raises
        ------
        TensorFileError
            If the file can't be loaded.
        """
        return cls(value)

    @property
    def scorer(self) -> Scorer:
        """The network."""
        return self._planner.scorer

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        compared = self._planner.compare(episode)
        if compared is None:
            return int(np.flatnonzero(episode.action_mask())[0])
        return int(compared.actions(episode)[compared.chosen])

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """Compute the log-probabilities of the stage's actions (see `Planner.scores`)."""
        return self._planner.scores(episode)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._file, self._stable)


class PlacedShape(PlacementPolicy):
    """The shape of the placement that a network scores highest, of all shapes outside."""


class PlacedRotation(PlacementPolicy):
    """The rotation of the shape's placement that a network scores highest."""


class PlacedLocation(PlacementPolicy):
    """The location of the shape's placement that a network scores highest."""


@cache
def _planner(file: Path, stable: bool) -> Planner:
    """Share a planner between the three policies of an agent."""
    return Planner(PlacementNetwork.read(file), stable)


_CHAMPION = assets_folder() / "weights" / "champion.safetensors"

_ONLINE_CHAMPION = assets_folder() / "weights" / "online-champion.safetensors"

CHAMPION_SHAPE = partial(PlacedShape, _CHAMPION)
"""The shape that the champion places next, of all outside."""

CHAMPION_ROTATION = partial(PlacedRotation, _CHAMPION)
"""The rotation in which the champion places a shape."""

CHAMPION_LOCATION = partial(PlacedLocation, _CHAMPION)
"""The location at which the champion places a shape."""

STABLE_CHAMPION_SHAPE = partial(PlacedShape, _CHAMPION, stable=True)
"""The champion's shape, of the placements after which the items in the box stay where they are."""

STABLE_CHAMPION_ROTATION = partial(PlacedRotation, _CHAMPION, stable=True)
"""The champion's rotation, of the placements after which the items stay where they are."""

STABLE_CHAMPION_LOCATION = partial(PlacedLocation, _CHAMPION, stable=True)
"""The champion's location, of the placements after which the items stay where they are."""

ONLINE_CHAMPION_SHAPE = partial(PlacedShape, _ONLINE_CHAMPION)
"""The shape that the online champion places next, of all visible ones."""

ONLINE_CHAMPION_ROTATION = partial(PlacedRotation, _ONLINE_CHAMPION)
"""The rotation in which the online champion places a shape."""

ONLINE_CHAMPION_LOCATION = partial(PlacedLocation, _ONLINE_CHAMPION)
"""The location at which the online champion places a shape."""
