"""How the station presents items: where, and at level 2 in which stable pose."""

from __future__ import annotations

import math

import numpy as np

from packit_sim.core.caches import bounded_cache
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import BoxState, PosedItem
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item
from packit_sim.physics.settling import settle
from packit_sim.robot.cell import Cells, RobotCell

JITTER = 0.05
"""Metres by which the position of an item at the station varies."""

RESTING_BUDGET = 10_000
"""Cached rotations in which items rest."""

_TABLE = 300
"""Sides of the walled table on which items come to rest, in cells."""

_FALL = 0.02
"""Box units above the table from which they fall."""


def presented(planned: PosedItem, cell: RobotCell, cells: Cells, number: int) -> PosedItem:
    """Return where the station presents an item, at a random yaw and position.

    Parameters
    ----------
    planned : PosedItem
        Where it is to be released.
    number : int
        The number of items that were tried before: it chooses the random numbers.

    Returns
    -------
    PosedItem
        The item on the table, at level 1 in the rotation in which it is to be released, at level 2
        in the one of `resting_rotation`.
    """
    rng = np.random.default_rng((cell.seed, number))
    yaw = rng.uniform(-math.pi, math.pi)
    x, y = (cell.station(cells)[:2] + rng.uniform(-JITTER, JITTER, 2)) / cell.edge
    cosine, sine = math.cos(yaw), math.sin(yaw)
    rotation = np.array(((cosine, -sine, 0), (sine, cosine, 0), (0, 0, 1)))
    turn = Motion(rotation @ turn_at_pick(planned.item, planned.pose.rotation, cell))
    lowest = turn.direction(planned.vertices - planned.center)[:, 2].min()
    about = turn.at(np.array((x, y, -lowest)) - turn.direction(planned.center))
    return planned.moved(about)


def turn_at_pick(item: Item, rotation: Floats, cell: RobotCell) -> Floats:
    """Return the rotation (3, 3) from placement to presentation, without the random yaw.

    Parameters
    ----------
    rotation : ndarray of float64, shape (3, 3)
        Rotation of the canonical shape where it is placed.

    Returns
    -------
    ndarray of float64, shape (3, 3)
        The rotation; at level 1 none.
    """
    if cell.level == 1:
        return np.eye(3)
    turn: Floats = resting_rotation(item, cell) @ rotation.T
    return turn


@bounded_cache(
    "resting",
    RESTING_BUDGET,
    "rotations",
    size=lambda rotation: 1,
    key=lambda item, cell: (item.turned(0).key, cell.seed, cell.world),
)
def resting_rotation(item: Item, cell: RobotCell) -> Floats:
    """Let an item fall onto a table in a random rotation, and return the one in which it rests.

    Parameters
    ----------
    cell : RobotCell
        Its seed and the shape choose the random rotation.

    Returns
    -------
    ndarray of float64, shape (3, 3)
        Rotation of the canonical shape.
    """
    rng = np.random.default_rng((cell.seed, *item.shape.id.encode()))
    quaternion = rng.normal(size=4)
    w, x, y, z = (quaternion / np.linalg.norm(quaternion)).tolist()
    start = PosedItem.at(item.turned(0), Motion.from_wxyz((w, x, y, z), np.zeros(3)))
    middle, lowest = _TABLE / 200, float(start.bounds[0, 2])
    start = start.moved(Motion.shift((middle, middle, _FALL - lowest)))
    (rested,) = settle(BoxState((_TABLE, _TABLE, _TABLE), (start,)), cell.world).items
    return rested.posed.pose.rotation
