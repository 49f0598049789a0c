"""Cameras: from where a picture is taken, and where a point of the box ends up in it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from packit_sim.core.errors import ArgumentError

Points = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """Where a picture is taken from: as near as fits whole what it shows, a box or items.

    azimuth: degrees about z from +x, the default looks at the origin's corner from across the box.
    elevation: degrees above the floor. fov: vertical opening angle in degrees. margin: share of
    the picture's half that stays free on each side. Raises ValueError where one is out of range.
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
            value = getattr(self, name)
            if not low < value < high:
                raise ArgumentError(f"camera {name} {value!r} must be between {low} and {high}")

    @property
    def toward(self) -> Points:
        """(3,) unit vector from what the camera looks at to the camera."""
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
        """(3,) unit vector to the right of the picture."""
        azimuth = math.radians(self.azimuth)
        return np.array((-math.sin(azimuth), math.cos(azimuth), 0.0))

    @property
    def up(self) -> Points:
        """(3,) unit vector to the upper edge of the picture."""
        return np.cross(self.toward, self.right)

    def eye(self, points: Points, aspect: float, center: Points | None = None) -> Points:
        """(3,) where the camera stands, in box units, to have points (n, 3) in the picture.

        It looks at the centre (3,), or by default past whatever brings it nearest to the points.
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
        """(3, 4): takes a point (x, y, z, 1) of the box to (column, row, 1) times its depth.

        Columns and rows are in pixels from the upper left corner of the picture.
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
"""Of the wall where y is largest; the camera sees a little of what lies on top."""

TOP = Camera(azimuth=90.0, elevation=89.9, fov=20.0)
"""From above, the front at the lower edge."""

CAMERAS = {"iso": ISO, "front": FRONT, "top": TOP}
"""The cameras that have a name."""


def turntable(views: int, camera: Camera = ISO) -> tuple[Camera, ...]:
    """So many cameras on a circle about the box, evenly, from the given one on."""
    return tuple(replace(camera, azimuth=camera.azimuth + 360 * n / views) for n in range(views))
