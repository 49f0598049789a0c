"""The stability of a pack: the share that stays where it was packed under gravity."""

from __future__ import annotations

from dataclasses import dataclass

from packit_sim.core.checks import POSITIVE, check_range
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.items import Contents, ItemInBox
from packit_sim.physics.settings import DISTANCE, PhysicsSettings
from packit_sim.physics.settling import Settled, settle, settle_each


@dataclass(frozen=True, eq=False)
class Stability:
    """The movements of a pack's items under gravity.

    Attributes
    ----------
    settled : Settled
        All items, released at once.
    each : Settled
        The items, each released on the items placed before it, which are fixed.
    distance : float
        Box units by which no point of a stable item moves.
    """

    settled: Settled
    each: Settled
    distance: float

    @property
    def whole(self) -> float:
        """Share of the volume that is stable in the finished pack; 1 without items."""
        return stable_share(self.settled, self.distance)

    @property
    def as_packed(self) -> float:
        """Share of the volume that is stable when items are released one by one."""
        return stable_share(self.each, self.distance)


def stability(
    box: Contents[ItemInBox], settings: PhysicsSettings | None = None, distance: float = DISTANCE
) -> Stability:
    """Release the items of a pack, all at once and one by one.

    Parameters
    ----------
    box : Contents
        The box and the items in it.
    settings : PhysicsSettings, optional
        The simulated world.
    distance : float, default: 0.05
        Box units by which no point of a stable item moves.

    Returns
    -------
    Stability
        The movements of the items.

    Raises
    ------
    ArgumentError
        If `distance` is not above 0.
    PhysicsError
        If an item can't be decomposed into convex pieces.
    """
    check_range("distance", distance, POSITIVE)
    return Stability(settle(box, settings), settle_each(box, settings), distance)


def stable_share(settled: Settled, distance: float = DISTANCE) -> float:
    """Compute the share of the volume in items that moved less than a distance; 1 without items."""
    volumes = [item.item.volume for item in settled.items]
    stable = [item.item.volume for item in settled.items if item.farthest < distance]
    return plain_sum(stable) / plain_sum(volumes) if volumes else 1.0
