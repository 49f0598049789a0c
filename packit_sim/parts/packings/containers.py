"""The containers of packings off the grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.packings.bounds import LENGTHS
from packit_sim.parts.packings.checked_items import CheckedItem
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.rotation_sets import FIXED

_WALLS = (("left", "right"), ("back", "front"), ("bottom", "top"))
"""The walls of a box by axis, the one at 0 first."""

ROUNDING = 5e-8
"""Rounding of an item's sides in single precision, relative to the container's."""


class Measured(Protocol):
    """The size of a part in each of its rotations."""

    @property
    def sides(self) -> Floats:
        """The sides (m, 3) of its bounding box."""

    @property
    def circles(self) -> Floats:
        """The diameters (m,) of the circles around it, seen from above."""


@runtime_checkable
class Container(Protocol):
    """A container, from (0, 0, 0) of its bounding box on."""

    @property
    def name(self) -> str:
        """Its name, in tables and files."""

    @property
    def size(self) -> tuple[float, float, float]:
        """The sides of its bounding box; that along z is infinite for a strip."""

    @property
    def obstacles(self) -> tuple[ItemType, ...]:
        """What is in it already and stays there: meshes in the container's coordinates."""

    @property
    def is_strip(self) -> bool:
        """Whether it has no top."""

    @property
    def volume(self) -> float:
        """Its volume; infinite for a strip."""

    @property
    def longest(self) -> float:
        """The longest fixed side: the unit of the tolerance."""

    def faults(
        self,
        item: CheckedItem,
        clearance: float | WallClearance = 0.0,
        slack: float | None = None,
    ) -> Iterator[str]:
        """Find what is wrong with the place of an item, such as "reaches 2 beyond ...".

        Parameters
        ----------
        clearance : float or WallClearance
            The smallest distance that the item may have from the walls.
        slack : float, optional
            How much smaller it may be; by default the item's tolerance.

        Returns
        -------
        iterator of str
            A predicate for each wall, without the item's name.
        """

    def walls(self, margin: float | WallClearance = 0.0, gap: float = 0.0) -> tuple[ItemType, ...]:
        """Return what is around the container in its bounding box, as bodies for a search.

        Parameters
        ----------
        margin : float or WallClearance
            The smallest distance that items may have from the walls.
        gap : float
            The distance that the search keeps from each body.

        Returns
        -------
        tuple of ItemType
            Closed bodies. Items inside the bounding box less the margin that keep the gap from them
            keep the margin from the walls.
        """

    def with_obstacles(self, obstacles: Sequence[ItemType]) -> Container:
        """Return the same container with these obstacles."""

    def has_space(self, part: Measured, margin: float | WallClearance, factor: float = 1.0) -> bool:
        """Return whether a part may fit, by its size alone.

        Parameters
        ----------
        margin : float or WallClearance
            The smallest distance from the walls.
        factor : float, default: 1.0
            The scale of the part.

        Returns
        -------
        bool
            False if it fits in none of its rotations.
        """


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
        object.__setattr__(self, "obstacles", fixed_in_place(self.obstacles))

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
        """Yield the walls, and how far vertices reach beyond each.

        Parameters
        ----------
        vertices : ndarray of float64, shape (n, 3)
            In the box's coordinates.

        Yields
        ------
        str
            The wall, such as "the box's top wall".
        float
            The largest distance beyond it, below 0 inside, or NaN.
        """
        low, high = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
        for walls, least, most, side in zip(_WALLS, low, high, self.size, strict=True):
            for wall, depth in zip(walls, (-least, most - side), strict=True):
                yield f"the box's {wall} wall", depth

    def faults(
        self,
        item: CheckedItem,
        clearance: float | WallClearance = 0.0,
        slack: float | None = None,
    ) -> Iterator[str]:
        """Yield the walls that an item reaches beyond, or comes too close to."""
        own = WallClearance.of(clearance)
        clearances = np.column_stack((own.lower, own.upper)).ravel()
        yield from beyond_walls(self.beyond, item, clearances.tolist(), slack)

    def walls(self, margin: float | WallClearance = 0.0, gap: float = 0.0) -> tuple[ItemType, ...]:
        """Return nothing: a box is its bounding box."""
        return ()

    def with_obstacles(self, obstacles: Sequence[ItemType]) -> BoxContainer:
        """Return the same box with these obstacles."""
        return replace(self, obstacles=tuple(obstacles))

    def has_space(self, part: Measured, margin: float | WallClearance, factor: float = 1.0) -> bool:
        """Return whether a part fits in one of its rotations."""
        return in_bounding_box(self.size, part, margin, factor)


def in_bounding_box(
    size: Sequence[float], part: Measured, margin: float | WallClearance, factor: float
) -> bool:
    """Return whether a part fits into a bounding box in one of its rotations."""
    own = WallClearance.of(margin)
    inner = np.array(size) * (1 + ROUNDING) - own.lower - own.upper
    return bool((part.sides * factor <= inner).all(axis=1).any())


def fixed_in_place(obstacles: Sequence[object]) -> tuple[ItemType, ...]:
    """Return obstacles as single items that do not turn.

    Returns
    -------
    tuple of ItemType
        The obstacles.

    Raises
    ------
    ArgumentError
        If one is no `ItemType`.
    """
    found = []
    for number, each in enumerate(obstacles):
        if not isinstance(each, ItemType):
            kind = type(each).__name__
            raise ArgumentError(f"obstacles[{number}] is of type {kind}: choose an ItemType")
        is_fixed = each.demand == 1 and each.rotations == FIXED
        found.append(each if is_fixed else each.changed(1, FIXED))
    return tuple(found)


def beyond_walls(
    beyond: Callable[[Floats], Iterator[tuple[str, float]]],
    item: CheckedItem,
    clearances: Sequence[float],
    slack: float | None,
) -> Iterator[str]:
    """Yield the faults of an item in a container that is convex: its vertices decide.

    Parameters
    ----------
    beyond : callable
        Yields each wall, and how far vertices (n, 3) reach beyond it, or less than 0.
    clearances : sequence of float
        The smallest distance that the item may have from each wall.
    slack : float, optional
        As in `Container.faults`.

    Yields
    ------
    str
        The predicates.
    """
    slack = item.tolerance if slack is None else slack
    for clearance, (wall, depth) in zip(clearances, beyond(item.vertices), strict=True):
        if not depth + clearance <= slack:
            if clearance and depth <= 0:
                least, distance = item.length(clearance), item.length(abs(depth))
                yield f"is {distance} from {wall}: less than the clearance of {least}"
            else:
                yield f"reaches {item.length(depth)} beyond {wall}"
