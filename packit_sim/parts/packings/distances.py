"""Distances that items keep: from each other along z, and from each wall of their container."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from packit_sim.core.checks import Range, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.parts.packings.bounds import DISTANCES

STRETCHES = Range(0.05, 20)
"""Ratios of the clearance to that along z: meshes that are stretched more become needles."""


@dataclass(frozen=True)
class WallClearance:
    """The smallest distances of items to the walls of their container.

    Parameters
    ----------
    sides : float
        The distance to all walls but the floor and the top.
    floor : float
        The distance to the lower end.
    top : float
        The distance to the upper end.

    Raises
    ------
    ArgumentError
        If a distance is not possible.

    Examples
    --------
    >>> from packit_sim import WallClearance
    >>> WallClearance(sides=5, floor=2)
    WallClearance(sides=5, floor=2, top=0.0)
    """

    sides: float = 0.0
    floor: float = 0.0
    top: float = 0.0

    def __post_init__(self) -> None:
        for name in ("sides", "floor", "top"):
            check_range(f"the wall clearance {name}", getattr(self, name), DISTANCES)

    @classmethod
    def of(cls, distance: float | WallClearance) -> WallClearance:
        """Return the distances to all walls if they are the same."""
        return distance if isinstance(distance, cls) else cls(*3 * (distance,))  # type: ignore[arg-type]

    @property
    def is_even(self) -> bool:
        """True if the distances to all walls are the same."""
        return self.sides == self.floor == self.top

    @property
    def lower(self) -> Floats:
        """The distances (3,) to the walls at 0 along each axis."""
        return np.array((self.sides, self.sides, self.floor))

    @property
    def upper(self) -> Floats:
        """The distances (3,) to the opposite walls."""
        return np.array((self.sides, self.sides, self.top))

    @property
    def largest(self) -> float:
        """The largest distance."""
        return max(astuple(self))

    def plus(self, more: float) -> WallClearance:
        """Add a length to all distances."""
        return WallClearance(*(each + more for each in astuple(self)))

    def text(self, unit: str) -> str:
        """Return the distances as text, such as "2 mm at each wall"."""
        if self.is_even:
            return f"{self.sides:.4g} {unit} at each wall"
        named = zip(("at the sides", "at the floor", "at the top"), astuple(self), strict=True)
        return ", ".join(f"{each:.4g} {unit} {where}" for where, each in named)


def stretch(clearance: float, clearance_z: float | None) -> float:
    """Return by what lengths along z are multiplied before distances of items are measured.

    Parameters
    ----------
    clearance : float
        The smallest distance of two items.
    clearance_z : float, optional
        That of two items of which one is straight above the other; by default the same.

    Returns
    -------
    float
        The factor, 1 if both are equal: two points are far enough apart if the second is outside an
        ellipsoid around the first, whose half axes are the clearance along x and y, and
        `clearance_z` along z.

    Raises
    ------
    ArgumentError
        If one of the two is 0 and the other is not, or they differ too much.
    """
    if clearance_z is None or clearance_z == clearance:
        return 1.0
    check_range("clearance_z", clearance_z, DISTANCES)
    if not (clearance > 0 and clearance_z > 0 and clearance / clearance_z in STRETCHES):
        raise ArgumentError(
            f"clearance_z {clearance_z!r} is not possible with the clearance {clearance!r}: both "
            f"above 0, and their ratio {STRETCHES}"
        )
    return clearance / clearance_z
