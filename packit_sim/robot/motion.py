"""Motions of an arm's axes along a path, timed within their limits."""

from __future__ import annotations

import math

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.robot.cell import RobotCell

WRIST = 4.0
"""Radians of the gantry's wrist that take as long as a metre of an axis."""

_SCALES = np.array((1.0, 1.0, 1.0, 1 / WRIST, 1 / WRIST))


def straight(start: Floats, end: Floats, cell: RobotCell) -> Floats:
    """Time a straight move of all axes of a gantry together.

    Parameters
    ----------
    start : ndarray of float64, shape (joints,)
        The joints x, y, z in m, the wrist and perhaps the tilt in radians, as also in `end`.

    Returns
    -------
    ndarray of float64, shape (n, joints)
        The joints after each time step, the last ones at the end. Speed grows and falls evenly.
    """
    length = float(np.linalg.norm((end - start) * _SCALES[: len(start)]))
    if length == 0:
        return np.empty((0, len(start)))
    return np.asarray(start + (_gone(length, cell) / length)[:, None] * (end - start))


def along(points: Floats, lengths: Floats, cell: RobotCell) -> Floats:
    """Time a move along a path of any form.

    Parameters
    ----------
    points : ndarray of float64, shape (m, joints)
        Joints along the path.
    lengths : ndarray of float64, shape (m - 1,)
        Metres between two of them: the largest distance by which the tool moves, or, if it takes
        longer, what the cell's speed covers in the time that a joint needs.

    Returns
    -------
    ndarray of float64, shape (n, joints)
        The joints after each time step, the last ones at the end. Speed grows and falls evenly.
    """
    places = np.concatenate(((0.0,), np.cumsum(lengths)))
    if places[-1] == 0:
        return np.empty((0, points.shape[1]))
    gone = _gone(float(places[-1]), cell)
    return np.column_stack([np.interp(gone, places, column) for column in points.T])


def _gone(length: float, cell: RobotCell) -> Floats:
    """Return how far a move of a length > 0 in m has come after each time step, (n,)."""
    step = cell.world.step
    ramp = min(cell.speed / cell.acceleration, math.sqrt(length / cell.acceleration))
    top = cell.acceleration * ramp
    seconds = length / top + ramp
    times = np.arange(1, math.ceil(seconds / step - 1e-9) + 1) * step
    times = np.minimum(times, seconds)
    left = seconds - times
    return np.where(
        times < ramp,
        cell.acceleration * times**2 / 2,
        np.where(left < ramp, length - cell.acceleration * left**2 / 2, top * (times - ramp / 2)),
    )
