"""Plots in one style, by matplotlib (`pip install packit-sim[report]`)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from packit_sim.core.confidence import Estimate
from packit_sim.core.extras import needed_for
from packit_sim.render.image_files import save_png

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#7F7F7F")
"""Colours by Okabe and Ito; colour-blind readers can distinguish them, the first three best."""

DPI = 150
"""Pixels per inch of a figure."""

INK = "#4a4f58"
"""The colour of everything that is not data."""

BAND = 0.18
"""Opacity of an interval around its line."""

_STYLE = {
    "axes.axisbelow": True,
    "axes.edgecolor": INK,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "font.size": 10,
    "grid.alpha": 0.25,
    "legend.frameon": False,
}


def require() -> None:
    """Raise MissingPackageError if matplotlib is missing; call it before long work."""
    with needed_for("plots"):
        import matplotlib  # noqa: F401


@contextmanager
def drawn(
    path: Path | str, mosaic: Sequence[Sequence[str]], width: float, height: float
) -> Iterator[tuple[Figure, Any]]:
    """Create a figure that is written as PNG when the block ends without an error.

    Parameters
    ----------
    path : Path | str
        The file, which is written completely or not at all.
    mosaic : Sequence[Sequence[str]]
        Names of axes, row by row.
    width : float
        Inches of `DPI` pixels.
    height : float
        Inches of `DPI` pixels.

    Yields
    ------
    tuple[Figure, Any]
        The figure, and its axes by name.

    Raises
    ------
    MissingPackageError
        If matplotlib is not installed.
    RenderError
        If the file cannot be written.
    """
    with _figure(mosaic, width, height, {}) as (figure, axes):
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        yield figure, axes
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    save_png(np.ascontiguousarray(pixels), path, "matplotlib")


@contextmanager
def inlined(
    out: TextIO, mosaic: Sequence[Sequence[str]], width: float, height: float
) -> Iterator[tuple[Figure, Any]]:
    """Create a figure that is written as an SVG element of a page when the block ends.

    The page defines the fonts and the colours: `var(--ink)` for everything that is not data,
    `var(--data-0)` and so on for `COLORS`. The background is transparent.

    Parameters
    ----------
    out : TextIO
        The file to which the element is written.
    mosaic : Sequence[Sequence[str]]
        Names of axes, row by row.
    width : float
        Inches.
    height : float
        Inches.

    Yields
    ------
    tuple[Figure, Any]
        The figure, and its axes by name.
    """
    ink = dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color"), INK)
    style = {
        **ink,
        "grid.color": INK,
        "grid.alpha": 0.15,
        "svg.fonttype": "none",
        "svg.hashsalt": f"{mosaic}",
    }
    drawn = StringIO()
    with _figure(mosaic, width, height, style) as (figure, axes):
        yield figure, axes
        figure.savefig(drawn, format="svg", transparent=True, metadata={"Date": None})
    text = drawn.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    named = {INK: "--ink", **{color: f"--data-{n}" for n, color in enumerate(COLORS)}}
    for color, name in named.items():
        text = text.replace(color.lower(), f"var({name})")
    out.write(text)


@contextmanager
def _figure(
    mosaic: Sequence[Sequence[str]], width: float, height: float, style: Mapping[str, Any]
) -> Iterator[tuple[Figure, Any]]:
    """Create a figure and its axes, in the common style with some changes."""
    require()
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context({**_STYLE, **style}):
        figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
        yield figure, figure.subplot_mosaic([list(row) for row in mosaic])


def line(axes: Any, at: Sequence[float], estimates: Sequence[Estimate], **style: Any) -> None:
    """Draw means as a line, and their intervals as a band where they have any.

    Parameters
    ----------
    axes : Any
        Matplotlib's axes.
    at : Sequence[float]
        Positions of the estimates on the x axis.
    estimates : Sequence[Estimate]
        The means and intervals.
    **style : Any
        Arguments of matplotlib's `plot`; `color` is required.
    """
    means = [estimate.mean for estimate in estimates]
    low = [e.mean if e.low is None else e.low for e in estimates]
    high = [e.mean if e.high is None else e.high for e in estimates]
    axes.plot(at, means, **style)
    axes.fill_between(at, low, high, color=style["color"], alpha=BAND, linewidth=0)


def label_between_powers(axis: Any) -> None:
    """Write plain numbers between the powers of ten of a logarithmic axis, if it has few powers."""
    from matplotlib.ticker import LogFormatter

    axis.set_minor_formatter(LogFormatter(minor_thresholds=(1, 0.4)))
