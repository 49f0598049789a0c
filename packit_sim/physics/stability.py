"""How firmly a pack stands: what of it stays where it was packed when it is let go."""

from __future__ import annotations

from dataclasses import dataclass

from packit_sim.core.errors import ArgumentError
from packit_sim.physics.settings import DISTANCE, PhysicsSettings
from packit_sim.physics.settling import Settled, settle, settle_each
from packit_sim.placement import Contents, ItemInBox


@dataclass(frozen=True, eq=False)
class Stability:
    """What came of letting go of a pack.

    settled: of all its items at once; each: of each by itself on those before it, which are held.
    distance: box units by which no point of an item moves that counts as stable.
    """

    settled: Settled
    each: Settled
    distance: float

    @property
    def whole(self) -> float:
        """Share of the volume that is stable in the finished pack; 1 where there is none."""
        return stable_share(self.settled, self.distance)

    @property
    def as_packed(self) -> float:
        """Share of the volume that is stable when it is let go, item by item in packing order."""
        return stable_share(self.each, self.distance)


def stability(
    box: Contents[ItemInBox], settings: PhysicsSettings | None = None, distance: float = DISTANCE
) -> Stability:
    """Lets go of a pack, whole and item by item. Raises ValueError unless distance is above 0."""
    if not distance > 0:
        raise ArgumentError(f"distance {distance!r} is not possible: it must be above 0")
    return Stability(settle(box, settings), settle_each(box, settings), distance)


def stable_share(settled: Settled, distance: float = DISTANCE) -> float:
    """Share of the volume of which no point moved so far; 1 where there is none."""
    volumes = [item.item.volume for item in settled.items]
    stable = [item.item.volume for item in settled.items if item.farthest < distance]
    return sum(stable) / sum(volumes) if volumes else 1.0
