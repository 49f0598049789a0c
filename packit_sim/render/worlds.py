"""The interface of renderers: static bodies that are moved, painted and drawn."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import trimesh

from packit_sim.geometry.motions import Motion
from packit_sim.render.cameras import Camera, Points
from packit_sim.render.coloring import Color

LIGHT = (0.35, 0.6, 1.0)
"""Direction of the light, in the box's axes."""

AMBIENT, DIFFUSE = 0.5, 0.6
"""Brightness without light, and of a surface that faces the light in addition."""


class View(NamedTuple):
    """A camera in its place, in box units.

    Attributes
    ----------
    camera : Camera
        Its direction and opening angle.
    eye : ndarray of float64, shape (3,)
        Its position.
    near, far : float
        Distances of the clipping planes.
    """

    camera: Camera
    eye: Points
    near: float
    far: float


class Pixels(NamedTuple):
    """A renderer's output.

    Attributes
    ----------
    rgba : ndarray of uint8, shape (H, W, 4)
        The colours.
    depth : ndarray of float32, shape (H, W)
        The depth buffer: 0 at the near plane, 1 at the far one.
    bodies : ndarray of int32, shape (H, W)
        The number of the body, -1 where there is none.
    """

    rgba: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    bodies: npt.NDArray[np.int32]


class DrawnWorld(Protocol):
    """A world of static bodies that can be drawn."""

    @property
    def renderer(self) -> str:
        """The name of the renderer."""

    @property
    def triangles(self) -> int:
        """Triangles of all visual shapes that were added, also of removed bodies."""

    def add_visual(self, mesh: trimesh.Trimesh, scale: float, color: Color) -> int:
        """Add a visual shape, a mesh in box units scaled in volume, and return its number."""

    def add_body(self, visual: int, pose: Motion) -> int:
        """Add a body of a visual shape and return its number."""

    def remove(self, body: int) -> None:
        """Remove a body."""

    def move(self, body: int, pose: Motion) -> None:
        """Set the pose of a body."""

    def paint(self, body: int, color: Color) -> None:
        """Set the colour of a body."""

    def camera_image(self, view: View, width: int, height: int) -> Pixels:
        """Draw the world in (height, width) pixels."""

    def close(self) -> None:
        """Free everything; calling it again does nothing."""
