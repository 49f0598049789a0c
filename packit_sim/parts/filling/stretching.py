"""Search in space that is stretched along z, where distances are equal in all directions.

A mesh that is turned and then stretched depends on the rotation, unless that keeps z upright. So
each item becomes a type for each way up, of which together no more are packed than there are items.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import ROTATION_SLACK, Motion
from packit_sim.parts.nesting.balance import Balance
from packit_sim.parts.nesting.search_frames import searched_rotations
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.packings.rotation_sets import FIXED, matrices

MAX_YAWS = 360
"""Most steps of a full turn in a set of rotations."""


class StretchedTypes:
    """Types of items in stretched space, one for each way up.

    Parameters
    ----------
    types : sequence of ItemType
        The types.
    factor : float
        By what lengths along z are multiplied.

    Attributes
    ----------
    types : tuple of ItemType
        The stretched types.
    numbers : tuple of int
        The number of the type that each of these is made from.
    """

    def __init__(self, types: Sequence[ItemType], factor: float) -> None:
        self._scale = np.array((1.0, 1.0, factor))
        found = [
            (n, base, self._stretched(each, base, rotations))
            for n, each in enumerate(types)
            for base, rotations in _ways_up(each)
        ]
        self.numbers = tuple(n for n, _, _ in found)
        self._bases = tuple(base for _, base, _ in found)
        self.types = tuple(each for _, _, each in found)

    def _stretched(self, own: ItemType, base: Floats, rotations: str) -> ItemType:
        turned = (own.vertices @ base.T) * self._scale
        volume = own.volume * float(self._scale[2])
        settings = (own.demand, rotations, own.value, None, volume)
        return ItemType(own.name, turned, own.faces, *settings, clearance=own.clearance)

    def container(self, box: BoxContainer) -> BoxContainer:
        """Return a box, and what is in it, in stretched space."""
        obstacles = [
            replace(each, vertices=each.vertices * self._scale, known_volume=each.volume)
            for each in box.obstacles
        ]
        x, y, z = (np.array(box.size) * self._scale).tolist()
        return BoxContainer((x, y, z), tuple(obstacles), box.name)

    def limits(
        self, limits: Sequence[tuple[Sequence[float], float]], demands: Sequence[int]
    ) -> list[tuple[list[float], float]]:
        """Return limits on sums over all types, and that no more are packed than there are.

        Parameters
        ----------
        limits : sequence of (sequence of float, float)
            The limits on sums over the types, as `NestSettings` has them.
        demands : sequence of int
            How many there are of each type.

        Returns
        -------
        list of (list of float, float)
            The limits.
        """
        own = [([amounts[n] for n in self.numbers], most) for amounts, most in limits]
        several = [n for n in range(len(demands)) if self.numbers.count(n) > 1]
        return own + [
            ([float(number == n) for number in self.numbers], float(demands[n])) for n in several
        ]

    def balance(self, own: Balance) -> Balance:
        """Return the same limit on where the centre of gravity is."""
        centres = [
            ((base @ own.centres[n]) * self._scale).tolist()
            for n, base in zip(self.numbers, self._bases, strict=True)
        ]
        return Balance([own.weights[n] for n in self.numbers], centres, own.reach)

    def unstretched(self, one: Placement) -> Placement:
        """Return the placement of a type in real space."""
        rotation = one.pose.rotation @ self._bases[one.type]
        pose = Motion(rotation, one.pose.translation / self._scale)
        return replace(one, type=self.numbers[one.type], pose=pose)

    def stretched(self, one: Placement) -> Placement | None:
        """Return the placement of a stretched type, or None if it is in none of its rotations."""
        for n, (number, base) in enumerate(zip(self.numbers, self._bases, strict=True)):
            rotation = one.pose.rotation @ base.T
            known = matrices(self.types[n].rotations)
            if number == one.type and np.abs(known - rotation).max(axis=(1, 2)).min() < (
                ROTATION_SLACK
            ):
                pose = Motion(rotation, one.pose.translation * self._scale)
                return replace(one, type=n, pose=pose)
        return None


def _ways_up(item_type: ItemType) -> list[tuple[Floats, str]]:
    """Return rotations (3, 3) of an item, and those sets that may follow, about z or upside down.

    Together they are all rotations that the item may take.
    """
    left = list(searched_rotations(item_type))
    found = []
    while left:
        base = left[0]
        turns = [turn @ base.T for turn in left]
        upright = [n for n, turn in enumerate(turns) if abs(abs(turn[2, 2]) - 1) < 1e-9]
        name, own = _largest_set([turns[n] for n in upright])
        found.append((base, name))
        left = [turn for n, turn in enumerate(left) if n not in {upright[k] for k in own}]
    return found


def _largest_set(turns: Sequence[Floats]) -> tuple[str, list[int]]:
    """Return the largest set of rotations that are all among some, and the numbers of these."""
    for count in range(len(turns), 0, -1):
        for name in (f"flip-{count // 2}", f"yaw-{count}") if count > 1 else (FIXED,):
            if (count % 2 and name.startswith("flip")) or count > MAX_YAWS:
                continue
            errors = np.abs(matrices(name)[:, None] - np.array(turns)).max(axis=(2, 3))
            if (errors.min(axis=1) < 1e-9).all():
                return name, errors.argmin(axis=1).tolist()
    raise AssertionError("each rotation is a set alone")
