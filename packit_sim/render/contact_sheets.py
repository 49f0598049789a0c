"""Pictures of single shapes, and contact sheets of whole libraries."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw
from PIL.ImageFont import FreeTypeFont

from packit_sim.core.checks import Range, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.items import BoxState, PlacedItem
from packit_sim.geometry.lattice import BOX_CELLS, Triple
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.render.cameras import Camera
from packit_sim.render.defaults import BACKGROUND, MAX_SIDE
from packit_sim.render.image_files import RGBImage, save_png
from packit_sim.render.lettering import ELLIPSIS, font_of, line_height, lines_of, plain, shortened
from packit_sim.render.looks import Look
from packit_sim.render.scene import Scene

MIN_SIDE = 16
"""The smallest side of a shape's picture, in pixels."""

_LOOK = Look(Camera(azimuth=120.0, elevation=28.0, fov=20.0), box="none")
_HALF_TURN = 2
"""The rotation that turns a shape's front, which faces -y, to the camera and the light."""

_PLACE: Triple = tuple(np.rint(-250 * _LOOK.camera.toward).astype(int).tolist())
"""Location of shapes, in grid nodes: EGL draws highlights as seen from the origin, which is
therefore far away on the camera's side."""

_INK = (44, 48, 56)
_ALARM = (168, 44, 32)
_TEXT_WIDTH = 0.94
"""Share of a tile's width that text may fill."""


@dataclass(frozen=True, eq=False)
class ContactSheet:
    """Pictures of shapes in a grid, row by row, each with its label below.

    Attributes
    ----------
    image : RGBImage
        Array of shape (H, W, 3), uint8.
    renderer : str
        "egl" or "software".
    """

    image: RGBImage
    renderer: str

    def save(self, path: str | os.PathLike[str]) -> str:
        """Write the image as PNG, completely or not at all.

        Returns
        -------
        str
            The renderer's name.

        Raises
        ------
        RenderError
            If the file cannot be written.
        """
        save_png(self.image, path, self.renderer)
        return self.renderer


_EMPTY: BoxState[PlacedItem] = BoxState(BOX_CELLS, ())


def _box_of(shape: Shape) -> BoxState[PlacedItem]:
    """Return a box that contains a shape and nothing else."""
    return BoxState(BOX_CELLS, (PlacedItem(Item(shape, rotation=_HALF_TURN), _PLACE),))


def picture(shape: Shape, side: int = 256) -> RGBImage:
    """Draw a shape from the front and above, as large as fits.

    Parameters
    ----------
    side : int
        Pixels along each side, `MIN_SIDE` to `MAX_SIDE`.

    Returns
    -------
    RGBImage
        The picture, uint8 (side, side, 3).

    Raises
    ------
    ArgumentError
        If the side is out of range.
    """
    check_range("side", side, Range(MIN_SIDE, MAX_SIDE), "pixels")
    with Scene(_box_of(shape)) as scene:
        return scene.snapshot(side, side, _LOOK).image


def contact_sheet(
    tiles: Iterable[tuple[str, Shape | str]],
    columns: int | None = None,
    side: int = 160,
    on_tile: Callable[[], object] | None = None,
) -> ContactSheet:
    """Draw many shapes with their labels, in the order in which they come.

    Parameters
    ----------
    tiles : Iterable[tuple[str, Shape | str]]
        A label and a shape each, or a message to show if there is none. They are taken one at a
        time and not kept.
    columns : int | None
        The maximum number of columns; by default as many as rows.
    side : int
        Pixels along each side of a shape's picture, `MIN_SIDE` to `MAX_SIDE`.
    on_tile : Callable[[], object] | None
        Called after each tile.

    Returns
    -------
    ContactSheet
        The image.

    Raises
    ------
    ArgumentError
        If the side is out of range, there are less than 1 columns, or there are no tiles.
    """
    check_range("side", side, Range(MIN_SIDE, MAX_SIDE), "pixels")
    if columns is not None:
        check_range("columns", columns, Range(1))
    pictures = []
    with Scene(_EMPTY) as scene:
        for label, content in tiles:
            if isinstance(content, Shape):
                scene.update(_box_of(content))
                image = scene.snapshot(side, side, _LOOK).image
            else:
                image = message_image(content, side)
            pictures.append(np.concatenate((image, label_image(label, side))))
            if on_tile is not None:
                on_tile()
        renderer = scene.renderer
    if not pictures:
        raise ArgumentError("a contact sheet of 0 tiles is not possible: at least 1")
    columns = min(columns or math.ceil(math.sqrt(len(pictures))), len(pictures))
    return ContactSheet(_grid(pictures, columns), renderer)


def _grid(pictures: list[RGBImage], columns: int) -> RGBImage:
    """Arrange pictures of one size row by row, with a gap around each."""
    height, width = pictures[0].shape[:2]
    gap = max(2, width // 20)
    rows = math.ceil(len(pictures) / columns)
    grid = np.empty((rows * (height + gap) + gap, columns * (width + gap) + gap, 3), np.uint8)
    grid[:] = BACKGROUND
    for n, image in enumerate(pictures):
        row, column = divmod(n, columns)
        y, x = gap + row * (height + gap), gap + column * (width + gap)
        grid[y : y + height, x : x + width] = image
    return grid


def label_image(text: str, side: int) -> RGBImage:
    """Draw a line of text (H, side, 3), shortened in the middle if it is too wide."""
    font = sheet_font(side)
    line = shortened(plain(text), font, side * _TEXT_WIDTH)
    return _written([line], side, 3 * line_height(font) // 2, _INK)


def message_image(text: str, side: int) -> RGBImage:
    """Draw text in lines (side, side, 3), as many as there is space for."""
    font = sheet_font(side)
    space = max(1, side // line_height(font) - 1)
    *lines, last = itertools.islice(lines_of(plain(text), font, side * _TEXT_WIDTH), space + 1)
    lines.append(last if len(lines) < space else lines.pop()[:-1] + ELLIPSIS)
    return _written(lines, side, side, _ALARM)


def _written(lines: Sequence[str], width: int, height: int, ink: tuple[int, int, int]) -> RGBImage:
    """Draw lines of text in the middle of a picture (height, width, 3)."""
    font = sheet_font(width)
    image = Image.new("RGB", (width, height), BACKGROUND)
    draw = ImageDraw.Draw(image)
    for n, line in enumerate(lines):
        y = height / 2 + (n - (len(lines) - 1) / 2) * line_height(font)
        draw.text((width / 2, y), line, fill=ink, font=font, anchor="mm")
    return np.asarray(image)


def sheet_font(side: int) -> FreeTypeFont:
    """Return the font for a picture, given the length of its side in pixels."""
    return font_of(min(6 + side // 22, 32))
