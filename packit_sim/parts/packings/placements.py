"""Placements: the items of a packing off the grid, at their poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_sim.core.checks import POSITIVE, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import IDENTITY, Motion, matrix_fault, motion_and_scale


@dataclass(frozen=True)
class Placement:
    """One item of a packing.

    Parameters
    ----------
    type : int
        The number of its type in the packing.
    pose : Motion
        `container_from_item`: from the coordinates of the type's mesh to those of the container.
    box : int
        The number of its container, from 0.
    scale : float
        The scale of its mesh, before that motion: 1 in every packing that `nest` finds, others in
        files.

    Raises
    ------
    ArgumentError
        If the pose is no finite motion, or the scale is not above 0.
    """

    type: int
    pose: Motion = IDENTITY
    box: int = 0
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.pose, Motion):
            raise ArgumentError(
                f"the pose of an item of type {self.type} is of type {type(self.pose).__name__}: "
                "it must be a Motion; Placement.from_matrix takes matrices"
            )
        if not np.isfinite(self.pose.translation).all():
            raise ArgumentError(f"the pose of an item of type {self.type} is not finite")
        check_range(f"item type {self.type}: scale", self.scale, POSITIVE)

    @classmethod
    def from_matrix(cls, number: int, matrix: Floats, box: int = 0) -> Placement:
        """Create a placement from a matrix of a file.

        Parameters
        ----------
        number : int
            The number of the item's type.
        matrix : ndarray of float64, shape (4, 4)
            One scale for all axes, a rotation and a translation, in this order.
        box : int
            The number of its container.

        Returns
        -------
        Placement
            The placement.

        Raises
        ------
        ArgumentError
            If it is no such matrix.
        """
        matrix = np.array(matrix, dtype=float)
        fault = matrix_fault(matrix)
        if fault:
            raise ArgumentError(f"the pose of an item of type {number} {fault}")
        pose, scale = motion_and_scale(matrix)
        return cls(number, pose, box, scale)

    @property
    def matrix(self) -> Floats:
        """The scale and the pose as one matrix (4, 4), for files."""
        return self.pose.scaled(self.scale)

    def apply(self, points: Floats) -> Floats:
        """Map points (n, 3), or one of shape (3,), of the type's mesh into the container."""
        return self.pose.apply(points * self.scale)
