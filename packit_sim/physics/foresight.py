"""Foresight: how far items will move after one more is released among them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from packit_sim.box import Disturbance
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import Contents, PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.geometry.motions import Motion
from packit_sim.physics.convex.pieces import Piece
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.physics.settling import masses
from packit_sim.physics.world import World

SECONDS = 1.0
"""Simulated time after a release within which items show how far they will move."""

_CHECK = 10
"""Time steps between two checks how far items have moved."""

_STILL_CHECKS = 3
"""Checks in which items that have come to rest do not move: an eighth of a second by default."""

_STILL = 0.005
"""Largest change of a movement in these checks."""

_PATIENCE = 0.5
"""Simulated time before items can have come to rest: what topples begins slowly."""

Movement = Callable[[PosedItem, PosedItem], float]
"""Measures how far an item has moved from one pose to another."""


def foreseen_movement(
    box: Contents[PosedItem],
    pieces: Sequence[Sequence[Piece]],
    settings: PhysicsSettings,
    movement: Movement,
    origins: Sequence[PosedItem],
    limit: float = math.inf,
    arm_gap: float | None = None,
) -> Disturbance:
    """Release all items at once, and see how far the last one and the others move.

    Parameters
    ----------
    box : Contents
        The items, which start without speed.
    pieces : sequence of sequence of Piece
        The convex pieces of each, fitted in between those of the others.
    movement : callable
        Measures how far an item has moved, as a number to compare with `limit`.
    origins : sequence of PosedItem
        From where the movements of the others count.
    limit : float
        A movement of another item after which the simulation ends early.
    arm_gap : float, optional
        How far above its place an arm releases the last item, in box units; None without an arm.

    Returns
    -------
    Disturbance
        The movements at the end: once another item's is above the limit, no item moves any more, or
        `SECONDS` are over.
    """
    *others, placed = box.placed
    lift = Motion.shift((0.0, 0.0, arm_gap or 0.0))
    released = (*others, placed.moved(lift))
    starts = (*origins, placed)
    seen: list[Floats] = []
    with World(np.array(box.cells) * CELL, settings) as world:
        *each_mass, own_mass = masses(box, settings)
        for own, mass in zip(pieces[:-1], each_mass, strict=True):
            world.add(own, mass)
        lifted = [piece.moved(lift.rotation, lift.translation) for piece in pieces[-1]]
        world.add(lifted, own_mass, carried=arm_gap is not None)
        interval = settings.step * _CHECK
        for _ in range(math.ceil(SECONDS / interval)):
            for _ in range(_CHECK):
                world.step()
            each = zip(starts, released, world.moves, strict=True)
            seen.append(np.array([movement(start, now.moved(move)) for start, now, move in each]))
            if seen[-1][:-1].max(initial=0.0) > limit:
                break
            if len(seen) <= max(_STILL_CHECKS, _PATIENCE / interval):
                continue
            if np.abs(seen[-1] - seen[-1 - _STILL_CHECKS]).max() < _STILL:
                break
    return Disturbance(
        own=float(seen[-1][-1]),
        others=float(seen[-1][:-1].max(initial=0.0)),
        piece_steps=sum(map(len, pieces)) * _CHECK * len(seen),
    )
