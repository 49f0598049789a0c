"""Image files: written completely or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from packit_sim.core.errors import RenderError
from packit_sim.core.files import replacing

RGBImage = npt.NDArray[np.uint8]
"""An image of shape (H, W, 3), uint8, red, green and blue."""


@contextlib.contextmanager
def output_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a file that replaces `path` when the block ends without an error.

    Yields
    ------
    BinaryIO
        A temporary file in the same folder.

    Raises
    ------
    RenderError
        If the file cannot be written.
    """
    path = Path(path)
    try:
        with replacing(path) as file:
            yield file
    except OSError as error:
        raise RenderError(f"the picture can't be written to {path}: {error.strerror}") from error


def save_png(image: RGBImage, path: str | os.PathLike[str], renderer: str) -> None:
    """Write an image as PNG, completely or not at all.

    Parameters
    ----------
    image : RGBImage
        Array of shape (H, W, 3), uint8.
    renderer : str
        The renderer's name, stored in the metadata.

    Raises
    ------
    RenderError
        If the file cannot be written.
    """
    info = PngInfo()
    info.add_text("Software", "PackIt-Sim")
    info.add_text("Renderer", renderer)
    with output_file(path) as file:
        Image.fromarray(image).save(file, format="PNG", pnginfo=info)
