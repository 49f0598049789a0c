"""Legends of colours, drawn at the right of a picture."""

from __future__ import annotations

import itertools

import numpy as np
from PIL import Image, ImageDraw

from packit_sim.render.coloring import Color, ColorKey, ColorScale, Legend, ramp
from packit_sim.render.defaults import RGB
from packit_sim.render.image_files import RGBImage
from packit_sim.render.lettering import font_of, line_height, plain, shortened

_STEPS = 64
"""Stripes in the colour ramp of a scale."""


def add_legend(image: RGBImage, legend: Legend, background: RGB) -> RGBImage:
    """Add a strip with a legend at the right of a picture: (H, W, 3) becomes (H, W', 3)."""
    height = len(image)
    font = font_of(min(10 + height // 100, 26))
    step = round(1.25 * line_height(font))
    texts = [plain(text) for text in _texts(legend)]
    widest = max(1, height // 2)
    strip = round(2.5 * step + min(widest, max(map(font.getlength, texts))))
    canvas = Image.new("RGB", (strip, height), background)
    draw = ImageDraw.Draw(canvas)
    ink = (44, 48, 56) if sum(background) > 380 else (226, 228, 232)

    def write(x: float, y: float, text: str) -> None:
        line = shortened(plain(text), font, strip - x - step / 2)
        draw.text((x, y), line, fill=ink, font=font, anchor="lm")

    write(step / 2, step, legend.title)
    if isinstance(legend, ColorKey):
        shown = max(1, height // step - 3)
        for n, (name, color) in enumerate(legend.entries[:shown], start=2):
            y = n * step + step / 4
            draw.rectangle((step / 2, y - step / 3, 1.3 * step, y + step / 3), fill=_rgb(color))
            write(1.75 * step, y, name)
        if len(legend.entries) > shown:
            write(step / 2, (shown + 2.25) * step, f"and {len(legend.entries) - shown} more")
    else:
        top, bottom = 2 * step, max(height - 1.5 * step, 3 * step)
        edges = np.linspace(bottom, top, _STEPS + 1)
        for n, (low, high) in enumerate(itertools.pairwise(edges.tolist())):
            draw.rectangle((step / 2, high, 1.5 * step, low), fill=_rgb(ramp(n / (_STEPS - 1))))
        write(1.95 * step, top + step / 3, legend.high)
        write(1.95 * step, bottom - step / 3, legend.low)
    return np.concatenate((image, np.asarray(canvas)), axis=1)


def _texts(legend: Legend) -> list[str]:
    if isinstance(legend, ColorScale):
        return [legend.title, legend.low, legend.high]
    return [legend.title, *(name for name, _ in legend.entries)]


def _rgb(color: Color) -> RGB:
    red, green, blue = (round(255 * channel) for channel in color)
    return red, green, blue
