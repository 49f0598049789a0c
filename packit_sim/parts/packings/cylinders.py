"""Upright cylinders as containers, such as round powder beds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from packit_sim.core.checks import check_range
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.packings.bounds import LENGTHS
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.containers import ROUNDING, Measured, beyond_walls, fixed_in_place
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.rotation_sets import FIXED

CORNERS = 128
"""Corners of the polygon that a search has instead of the circle, inside it: it is nowhere farther
from it than 0.0003 of the radius."""


@dataclass(frozen=True)
class CylinderContainer:
    """An upright cylinder, which touches all walls of its bounding box from (0, 0, 0).

    Parameters
    ----------
    diameter : float
        The diameter of its base, in any unit of length.
    height : float
        Its height.
    obstacles : tuple of ItemType
        What is in it already and stays there: meshes in the container's coordinates.
    name : str
        Its name, in tables and files.

    Raises
    ------
    ArgumentError
        If a length is not possible, or an obstacle is no `ItemType`.

    Notes
    -----
    An item is inside if all of its vertices are, since a cylinder is convex: this check is exact. A
    search has a polygon of `CORNERS` inside the circle.

    Examples
    --------
    >>> from packit_sim import CylinderContainer
    >>> bed = CylinderContainer(diameter=220, height=300)
    >>> bed.size, round(bed.volume)
    ((220.0, 220.0, 300.0), 11403981)
    """

    diameter: float
    height: float
    obstacles: tuple[ItemType, ...] = ()
    name: str = "cylinder"

    def __post_init__(self) -> None:
        for what in ("diameter", "height"):
            check_range(f"the cylinder's {what}", getattr(self, what), LENGTHS)
            object.__setattr__(self, what, float(getattr(self, what)))
        object.__setattr__(self, "obstacles", fixed_in_place(self.obstacles))

    @property
    def size(self) -> tuple[float, float, float]:
        """The sides of its bounding box."""
        return self.diameter, self.diameter, self.height

    @property
    def is_strip(self) -> bool:
        """False: it has a top."""
        return False

    @property
    def volume(self) -> float:
        """Its volume."""
        return math.pi * self.diameter**2 / 4 * self.height

    @property
    def longest(self) -> float:
        """The longest side of its bounding box."""
        return max(self.size)

    def beyond(self, vertices: Floats) -> Iterator[tuple[str, float]]:
        """Yield the walls, and how far vertices reach beyond each.

        Parameters
        ----------
        vertices : ndarray of float64, shape (n, 3)
            In the container's coordinates.

        Yields
        ------
        str
            The wall, such as "the cylinder's top".
        float
            The largest distance beyond it, below 0 inside, or NaN.
        """
        radius, heights = self.diameter / 2, vertices[:, 2]
        from_axis = np.hypot(vertices[:, 0] - radius, vertices[:, 1] - radius)
        yield "the cylinder's round wall", float(from_axis.max() - radius)
        yield "the cylinder's bottom", float(-heights.min())
        yield "the cylinder's top", float(heights.max() - self.height)

    def faults(
        self,
        item: CheckedItem,
        clearance: float | WallClearance = 0.0,
        slack: float | None = None,
    ) -> Iterator[str]:
        """Yield the walls that an item reaches beyond, or comes too close to."""
        own = WallClearance.of(clearance)
        yield from beyond_walls(self.beyond, item, (own.sides, own.floor, own.top), slack)

    def walls(self, margin: float | WallClearance = 0.0, gap: float = 0.0) -> tuple[ItemType, ...]:
        """Return what is around it in the four corners of a square.

        Parameters
        ----------
        margin : float or WallClearance
            The smallest distance from the walls; only that from the round one counts.
        gap : float
            The distance that the search keeps from the corners, which are that much farther out.

        Returns
        -------
        tuple of ItemType
            The corners.
        """
        radius = self.diameter / 2
        inner = radius - WallClearance.of(margin).sides + gap
        angles = np.linspace(math.pi / 2, 0, CORNERS // 4 + 1)
        arc = inner * np.column_stack((np.cos(angles), np.sin(angles)))
        outline = np.concatenate((((inner, inner),), arc))
        found = []
        for number in range(1, 5):
            corner = _prism(outline + radius, self.height)
            found.append(ItemType(f"wall {number}", *corner, rotations=FIXED))
            outline = np.column_stack((-outline[:, 1], outline[:, 0]))  # a quarter turn
        return tuple(found)

    def with_obstacles(self, obstacles: Sequence[ItemType]) -> CylinderContainer:
        """Return the same cylinder with these obstacles."""
        return replace(self, obstacles=tuple(obstacles))

    def has_space(self, part: Measured, margin: float | WallClearance, factor: float = 1.0) -> bool:
        """Return whether a part fits in one of its rotations, by the circles around it."""
        own = WallClearance.of(margin)
        across = self.diameter * (1 + ROUNDING) - 2 * own.sides
        up = self.height * (1 + ROUNDING) - own.floor - own.top
        fits = (part.circles * factor <= across) & (part.sides[:, 2] * factor <= up)
        return bool(fits.any())


def _prism(outline: Floats, height: float) -> tuple[Floats, Ints]:
    """Return the mesh of an upright prism, by its outline (n, 2), anticlockwise.

    Its first corner sees all others.
    """
    n = len(outline)
    ends = (np.column_stack((outline, np.full(n, z))) for z in (0.0, height))
    first = np.arange(n)
    following = np.roll(first, -1)
    fan = np.column_stack((np.zeros(n - 2, np.int64), first[1:-1], first[2:]))
    lower = np.column_stack((first, following, following + n))
    upper = np.column_stack((first, following + n, first + n))
    return np.concatenate(list(ends)), np.concatenate((fan[:, ::-1], fan + n, lower, upper))
