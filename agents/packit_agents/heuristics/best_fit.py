"""Policies that choose the tightest placement of all visible shapes, rotations and locations.

An item *rests* at a location if it is the lowest feasible one above its node (x, y): where it stops
on its way down in a kinematic box. The best fit is the resting location with the most contact,
counted as by `MaximalContact`; ties go to the first in (z, x, y), then to the first rotation in the
order of alignment, then to the first shape.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from packit_agents.heuristics.action_scores import ActionScores, by_weight
from packit_agents.heuristics.contacts import Neighbours, by_contacts
from packit_sim.game.episodes.episode import Episode
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask


class _Fit(NamedTuple):
    """A placement; the least is the best."""

    less_contact: int
    height: int
    x: int
    y: int
    rotation: int

    @property
    def location(self) -> Triple:
        return self.x, self.y, self.height


@dataclass(frozen=True)
class BestFitShape:
    """The shape with the best fit among all valid shapes and allowed rotations (ours).

    If no shape fits, the first is chosen. Equal shapes are tried once. It takes a mask for each
    shape and rotation: a millisecond each in a small box.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        valid = np.flatnonzero(episode.action_mask()).tolist()
        if len(valid) == 1:
            return int(valid[0])
        fits = _by_shape(episode, valid)
        return min(fits, key=fits.__getitem__) if fits else int(valid[0])

    def scores(self, episode: Episode, rng: np.random.Generator) -> ActionScores:
        """Make each shape as likely as the contact of its best fit; at least 1 if it is valid."""
        valid = episode.action_mask()
        weights = valid.astype(float)
        for n, fit in _by_shape(episode, np.flatnonzero(valid).tolist()).items():
            weights[n] = max(1, -fit.less_contact)
        return by_weight(weights)


@dataclass(frozen=True)
class BestFitRotation:
    """The rotation with the best fit among the valid ones (ours).

    If the shape fits in no rotation, it is the choice of `Aligned`. If the location is chosen
    first, it is the rotation with the most contact there.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        assert episode.shape is not None
        item, valid = episode.task.items[episode.shape], episode.action_mask()
        ranked = [turned for turned in episode.rules.by_alignment(item) if valid[turned.rotation]]
        found = _best(episode, ranked)
        return ranked[0].rotation if found is None else found.rotation


@dataclass(frozen=True)
class BestFitLocation:
    """The resting location with the most contact (ours).

    If the location is chosen before the rotation, it is that of the best fit in any rotation.
    """

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        choice = episode.chosen_item
        assert choice is not None
        any_rotation = episode.rotation is None
        items = episode.rules.by_alignment(choice.item) if any_rotation else (choice.item,)
        found = _best(episode, items)
        assert found is not None
        return int(np.ravel_multi_index(found.location, episode.box.nodes))


def resting(mask: Mask) -> Mask:
    """Restrict a mask [x, y, z] of locations to the lowest one of each column."""
    return mask & (np.cumsum(mask, axis=2) == 1)


def _by_shape(episode: Episode, valid: Iterable[int]) -> dict[int, _Fit]:
    """Find the best fit of each of some shapes, without equal ones and those that do not fit."""
    found: dict[int, _Fit] = {}
    known = set()
    for n in valid:
        item = episode.task.items[n]
        if item.key in known:
            continue
        known.add(item.key)
        fit = _best(episode, episode.rules.by_alignment(item))
        if fit is not None:
            found[n] = fit
    return found


def _best(episode: Episode, items: Iterable[Item]) -> _Fit | None:
    """Find the best fit of an item in some rotations, at the chosen location if there is one."""
    filled = Neighbours.of(episode.box.outer_words)
    best: _Fit | None = None
    for item in items:
        if episode.location is None:
            mask = resting(episode.box.feasible(item))
        else:
            mask = np.zeros(episode.box.nodes, dtype=bool)
            mask[episode.location] = True
        if not mask.any():
            continue
        contacts, (i, j, k) = next(by_contacts(filled, item, mask))
        fit = _Fit(-contacts, k, i, j, item.rotation)
        if best is None or fit[:4] < best[:4]:
            best = fit
    return best
