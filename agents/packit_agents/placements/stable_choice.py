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
"""Largest disturbance of a placement that is stable (see `BaseBox.disturbance`)."""


def choose_stable(found: Placements, feasible: Iterable[int], box: BaseBox[Any]) -> int | None:
    """Choose the first stable placement after which all items that are compared still fit.

    Parameters
    ----------
    feasible : iterable of int
        The numbers of feasible placements, the best first. Of the first `MAX_EXAMINED` the first
        `MAX_RELEASED` are simulated; those after which less volume fits come later.
    box : BaseBox
        The box.

    Returns
    -------
    int or None
        The placement. If none is stable, it is the one that disturbs least; None if no placement
        is feasible.
    """
    disturbances: dict[int, float] = {}
    for number in itertools.islice(_by_loss(found, feasible), MAX_RELEASED):
        placed = found.placed(number)
        limit = max(MAX_DISTURBANCE, min(disturbances.values(), default=math.inf))
        disturbances[number] = box.disturbance(placed.item, placed.location, limit)
        if disturbances[number] < MAX_DISTURBANCE:
            return number
    return min(disturbances, key=disturbances.__getitem__, default=None)


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
