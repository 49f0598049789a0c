"""Recordings of what an arm and the items did, step by step."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from packit_sim.geometry.arrays import Floats

MOVED = 1e-5
"""Box units, or parts of a unit quaternion, by which a body has moved when it is recorded anew."""


@dataclass(frozen=True, eq=False)
class Recording:
    """The attempt to put one item into the box, at each time step.

    Attributes
    ----------
    joints : ndarray of float64, shape (steps, joints)
        Where the arm's joints are, in m and radians.
    held : tuple of int
        The first step at which the tool holds the item, and the first after that.
    radius : float
        The radius of the cup, m; 0 if there is no grasp.
    rows : ndarray of int64, shape (n, 2)
        The step and the item of each recorded pose: the number of the item among those of the task
        that were tried. An item stays where it was recorded last.
    poses : ndarray of float64, shape (n, 7)
        Position in box units and quaternion w, x, y, z of the canonical shape.
    """

    joints: Floats = field(default_factory=lambda: np.empty((0, 4)))
    held: tuple[int, int] = (0, 0)
    radius: float = 0.0
    rows: npt.NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    poses: Floats = field(default_factory=lambda: np.empty((0, 7)))
