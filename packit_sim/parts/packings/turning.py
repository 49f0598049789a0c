"""Limits on turning: how far an item may lean, and which of its sides may face down."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.core.checks import check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import ROTATION_SLACK
from packit_sim.parts.packings import rotation_sets
from packit_sim.parts.packings.bounds import TILTS

SIDES = ("x-", "x+", "y-", "y+", "z-", "z+")
"""The sides of an item, by the axis that points out of each; z- is its bottom."""

_OUTWARDS = np.kron(np.eye(3), [[-1.0], [1.0]])


@dataclass(frozen=True)
class Turning:
    """Limits on how an item may turn, from the orientation in its own frame.

    Parameters
    ----------
    max_tilt : float
        The largest angle in degrees between the item's z axis and the container's.
    down : sequence of str
        The sides that may face down. The side that does is the one whose outward direction is
        nearest to straight down.

    Raises
    ------
    ArgumentError
        If an angle or a side is not possible.

    Examples
    --------
    >>> from packit_sim import Turning
    >>> from packit_sim.parts.packings.rotation_sets import matrices
    >>> upright = Turning(max_tilt=15)
    >>> int(upright.allows(matrices("cube")).sum())
    4
    >>> never_upside_down = Turning(down=("z-", "x-", "x+", "y-", "y+"))
    >>> int(never_upside_down.allows(matrices("cube")).sum())
    20
    """

    max_tilt: float = 180.0
    down: tuple[str, ...] = SIDES

    def __post_init__(self) -> None:
        check_range("max tilt", self.max_tilt, TILTS)
        for side in self.down:
            if side not in SIDES:
                raise ArgumentError(f"side {side!r} is not known: choose from {', '.join(SIDES)}")
        if not self.down:
            raise ArgumentError(f"no side may face down: choose from {', '.join(SIDES)}")
        object.__setattr__(self, "down", tuple(each for each in SIDES if each in self.down))

    def allows(self, rotations: Floats) -> npt.NDArray[np.bool_]:
        """Return which rotations (n, 3, 3) keep the limits: bool, shape (n,)."""
        is_low = _tilts(rotations) <= math.radians(self.max_tilt) + ROTATION_SLACK
        downwards = _downwards(rotations)
        own = downwards[:, [SIDES.index(each) for each in self.down]].max(axis=1)
        return np.asarray(is_low & (own >= downwards.max(axis=1) - ROTATION_SLACK))

    def fault(self, rotation: Floats) -> str | None:
        """Return how a rotation (3, 3) breaks the limits, or None if it keeps them."""
        if self.allows(rotation[None]).all():
            return None
        tilt = math.degrees(_tilts(rotation[None])[0])
        if not Turning(self.max_tilt).allows(rotation[None]).all():
            return f"it leans by {tilt:.4g} degrees, more than {self.max_tilt:.6g}"
        side = SIDES[int(_downwards(rotation[None])[0].argmax())]
        return f"its side {side} faces down, which is none of {', '.join(self.down)}"

    def check(self, rotations: str) -> None:
        """Raise ArgumentError if no rotation of a set keeps the limits.

        Those of `free` must allow one of `cube`: others are limits that contradict each other.
        """
        tried = "cube" if rotations == rotation_sets.FREE else rotations
        if not self.allows(rotation_sets.matrices(tried)).any():
            raise ArgumentError(f"none of its rotations ({rotations}) has {self}")

    def __str__(self) -> str:
        limits = [f"a tilt of at most {self.max_tilt:.6g} degrees"] if self.max_tilt < 180 else []
        limits += [f"the side {' or '.join(self.down)} down"] if self.down != SIDES else []
        return " and ".join(limits) or "no limit"


ANY_TURN = Turning()
"""No limit."""


def _tilts(rotations: Floats) -> Floats:
    """Return the angles (n,) between the z axes before and after rotations, in radians."""
    x, y, z = rotations[:, :, 2].T
    return np.arctan2(np.hypot(x, y), z)


def _downwards(rotations: Floats) -> Floats:
    """Return the cosines (n, 6) between straight down and the outward direction of each side."""
    return np.asarray(-rotations[:, 2, :] @ _OUTWARDS.T)
