"""Foresight: how far items will move after one more is released among them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from packit_sim.geometry.items import Contents, PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.settling import fitted_pieces, masses
from packit_sim.physics.world import World

SECONDS = 1.0
"""Simulated time after a release within which items show how far they will move."""

_CHECK = 10
"""Time steps between two checks how far items have moved."""

_STILL_CHECKS = 3
"""Checks in which items that have come to rest do not move: an eighth of a second by default."""

_STILL = 0.02
"""Largest change of a movement in these checks. Items that begin to topple move by more: from rest,
an acceleration of 0.5% of gravity is enough in a box of 0.3 m."""

Movement = Callable[[PosedItem, PosedItem], float]
"""Measures how far an item has moved from one pose to another."""


def foreseen_movement(
    box: Contents[PosedItem],
    settings: PhysicsSettings,
    movement: Movement,
    limit: float = math.inf,
) -> float:
    """Release all items at once, and see how far one moves.

    Parameters
    ----------
    box : Contents
        The items, which start without speed. Several calls in which only the last one differs
        share the work on the others.
    movement : callable
        Measures how far an item has moved, as a number to compare with `limit`.
    limit : float
        A movement after which the simulation ends early.

    Returns
    -------
    float
        The largest movement at the end: once it is above the limit, no item moves any more, or
        `SECONDS` are over.
    """
    pieces, _ = fitted_pieces(box.placed, settings)
    seen = [np.zeros(len(pieces))]
    with World(np.array(box.cells) * CELL, settings) as world:
        for own, mass in zip(pieces, masses(box, settings), strict=True):
            world.add(own, mass)
        for _ in range(math.ceil(SECONDS / (settings.step * _CHECK))):
            for _ in range(_CHECK):
                world.step()
            both = zip(box.placed, world.moves, strict=True)
            seen.append(np.array([movement(start, start.moved(move)) for start, move in both]))
            if seen[-1].max() > limit:
                break
            earlier = seen[max(len(seen) - 1 - _STILL_CHECKS, 0)]
            if len(seen) > _STILL_CHECKS and np.abs(seen[-1] - earlier).max() < _STILL:
                break
    return float(seen[-1].max())
