"""The choice of a placement after which the items in the box stay where they are."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import Any

from packit_agents.placements.placement_features import MAX_EXAMINED, Placements
from packit_sim.box import BaseBox

MAX_RELEASED = 12
"""Placements that are simulated before one is chosen."""

MAX_DISTURBANCE = 0.9
"""Largest movement of any item after a placement that is stable (see `BaseBox.disturbance`)."""


PIECE_STEPS = 5_000_000
"""Convex pieces times time steps that are simulated for an episode, before a choice has but one
simulation: each choice takes at most half of what is left, and a simulation that it has begun."""


class StableChoice:
    """Chooses the placements of an episode that disturb nothing."""

    def __init__(self) -> None:
        self._left = PIECE_STEPS

    def __call__(self, found: Placements, feasible: Iterable[int], box: BaseBox[Any]) -> int | None:
        """Choose the first stable placement after which all items that are compared still fit.

        Parameters
        ----------
        feasible : iterable of int
            The numbers of feasible placements, the best first. Of the first `MAX_EXAMINED` the
            first `MAX_RELEASED` are simulated, or fewer when `PIECE_STEPS` run out; those after
            which less volume fits come later.
        box : BaseBox
            The box.

        Returns
        -------
        int or None
            The placement. If none is stable, it is the one that moves other items least, and among
            those that don't move them far, the item itself least; None if no placement is feasible.
        """
        movements: dict[int, tuple[float, float]] = {}
        kept = self._left / 2
        for number in itertools.islice(_by_loss(found, feasible), MAX_RELEASED):
            if movements and self._left <= kept:
                break
            placed = found.placed(number)
            limit = min((others for others, _ in movements.values()), default=math.inf)
            moved = box.disturbance(placed.item, placed.location, limit)
            self._left = max(self._left - moved.piece_steps, 0)
            if max(moved.own, moved.others) < MAX_DISTURBANCE:
                return number
            movements[number] = max(moved.others, MAX_DISTURBANCE), moved.own
        return min(movements, key=movements.__getitem__, default=None)


def _by_loss(found: Placements, feasible: Iterable[int]) -> Iterable[int]:
    """Yield first the placements that lose no volume, then the others, the least loss first."""
    others = []
    for number in itertools.islice(feasible, MAX_EXAMINED):
        lost = found.lost(number)
        if lost == 0:
            yield number
        else:
            others.append((lost, number))
    yield from (number for _, number in sorted(others, key=lambda one: one[0]))
