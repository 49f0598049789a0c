"""Cameras: viewpoints, and the projection of points of the box to pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from packit_sim.core.checks import Range, check_range

Points = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A viewing direction; the distance follows from the content of the picture.

    Parameters
    ----------
    azimuth : float
        Degrees about z from +x. The default looks at the origin's corner from across the box.
    elevation : float
        Degrees above the floor, between -90 and 90.
    fov : float
        Vertical opening angle in degrees, between 0 and 180.
    margin : float
        Share of half the picture that stays free on each side, between -1 and 1.

    Raises
    ------
    ArgumentError
        If a parameter is out of range.

    Examples
    --------
    >>> from packit_sim import TOP, Box, Look, Scene
    >>> with Scene(Box()) as scene:
    ...     picture = scene.snapshot(64, 64, Look(camera=TOP))
    >>> picture.image.shape
    (64, 64, 3)
    >>> TOP.toward.round(2).tolist()  # from the box to the camera
    [0.0, 0.0, 1.0]
    """

    azimuth: float = 62.0
    elevation: float = 24.0
    fov: float = 28.0
    margin: float = 0.05

    def __post_init__(self) -> None:
        for name, low, high in (
            ("azimuth", -math.inf, math.inf),
            ("elevation", -90, 90),
            ("fov", 0, 180),
            ("margin", -1, 1),
        ):
            check_range(f"camera {name}", getattr(self, name), Range(low, high, "()"))

    @property
    def toward(self) -> Points:
        """Unit vector (3,) from the point that the camera looks at to the camera."""
        azimuth, elevation = math.radians(self.azimuth), math.radians(self.elevation)
        return np.array(
            (
                math.cos(elevation) * math.cos(azimuth),
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
            )
        )

    @property
    def right(self) -> Points:
        """Unit vector (3,) to the right of the picture."""
        azimuth = math.radians(self.azimuth)
        return np.array((-math.sin(azimuth), math.cos(azimuth), 0.0))

    @property
    def up(self) -> Points:
        """Unit vector (3,) to the upper edge of the picture."""
        return np.cross(self.toward, self.right)

    def eye(self, points: Points, aspect: float, center: Points | None = None) -> Points:
        """Compute the nearest position from which the picture contains all points.

        Parameters
        ----------
        points : Points
            Array of shape (n, 3), in box units.
        aspect : float
            Width over height of the picture.
        center : Points | None
            The point that the camera looks at, of shape (3,); by default the one with the nearest
            position.

        Returns
        -------
        Points
            The camera's position, of shape (3,), in box units.
        """
        reach = math.tan(math.radians(self.fov) / 2) * (1 - self.margin)
        depth = points @ self.toward
        eye, distance = np.zeros(3), -math.inf
        for axis, slope in ((self.right, reach * aspect), (self.up, reach)):
            high = float((points @ axis + slope * depth).max())
            low = float((points @ axis - slope * depth).min())
            middle = (low + high) / 2 if center is None else float(center @ axis)
            eye += middle * axis
            distance = max(distance, (high - middle) / slope, (middle - low) / slope)
        return eye + distance * self.toward

    def projection(self, eye: Points, width: int, height: int) -> Points:
        """Compute the projection from the box to pixels.

        Parameters
        ----------
        eye : Points
            The camera's position, of shape (3,), in box units.
        width : int
            Pixels.
        height : int
            Pixels.

        Returns
        -------
        Points
            A (3, 4) matrix that maps a point (x, y, z, 1) of the box to (column, row, 1) times its
            depth, counted from the upper left corner of the picture.
        """
        focal = height / 2 / math.tan(math.radians(self.fov) / 2)
        depth = -self.toward
        rows = np.stack(
            (
                focal * self.right + width / 2 * depth,
                -focal * self.up + height / 2 * depth,
                depth,
            )
        )
        return np.column_stack((rows, -rows @ eye))


ISO = Camera()
FRONT = Camera(azimuth=90.0, elevation=4.0, fov=20.0)
"""A view of the wall where y is largest, and a little of the top."""

TOP = Camera(azimuth=90.0, elevation=89.9, fov=20.0)
"""A view from above, with the front at the lower edge."""

CAMERAS = {"iso": ISO, "front": FRONT, "top": TOP}
"""Cameras by name."""


def turntable(views: int, camera: Camera = ISO) -> tuple[Camera, ...]:
    """Return `views` cameras, evenly spaced on a circle about the box, the given one first."""
    return tuple(replace(camera, azimuth=camera.azimuth + 360 * n / views) for n in range(views))
