"""Video files: MP4 by ffmpeg, and GIF."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from packit_sim.core.errors import RenderError
from packit_sim.core.extras import needed_for
from packit_sim.core.files import naming
from packit_sim.render.image_files import RGBImage, output_file

SUFFIXES = (".mp4", ".gif")

CRF = 18
"""Quality of H.264, 0 (lossless) to 51: at 18 the loss is not visible."""

_PALETTE_FRAMES = 12
"""Frames of a GIF from which its palette is computed."""


def require(path: Path | str) -> None:
    """Raise an error if a film cannot be written; call it before long work.

    Raises
    ------
    RenderError
        If the suffix is not one of `SUFFIXES`.
    MissingPackageError
        If it is .mp4, and ffmpeg is not installed.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise RenderError(f"{path} is no film: choose a name that ends in {' or '.join(SUFFIXES)}")
    if suffix == ".mp4":
        with needed_for("MP4 films", "choose a name that ends in .gif"):
            import imageio_ffmpeg  # noqa: F401


def write(path: str | os.PathLike[str], pictures: Iterable[RGBImage], fps: int) -> int:
    """Write pictures of one size as a film, completely or not at all.

    Parameters
    ----------
    pictures : Iterable[RGBImage]
        The frames, of shape (H, W, 3).
    fps : int
        Frames per second. A GIF stores hundredths of a second: its rate is the nearest possible.

    Returns
    -------
    int
        The number of pictures.

    Raises
    ------
    RenderError
        If there is no picture, a side is odd, which MP4 does not allow, the suffix is unknown, or
        the file cannot be written.
    MissingPackageError
        If ffmpeg is required and not installed.
    """
    path = Path(path)
    require(path)
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / f"film{path.suffix.lower()}"
        with naming(path):
            count = (_gif if film.suffix == ".gif" else _mp4)(film, pictures, fps)
        if not count:
            raise RenderError(f"a film without pictures is not possible: {path}")
        with film.open("rb") as source, output_file(path) as file:
            shutil.copyfileobj(source, file)
    return count


def _mp4(path: Path, pictures: Iterable[RGBImage], fps: int) -> int:
    import imageio_ffmpeg

    count = 0
    with contextlib.ExitStack() as stack:
        for picture in pictures:
            if not count:
                height, width = picture.shape[:2]
                if height % 2 or width % 2:
                    raise RenderError(
                        f"a film of {width} x {height} pixels is not possible as MP4: "
                        "both must be even"
                    )
                writer = imageio_ffmpeg.write_frames(
                    str(path),
                    (width, height),
                    fps=fps,
                    quality=None,
                    macro_block_size=2,
                    ffmpeg_log_level="error",
                    output_params=["-crf", str(CRF), "-movflags", "+faststart"],
                )
                stack.callback(writer.close)
                writer.send(None)
            writer.send(np.ascontiguousarray(picture))
            count += 1
    return count


def _gif(path: Path, pictures: Iterable[RGBImage], fps: int) -> int:
    kept = [_packed(picture) for picture in pictures]
    if not kept:
        return 0
    palette = _palette(kept)
    frames = (_unpacked(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in kept)
    first = next(frames)
    first.save(
        path,
        save_all=True,
        append_images=frames,
        duration=max(20, 10 * round(100 / fps)),
        loop=0,
        optimize=False,
    )
    return len(kept)


def _palette(kept: Sequence[bytes]) -> Image.Image:
    """Choose 255 colours for all frames."""
    chosen = np.unique(np.linspace(0, len(kept) - 1, _PALETTE_FRAMES).astype(int))
    pixels = [np.asarray(_unpacked(kept[n])) for n in chosen.tolist()]
    return Image.fromarray(np.concatenate(pixels)).quantize(255, method=Image.Quantize.MEDIANCUT)


def _packed(picture: RGBImage) -> bytes:
    """Compress a picture as PNG: those of a film would fill the memory."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _unpacked(packed: bytes) -> Image.Image:
    with Image.open(io.BytesIO(packed)) as image:
        return image.convert("RGB")
