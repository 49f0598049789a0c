"""Rigid motions, with the conversions that PyBullet, viser and files need."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from trimesh import transformations

from packit_sim.core.caches import cached_property
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.rotations import MATRICES

Quaternion = tuple[float, float, float, float]
"""A unit quaternion in the order w, x, y, z, unless its name says `xyzw`."""

ROTATION_SLACK = 1e-6
"""Largest error of a rotation matrix: rounding of single precision."""

MIN_SCALE = 1e-30
"""Smallest scale of a matrix."""

UNIT_SLACK = 1e-3
"""Largest error of a unit quaternion's length: others may round what they write."""

_SAME_SCALE = 1e-12
"""Scales that differ from 1 by less are 1: rounding of double precision."""

_EYE = np.eye(4)


@dataclass(frozen=True, eq=False)
class Motion:
    """A rotation followed by a translation; it can't be changed.

    A variable says which motion it is: `box_from_item` maps the item's coordinates to the box's,
    and `box_from_item @ item_from_file` those of the file.

    Parameters
    ----------
    rotation : ndarray of float64, shape (3, 3)
        The rotation, whose columns are the rotated axes. It is kept as it is: quarter turns are
        exact.
    translation : ndarray of float64, shape (3,)
        The translation.

    Attributes
    ----------
    matrix : ndarray of float64, shape (4, 4)
        Both as one matrix.

    Raises
    ------
    ArgumentError
        If the matrix is no rotation, within 10 times `ROTATION_SLACK`: errors add up.
    """

    rotation: Floats = field(default_factory=lambda: np.eye(3))
    translation: Floats = field(default_factory=lambda: np.zeros(3))
    _wxyz: Quaternion | None = field(default=None, repr=False)
    matrix: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        matrix = affine(self.rotation, self.translation)
        matrix.setflags(write=False)
        rotation, translation = split(matrix)
        if not _is_rotation(rotation, 10 * ROTATION_SLACK):
            raise ArgumentError(f"{rotation.tolist()} is no rotation matrix")
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def from_matrix(cls, matrix: Floats, scale: float = 1.0) -> Motion:
        """Create a motion from a (4, 4) matrix.

        Parameters
        ----------
        matrix : ndarray of float64, shape (4, 4)
            A uniform scaling, a rotation and a translation, in this order.
        scale : float, default: 1.0
            The factor by which the matrix scales lengths.

        Returns
        -------
        Motion
            The rotation and the translation.
        """
        linear, translation = split(matrix)
        return cls(linear / scale, translation)

    @classmethod
    def from_wxyz(cls, wxyz: Quaternion, translation: Floats | None = None) -> Motion:
        """Create a motion from a quaternion, which it keeps.

        Parameters
        ----------
        wxyz : Quaternion
            The rotation, in viser's and trimesh's order.
        translation : ndarray of float64, shape (3,), optional
            The translation.

        Returns
        -------
        Motion
            The motion.

        Raises
        ------
        ArgumentError
            If it is not a unit quaternion, within `UNIT_SLACK`.
        """
        length = math.hypot(*wxyz)
        if not abs(length - 1) <= UNIT_SLACK:
            raise ArgumentError(f"a quaternion of length {length:.6g} is no rotation: it must be 1")
        rotation, _ = split(transformations.quaternion_matrix(wxyz))
        return cls(rotation, np.zeros(3) if translation is None else translation, wxyz)

    @classmethod
    def from_xyzw(cls, xyzw: Quaternion, translation: Floats | None = None) -> Motion:
        """Create a motion from a quaternion in PyBullet's order."""
        x, y, z, w = xyzw
        return cls.from_wxyz((w, x, y, z), translation)

    @classmethod
    def turn(cls, rotation: int, translation: Floats | None = None) -> Motion:
        """Create a motion from the index of one of the 24 rotations."""
        return cls(MATRICES[rotation], np.zeros(3) if translation is None else translation)

    @classmethod
    def shift(cls, translation: npt.ArrayLike) -> Motion:
        """Create a motion without a rotation."""
        return cls(np.eye(3), np.asarray(translation, dtype=float))

    @cached_property
    def wxyz(self) -> Quaternion:
        """The rotation as a unit quaternion w, x, y, z; the given one if there is one."""
        if self._wxyz is not None:
            return self._wxyz
        w, x, y, z = transformations.quaternion_from_matrix(self.rotation).tolist()
        return w, x, y, z

    @property
    def xyzw(self) -> Quaternion:
        """The rotation as a unit quaternion in PyBullet's order."""
        w, x, y, z = self.wxyz
        return x, y, z, w

    @property
    def angle(self) -> float:
        """The angle of the rotation, in degrees."""
        turn = self.rotation
        twice_sine = np.linalg.norm((turn - turn.T)[(0, 0, 1), (1, 2, 2)])
        return math.degrees(math.atan2(float(twice_sine), float(np.trace(turn)) - 1))

    def scaled(self, scale: float) -> Floats:
        """Return the matrix (4, 4) of a uniform scaling followed by the motion."""
        return affine(self.rotation * scale, self.translation)

    def __matmul__(self, first: Motion) -> Motion:
        """Return the motion that does another one first, and then this one."""
        return Motion.from_matrix(self.matrix @ first.matrix)

    def inverse(self) -> Motion:
        """Return the motion back."""
        # not the transposed matrix: a rotation of single precision is orthogonal to 1e-7 only
        back = np.asarray(np.linalg.inv(self.rotation), dtype=np.float64)
        return Motion(back, -(back @ self.translation))

    def seen_from(self, other: Motion) -> Motion:
        """Return `other.inverse() @ self`, with less rounding far from the origin."""
        back = np.linalg.inv(other.rotation)
        return Motion(back @ self.rotation, back @ (self.translation - other.translation))

    def apply(self, points: Floats) -> Floats:
        """Rotate and move points of shape (n, 3), or one of shape (3,)."""
        return self.direction(points) + self.translation

    def direction(self, vectors: Floats) -> Floats:
        """Rotate vectors of shape (n, 3), or one of shape (3,); they have no place."""
        return self.rotation @ vectors if vectors.ndim == 1 else vectors @ self.rotation.T

    def at(self, translation: Floats) -> Motion:
        """Return the motion with the same rotation and another translation."""
        return Motion(self.rotation, translation, self._wxyz)

    def shifted(self, shift: npt.ArrayLike) -> Motion:
        """Return the motion followed by a translation."""
        return self.at(self.translation + np.asarray(shift, dtype=float))

    def interpolate(self, other: Motion, share: float) -> Motion:
        """Compute the motion between two: straight, and along the shortest rotation.

        Parameters
        ----------
        other : Motion
            The motion at the end.
        share : float
            0 for this motion, 1 for the other.

        Returns
        -------
        Motion
            The motion in between.
        """
        translation = (1 - share) * self.translation + share * other.translation
        w, x, y, z = transformations.quaternion_slerp(self.wxyz, other.wxyz, share).tolist()
        return Motion.from_wxyz((w, x, y, z), translation)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Motion):
            return NotImplemented
        return np.array_equal(self.matrix, other.matrix)

    def __hash__(self) -> int:
        return hash((self.matrix + 0.0).tobytes())


def affine(linear: Floats, translation: Floats) -> Floats:
    """Return the matrix (4, 4) of a linear map (3, 3) followed by a translation (3,)."""
    matrix = _EYE.copy()
    matrix[:3, :3] = linear
    matrix[:3, 3] = translation
    return matrix


def split(matrix: Floats) -> tuple[Floats, Floats]:
    """Return the linear map (3, 3) and the translation (3,) of a matrix (4, 4), as views."""
    return np.asarray(matrix[:3, :3]), np.asarray(matrix[:3, 3])


def _is_rotation(matrix: Floats, slack: float) -> bool:
    """Decide whether a matrix (3, 3) is a rotation, in plain numbers: motions are made often."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return (
        abs(a * a + d * d + g * g - 1) <= slack
        and abs(b * b + e * e + h * h - 1) <= slack
        and abs(c * c + f * f + i * i - 1) <= slack
        and abs(a * b + d * e + g * h) <= slack
        and abs(a * c + d * f + g * i) <= slack
        and abs(b * c + e * f + h * i) <= slack
        and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    )


IDENTITY = Motion()
"""No motion: where something is whose frame is that of its surroundings."""


def motion_and_scale(matrix: Floats) -> tuple[Motion, float]:
    """Split a matrix of a file into a motion and the scale that precedes it.

    Parameters
    ----------
    matrix : ndarray of float64, shape (4, 4)
        The matrix, without a `matrix_fault`.

    Returns
    -------
    motion : Motion
        The rotation and the translation.
    scale : float
        The scale of lengths.
    """
    scale = float(np.cbrt(np.linalg.det(split(matrix)[0])))
    if abs(scale - 1) < _SAME_SCALE:
        scale = 1.0
    return Motion.from_matrix(matrix, scale), scale


def matrix_fault(matrix: Floats) -> str | None:
    """Return why a matrix is not a rotation with one scale and a translation, or None.

    Returns
    -------
    str or None
        What is wrong, after "the pose".
    """
    if matrix.shape != (4, 4):
        return f"has the shape {matrix.shape}: it must be (4, 4)"
    if not np.isfinite(matrix).all():
        return "is not finite"
    if matrix[3].tolist() != [0, 0, 0, 1]:
        return f"has the last row {matrix[3].tolist()}: it must be 0, 0, 0, 1"
    linear, _ = split(matrix)
    largest = np.abs(linear).max()
    if largest < MIN_SCALE:
        return "leaves nothing of the mesh: its scale is 0"
    linear = linear / largest
    square = linear.T @ linear
    scale = np.trace(square) / 3
    if np.abs(square / scale - np.eye(3)).max() > ROTATION_SLACK:
        return "shears the mesh, or scales its axes unlike"
    if np.linalg.det(linear) < 0:
        return "mirrors the mesh"
    return None
