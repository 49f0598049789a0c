"""The box as panes of glass, drawn over a picture of its contents."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from packit_sim.render.cameras import Camera, Points

Reals = npt.NDArray[np.floating]

_SAMPLES = 2
"""Samples along each side of a pixel, which make edges smooth."""

_GLASS = (120, 160, 205)
_INK = (64, 74, 92)
_FRONT, _BACK = (26, 200), (34, 110)
"""Opacity of panes and of edges, 0 to 255: on the side of the camera, and on the far side."""


@dataclass(frozen=True, eq=False)
class Ghost:
    """The panes of a box as a camera sees them.

    Parameters
    ----------
    size : Points
        Extents of the box, of shape (3,), in box units.
    eye : Points
        The camera's position, of shape (3,), in box units.
    width : int
        Pixels.
    height : int
        Pixels.
    """

    size: Points
    camera: Camera
    eye: Points
    width: int
    height: int

    def behind(self, background: tuple[int, int, int]) -> Reals:
        """Draw the panes on the far side over a background: (H, W, 3), 0 to 255."""
        image = np.full((self.height, self.width, 3), background, dtype=np.float32)
        for axis, side in self._panes(facing=False):
            image = _over(image, *self._pane(axis, side, *_BACK))
        return image

    def before(self, image: Reals, depth: npt.NDArray[np.float32]) -> Reals:
        """Draw the panes on the camera's side over a picture, except where it is nearer.

        Parameters
        ----------
        image : Reals
            The picture, of shape (H, W, 3), 0 to 255.
        depth : npt.NDArray[np.float32]
            Depths of the picture, of shape (H, W), in box units, inf where there is nothing.

        Returns
        -------
        Reals
            The picture with panes, of shape (H, W, 3), 0 to 255.
        """
        for axis, side in self._panes(facing=True):
            color, alpha = self._pane(axis, side, *_FRONT)
            nearer = depth < self._depth(axis, side) - 1e-3
            image = _over(image, color, np.where(nearer, 0.0, alpha))
        return image

    def _panes(self, facing: bool) -> Iterator[tuple[int, int]]:
        """Yield the axis and the side (0 low, 1 high) of panes that face the camera, or do not."""
        for axis in range(3):
            for side in (0, 1):
                ahead = (2 * side - 1) * (self.eye[axis] - side * self.size[axis])
                if (ahead > 0) == facing:
                    yield axis, side

    def _pane(self, axis: int, side: int, fill: int, edge: int) -> tuple[Reals, Reals]:
        """Draw a pane: colour (H, W, 3) and opacity (H, W), 0 to 1."""
        corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
        corners = np.insert(corners, axis, side, axis=1) * self.size
        projection = self.camera.projection(self.eye, self.width, self.height)
        seen = np.column_stack((corners, np.ones(4))) @ projection.T
        outline = [tuple(point) for point in (seen[:, :2] / seen[:, 2:] * _SAMPLES).tolist()]
        image = Image.new("RGBA", (self.width * _SAMPLES, self.height * _SAMPLES), (*_GLASS, 0))
        draw = ImageDraw.Draw(image)
        draw.polygon(outline, fill=(*_GLASS, fill))
        line = max(_SAMPLES, round(min(self.width, self.height) * _SAMPLES / 280))
        draw.line([*outline, *outline[:2]], fill=(*_INK, edge), width=line, joint="curve")
        pixels = np.asarray(image.reduce(_SAMPLES), dtype=np.float32)
        return pixels[..., :3], pixels[..., 3] / 255

    def _depth(self, axis: int, side: int) -> Reals:
        """Compute depths (H, W) of a pane's plane, inf where a pixel's ray does not meet it."""
        projection = self.camera.projection(self.eye, self.width, self.height)
        rays = np.linalg.inv(projection[:, :3])[axis]
        columns, rows = np.arange(self.width) + 0.5, np.arange(self.height)[:, None] + 0.5
        slope = rays[0] * columns + rays[1] * rows + rays[2]
        with np.errstate(divide="ignore"):
            depth = (side * self.size[axis] - self.eye[axis]) / slope
        return np.where(depth > 0, depth, np.inf)


def _over(image: Reals, color: Reals, alpha: Reals) -> Reals:
    return image + (color - image) * alpha[..., None]
