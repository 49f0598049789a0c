"""Placements: the items of a packing off the grid, at their poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats

POSE_SLACK = 1e-6
"""Largest relative error of a pose's rotation and scale: rounding of single precision."""

LEAST_SCALE = 1e-30
"""Smallest scale of a pose."""


@dataclass(frozen=True, eq=False)
class Placement:
    """One item of a packing.

    Parameters
    ----------
    type : int
        The number of its type in the packing.
    pose : ndarray of float64, shape (4, 4)
        From the coordinates of the type's mesh to those of the container: a rotation, a translation
        and one scale for all axes, which is 1 in every packing that `nest` finds.
    box : int
        The number of its container, from 0.

    Raises
    ------
    ArgumentError
        If the pose is no such matrix.
    """

    type: int
    pose: Floats
    box: int = 0

    def __post_init__(self) -> None:
        pose = np.array(self.pose, dtype=float)
        fault = pose_fault(pose)
        if fault:
            raise ArgumentError(f"the pose of an item of type {self.type} {fault}")
        pose.setflags(write=False)
        object.__setattr__(self, "pose", pose)

    @property
    def scale(self) -> float:
        """The scale of lengths."""
        return float(np.cbrt(np.linalg.det(self.pose[:3, :3])))


def pose_fault(pose: Floats) -> str | None:
    """Return why a matrix is not a rotation with one scale and a translation, or None.

    Parameters
    ----------
    pose : ndarray of float64
        The matrix.

    Returns
    -------
    str or None
        What is wrong, after "the pose".
    """
    if pose.shape != (4, 4):
        return f"has the shape {pose.shape}: it must be (4, 4)"
    if not np.isfinite(pose).all():
        return "is not finite"
    if pose[3].tolist() != [0, 0, 0, 1]:
        return f"has the last row {pose[3].tolist()}: it must be 0, 0, 0, 1"
    linear = pose[:3, :3]
    largest = np.abs(linear).max()
    if largest < LEAST_SCALE:
        return "leaves nothing of the mesh: its scale is 0"
    linear = linear / largest
    square = linear.T @ linear
    scale = np.trace(square) / 3
    if np.abs(square / scale - np.eye(3)).max() > POSE_SLACK:
        return "shears the mesh, or scales its axes unlike"
    if np.linalg.det(linear) < 0:
        return "mirrors the mesh"
    return None
