"""The containers of packings off the grid."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.packings.bounds import LENGTHS
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.rotation_sets import FIXED

_WALLS = (("left", "right"), ("back", "front"), ("bottom", "top"))
"""The walls of a box by axis, the one at 0 first."""


class Container(Protocol):
    """A container, as the validity check of a packing sees it."""

    @property
    def longest(self) -> float:
        """The longest fixed side: the unit of the tolerance."""

    def beyond(self, vertices: Floats) -> Iterator[tuple[str, float]]:
        """Yield where vertices (n, 3) reach outside, such as "the box's top wall", and how far."""


@dataclass(frozen=True)
class BoxContainer:
    """A box from (0, 0, 0), or a strip: a box without a top.

    Parameters
    ----------
    size : tuple[float, float, float]
        The sides along x, y and z, in any unit of length; that along z is `math.inf` for a strip.
    obstacles : tuple of ItemType
        What is in it already and stays there: meshes in the container's coordinates. They may reach
        beyond its walls.
    name : str
        Its name, in tables and files.

    Raises
    ------
    ArgumentError
        If a side is not a number above 0, the base is not finite, or an obstacle is no `ItemType`.

    Examples
    --------
    >>> import math
    >>> from packit_sim import BoxContainer
    >>> box = BoxContainer((300, 200, 150))
    >>> box.volume
    9000000.0
    >>> BoxContainer((300, 200, math.inf)).is_strip
    True
    """

    size: tuple[float, float, float]
    obstacles: tuple[ItemType, ...] = ()
    name: str = "box"

    def __post_init__(self) -> None:
        try:
            x, y, z = (float(side) for side in self.size)
        except (TypeError, ValueError):
            raise ArgumentError(f"size {self.size!r:.80} is not possible: three numbers") from None
        except OverflowError:  # of an integer of hundreds of digits
            raise ArgumentError(f"a side is not possible: {LENGTHS}") from None
        for axis, side in zip("xyz", (x, y, z), strict=True):
            if not (side in LENGTHS or (axis == "z" and side == math.inf)):
                open_top = ", or infinite for a strip" if axis == "z" else ""
                raise ArgumentError(
                    f"the side {side!r} along {axis} is not possible: {LENGTHS}{open_top}"
                )
        object.__setattr__(self, "size", (x, y, z))
        obstacles: Sequence[object] = self.obstacles
        for number, each in enumerate(obstacles):
            if not isinstance(each, ItemType):
                kind = type(each).__name__
                raise ArgumentError(f"obstacles[{number}] is of type {kind}: choose an ItemType")
        fixed = (
            each if each.demand == 1 and each.rotations == FIXED else each.changed(1, FIXED)
            for each in self.obstacles
        )
        object.__setattr__(self, "obstacles", tuple(fixed))

    @property
    def is_strip(self) -> bool:
        """Whether the box has no top."""
        return self.size[2] == math.inf

    @property
    def base(self) -> float:
        """Area of the base."""
        return self.size[0] * self.size[1]

    @property
    def volume(self) -> float:
        """Volume; infinite for a strip."""
        return self.base * self.size[2]

    @property
    def longest(self) -> float:
        """The longest side that is not infinite."""
        return max(side for side in self.size if side < math.inf)

    def beyond(self, vertices: Floats) -> Iterator[tuple[str, float]]:
        """Yield the walls that vertices reach beyond, and how far.

        Parameters
        ----------
        vertices : ndarray of float64, shape (n, 3)
            In the box's coordinates.

        Yields
        ------
        str
            The wall, such as "the box's top wall".
        float
            The largest distance beyond it, more than 0 or NaN.
        """
        low, high = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
        for walls, least, most, side in zip(_WALLS, low, high, self.size, strict=True):
            for wall, depth in zip(walls, (-least, most - side), strict=True):
                if not depth <= 0:
                    yield f"the box's {wall} wall", depth
