"""Straight moves of the arm's axes, timed within their limits."""

from __future__ import annotations

import math

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.robot.cell import RobotCell

WRIST = 4.0
"""Radians of the wrist that take as long as a metre of an axis."""

_SCALES = np.array((1.0, 1.0, 1.0, 1 / WRIST))


def straight(start: Floats, end: Floats, cell: RobotCell, step: float) -> Floats:
    """Time a straight move of all axes together.

    Parameters
    ----------
    start : ndarray of float64, shape (4,)
        The joints x, y, z in m and the wrist in radians, as also in `end`.
    step : float
        Time step, s.

    Returns
    -------
    ndarray of float64, shape (n, 4)
        The joints after each step, the last ones at the end. Speed grows and falls evenly.
    """
    length = float(np.linalg.norm((end - start) * _SCALES))
    ramp = min(cell.speed / cell.acceleration, math.sqrt(length / cell.acceleration))
    top = cell.acceleration * ramp
    if length == 0:
        return np.empty((0, 4))
    seconds = length / top + ramp
    times = np.arange(1, math.ceil(seconds / step - 1e-9) + 1) * step
    times = np.minimum(times, seconds)
    left = seconds - times
    gone = np.where(
        times < ramp,
        cell.acceleration * times**2 / 2,
        np.where(left < ramp, length - cell.acceleration * left**2 / 2, top * (times - ramp / 2)),
    )
    return np.asarray(start + (gone / length)[:, None] * (end - start))
