"""Pictures of a world: colours, depths and segmentation from a renderer's pixels."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.core.checks import Range, check_range
from packit_sim.render.cameras import Points
from packit_sim.render.coloring import Legend
from packit_sim.render.defaults import MAX_SIDE
from packit_sim.render.ghosts import Ghost
from packit_sim.render.image_files import RGBImage, output_file, save_png
from packit_sim.render.looks import Look
from packit_sim.render.pixel_kernels import resolve
from packit_sim.render.worlds import DrawnWorld, View

_SAMPLES = 2
"""Samples along each side of a pixel."""

_OUTLINE = 0.55
"""The share of its brightness that a pixel on an outline keeps."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A picture of a box.

    Attributes
    ----------
    image : RGBImage
        Array of shape (H, W, 3), uint8.
    depth : ndarray of float32, shape (H, W)
        Distance along the view from the camera in box units, inf where there is nothing.
    segmentation : ndarray of int32, shape (H, W)
        The index of the placed item, -1 where there is none.
    projection : ndarray of float64, shape (3, 4)
        Maps a point (x, y, z, 1) of the box to (column, row, 1) times its depth.
    renderer : str
        "egl" or "software".
    legend : Legend or None
        The meaning of the items' colours, if they have any.
    """

    image: RGBImage
    depth: npt.NDArray[np.float32]
    segmentation: npt.NDArray[np.int32]
    projection: Points
    renderer: str
    legend: Legend | None = None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the image as PNG, with the renderer's name in its metadata.

        Parameters
        ----------
        path : str or PathLike
            The file, which is written completely or not at all.

        Raises
        ------
        RenderError
            If it cannot be written.
        """
        save_png(self.image, path, self.renderer)

    def save_arrays(self, path: str | os.PathLike[str]) -> None:
        """Write image, depth, segmentation and projection as NPZ.

        Parameters
        ----------
        path : str or PathLike
            The file, which is written completely or not at all.

        Raises
        ------
        RenderError
            If it cannot be written.
        """
        names = ("image", "depth", "segmentation", "projection")
        with output_file(path) as file:
            np.savez_compressed(file, **{name: getattr(self, name) for name in names})


def take(
    world: DrawnWorld,
    indices: dict[int, int],
    points: Points,
    center: Points | None,
    look: Look,
    size: tuple[int, int],
    ghost: Points | None = None,
) -> Snapshot:
    """Draw a world.

    Parameters
    ----------
    indices : dict[int, int]
        The item's index for each body's number.
    points : Points
        Points that the picture contains, of shape (n, 3), see `Camera.eye`.
    center : Points | None
        The point that the camera looks at, of shape (3,), see `Camera.eye`.
    look : Look
        The camera and the background.
    size : tuple[int, int]
        Width and height in pixels.
    ghost : Points | None
        Extents (3,) of a box to draw as panes of glass.

    Returns
    -------
    Snapshot
        The picture, without a legend.

    Raises
    ------
    ArgumentError
        If the width or the height is not 1 to `MAX_SIDE`.
    """
    width, height = size
    for name, side in (("width", width), ("height", height)):
        check_range(name, side, Range(1, MAX_SIDE), "pixels")
    camera = look.camera
    eye = camera.eye(points, width / height, center)
    low, high = points.min(axis=0), points.max(axis=0)
    distance = float((eye - (low + high) / 2) @ camera.toward)
    radius = float(np.linalg.norm(high - low))
    view = View(camera, eye, max(distance - radius, radius / 100), distance + radius)
    pixels = world.camera_image(view, width * _SAMPLES, height * _SAMPLES)
    items = np.full(max(*indices, -1, 0) + 1, -1, dtype=np.int32)
    items[list(indices)] = list(indices.values())
    panes = None if ghost is None else Ghost(ghost, camera, eye, width, height)
    back = look.background if panes is None else panes.behind(look.background)
    image, depth, segmentation = resolve(
        pixels.rgba,
        pixels.depth,
        pixels.bodies,
        items,
        np.broadcast_to(np.asarray(back, dtype=np.float32), (height, width, 3)),
        _SAMPLES,
        _OUTLINE,
        (view.near, view.far),
    )
    if panes is not None:
        image = panes.before(image, depth)
    return Snapshot(
        np.rint(image).astype(np.uint8),
        depth,
        segmentation,
        camera.projection(eye, width, height),
        world.renderer,
    )
