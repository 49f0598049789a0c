"""Looks: the display options of a box, for snapshots, films, environments and commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

from packit_sim.core.checks import POSITIVE, Range, check_range
from packit_sim.core.choices import Axis, BoxStyle
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.shapes import UP_AXES
from packit_sim.render.cameras import ISO, Camera
from packit_sim.render.coloring import Coloring, by_item
from packit_sim.render.defaults import BACKGROUND, RGB

BOX_STYLES: tuple[BoxStyle, ...] = get_args(BoxStyle)


@dataclass(frozen=True)
class Cut:
    """A plane that cuts a box open: everything beyond it is hidden.

    Items that it crosses show their section, which consists of the engine's fine cells: solid where
    a mesh encloses them, whether it is closed or not.

    Parameters
    ----------
    axis : Axis
        The axis to which the plane is perpendicular: "x", "y" or "z".
    at : float
        Position of the plane on the axis, above 0, in box units.

    Examples
    --------
    >>> from packit_sim import Cut, Look
    >>> Look(cut=Cut("y", 0.5)).cut  # hides what is beyond the middle of the box
    Cut(axis='y', at=0.5)
    >>> Cut("y", -1)
    Traceback (most recent call last):
        ...
    packit_sim.core.errors.ArgumentError: a cut at -1 is not possible: above 0, finite
    """

    axis: Axis
    at: float

    def __post_init__(self) -> None:
        if self.axis not in UP_AXES:
            raise ArgumentError(f"axis {self.axis!r} of a cut is not known: choose from x, y, z")
        check_range("a cut at", self.at, POSITIVE)

    @property
    def dimension(self) -> int:
        """The index of the axis."""
        return UP_AXES.index(self.axis)


@dataclass(frozen=True)
class Look:
    """The display options of a box.

    Parameters
    ----------
    camera : Camera
        The viewpoint of the picture.
    background : RGB
        Red, green and blue, 0 to 255.
    box : BoxStyle
        "edges" shows the box's edges and floor, "ghost" panes of glass around its contents, "none"
        the items alone, as large as fits.
    explode : float
        The distance by which items are moved apart, as a share of that to the middle of the floor.
    cut : Cut | None
        The plane that cuts the box open.
    coloring : Coloring
        The rule that gives each item its colour.

    Raises
    ------
    ArgumentError
        If a parameter is out of range.

    Examples
    --------
    >>> from packit_sim import TOP, Box, Cut, Look, Scene, by_order
    >>> look = Look(camera=TOP, box="ghost", cut=Cut("z", 0.5), coloring=by_order)
    >>> with Scene(Box()) as scene:
    ...     picture = scene.snapshot(64, 48, look)
    >>> picture.image.shape
    (48, 64, 3)
    >>> Look(explode=-1)
    Traceback (most recent call last):
        ...
    packit_sim.core.errors.ArgumentError: explode -1 is not possible: at least 0, finite
    """

    camera: Camera = ISO
    background: RGB = BACKGROUND
    box: BoxStyle = "edges"
    explode: float = 0.0
    cut: Cut | None = None
    coloring: Coloring = by_item

    def __post_init__(self) -> None:
        if self.box not in BOX_STYLES:
            choices = ", ".join(BOX_STYLES)
            raise ArgumentError(f"box {self.box!r} is not known: choose from {choices}")
        check_range("explode", self.explode, Range(0, ends="[)"))
        if len(self.background) != 3 or not all(0 <= c <= 255 for c in self.background):
            raise ArgumentError(f"background {self.background!r} must be three numbers of 0 to 255")


DEFAULT_LOOK = Look()
"""The look of a box by default."""
