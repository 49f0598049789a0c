"""Poses: rigid motions, with the conversions that PyBullet and viser need."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from trimesh import transformations

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.rotations import MATRICES

Quaternion = tuple[float, float, float, float]
"""A unit quaternion in the order w, x, y, z, unless its name says `xyzw`."""

UPRIGHT: Quaternion = (1.0, 0.0, 0.0, 0.0)
"""No rotation."""

_UNIT_SLACK = 1e-3
"""Largest error of a unit quaternion's length: others may round what they write."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A rotation followed by a translation.

    Attributes
    ----------
    position : ndarray of float64, shape (3,)
        The translation, in box units.
    wxyz : Quaternion
        The rotation as a unit quaternion w, x, y, z, viser's and trimesh's order.

    Raises
    ------
    ArgumentError
        If it is not a unit quaternion, within `_UNIT_SLACK`.
    """

    position: Floats
    wxyz: Quaternion = UPRIGHT

    def __post_init__(self) -> None:
        length = math.hypot(*self.wxyz)
        if not abs(length - 1) <= _UNIT_SLACK:
            raise ArgumentError(f"a quaternion of length {length:.6g} is no rotation: it must be 1")

    @classmethod
    def from_xyzw(cls, position: Floats, xyzw: Quaternion) -> Pose:
        """Create a pose from a quaternion in PyBullet's order."""
        x, y, z, w = xyzw
        return cls(position, (w, x, y, z))

    @classmethod
    def from_matrix(cls, matrix: Floats, scale: float = 1.0) -> Pose:
        """Create a pose from a (4, 4) matrix.

        Parameters
        ----------
        matrix : ndarray of float64, shape (4, 4)
            A uniform scaling, a rotation and a translation, in this order.
        scale : float, default: 1.0
            The factor by which the matrix scales lengths.

        Returns
        -------
        Pose
            The rotation and the translation.
        """
        return cls.from_axes(matrix[:3, 3], matrix[:3, :3] / scale)

    @classmethod
    def from_axes(cls, position: Floats, axes: Floats) -> Pose:
        """Create a pose from a (3, 3) rotation matrix."""
        w, x, y, z = transformations.quaternion_from_matrix(axes).tolist()
        return cls(position, (w, x, y, z))

    @classmethod
    def from_rotation(cls, position: Floats, rotation: int) -> Pose:
        """Create a pose from the index of one of the 24 rotations."""
        return cls.from_axes(position, MATRICES[rotation])

    @property
    def xyzw(self) -> Quaternion:
        """The rotation as a unit quaternion in PyBullet's order."""
        w, x, y, z = self.wxyz
        return x, y, z, w

    @property
    def axes(self) -> Floats:
        """The rotation as a (3, 3) matrix, whose columns are the rotated axes."""
        return np.asarray(transformations.quaternion_matrix(self.wxyz)[:3, :3])

    def apply(self, points: Floats) -> Floats:
        """Rotate and move points of shape (n, 3)."""
        return points @ self.axes.T + self.position

    def interpolate(self, other: Pose, share: float) -> Pose:
        """Compute the pose between two: straight, and along the shortest rotation.

        Parameters
        ----------
        other : Pose
            The pose at the end.
        share : float
            0 for this pose, 1 for the other.

        Returns
        -------
        Pose
            The pose in between.
        """
        position = (1 - share) * self.position + share * other.position
        w, x, y, z = transformations.quaternion_slerp(self.wxyz, other.wxyz, share).tolist()
        return Pose(position, (w, x, y, z))
