"""Turns, moves and places of parts in plain words.

Words for directions are those of somebody in front of the box: its front wall is that at y = 0,
its left wall that at x = 0. A part's own front, left and top are the same sides of its file.
"""

from __future__ import annotations

import math

import numpy as np

from packit_sim.core.choices import Door
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.handling.removal import Route
from packit_sim.parts.handling.sweeps import Direction

_WALLS = {
    (1, 0, 0): "the right wall",
    (-1, 0, 0): "the left wall",
    (0, 1, 0): "the back wall",
    (0, -1, 0): "the front wall",
    (0, 0, 1): "up",
    (0, 0, -1): "down",
}
"""The directions that a side of a part may face."""

_SAME = math.radians(0.5)
"""Angle below which two directions are the same in words."""

_INTO: dict[Direction, str] = {
    "up": "lower it by",
    "+x": "push it to the left by",
    "-x": "push it to the right by",
    "+y": "push it to the front by",
    "-y": "push it to the back by",
    "down": "raise it by",
}
"""The reverse of each move out of the box."""

_ENTRIES: dict[Direction, str] = {
    "up": "Lower it straight down",
    "+x": "Push it in through the right side",
    "-x": "Push it in through the left side",
    "+y": "Push it in through the back",
    "-y": "Push it in through the front",
    "down": "Push it in from below",
}


DOORS: dict[Door, str] = {
    "x-": "through the left side",
    "x+": "through the right side",
    "y-": "through the front",
    "y+": "through the back",
    "z+": "from above",
}
"""The words for the way in through each door."""


def turn_in_words(turn: Floats) -> str:
    """Describe a rotation, from the orientation of a part in its file.

    Parameters
    ----------
    turn : ndarray of float64, shape (3, 3)
        The rotation.

    Returns
    -------
    str
        One or two sentences.
    """
    front, top = -turn[:, 1], turn[:, 2]
    angle = math.acos(min(1.0, max(-1.0, (float(np.trace(turn)) - 1) / 2)))
    if angle < _SAME:
        return "Leave it as it is in its file."
    facing, upwards = _wall(front), _wall(top)
    if upwards == "up":
        yaw = math.degrees(math.atan2(turn[1, 0], turn[0, 0]))
        if abs(abs(yaw) - 180) < math.degrees(_SAME):
            return "Upright, turned half round: its front faces the back wall."
        side = "left (anticlockwise" if yaw > 0 else "right (clockwise"
        text = f"Upright, turned {_degrees(abs(yaw))} to the {side} seen from above)"
        return f"{text}: its front faces {facing}." if facing else f"{text}."
    if upwards == "down":
        return f"Upside down{f'; its front faces {facing}' if facing else ''}."
    if upwards and facing:
        return f"Tipped over: its top faces {upwards}, its front faces {facing}."
    axis = np.array((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
    length = float(np.linalg.norm(axis))
    lean = math.degrees(math.acos(min(1.0, max(-1.0, float(top[2])))))
    text = f"Turned freely, see the pictures: its top leans {_degrees(lean)} from the vertical"
    text += f" towards {_nearest(top * (1, 1, 0))}" if 1 < lean < 179 else ""
    if length > 0.01:
        x, y, z = axis / length
        text += f" (a turn by {_degrees(math.degrees(angle))} about ({x:.2f}, {y:.2f}, {z:.2f}))"
    return f"{text}."


def way_in_words(route: Route, unit: str) -> str:
    """Describe how a part is put in: its route out of the box, reversed.

    Parameters
    ----------
    route : Route
        The route out of the box.
    unit : str
        The unit of length.

    Returns
    -------
    str
        A sentence.
    """
    steps = [_ENTRIES[route.out]]
    steps += [
        f"{_INTO[direction]} {length:.3g} {unit}" for direction, length in reversed(route.moves)
    ]
    return ", then ".join(steps) + "."


def place_in_words(low: Floats, unit: str) -> str:
    """Describe where the lower corner (3,) of a part's bounding box is, from the walls.

    Parameters
    ----------
    low : ndarray of float64, shape (3,)
        The corner, in the box's coordinates.
    unit : str
        The unit of length.

    Returns
    -------
    str
        A sentence.
    """
    x, y, z = (f"{max(0.0, float(side)):.3g} {unit}" for side in low)
    height = "on the floor" if low[2] < 0.005 * max(1.0, float(np.abs(low).max())) else f"{z} up"
    return f"{x} from the left wall, {y} from the front wall, {height}."


def _wall(direction: Floats) -> str | None:
    """Return where a unit vector points to, if it is along an axis."""
    return next(
        (name for axis, name in _WALLS.items() if float(direction @ axis) > math.cos(_SAME)), None
    )


def _nearest(direction: Floats) -> str:
    return max(_WALLS.items(), key=lambda item: float(direction @ item[0]))[1]


def _degrees(angle: float) -> str:
    return f"{angle:.0f}°"
