"""What a packed box is worth beyond its density: does it stand, and can it be packed at all?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_sim.engine.compaction import Compacted, compact, drops
from packit_sim.engine.disassembly import MOVES, Disassembly, disassemble, insertion_routes, share
from packit_sim.geometry.lattice import CELL, STEP
from packit_sim.physics.settings import DISTANCE, PhysicsSettings
from packit_sim.physics.settling import settle
from packit_sim.physics.stability import Stability, stability, stable_share
from packit_sim.placement import Contents, PlacedItem

FLOATS = STEP * CELL
"""Box units: an item that hangs higher above what is below it floats. On the grid all may hang by
up to a step of it."""


@dataclass(frozen=True, eq=False)
class PackQuality:
    """A packed box, judged.

    density: placed volume over the box's. stability, extraction, compacted: what came of letting
    go of it, of looking for ways in and out, and of pushing it together. floating: numbers of items
    that hang by more than `FLOATS`, the others as they are.
    """

    density: float
    stability: Stability
    disassembly: Disassembly
    compacted: Compacted
    floating: tuple[int, ...]

    def row(self) -> dict[str, float]:
        """All as numbers: shares of volume, but for counts of items."""
        before, after = self.compacted.filled
        return {
            "density": self.density,
            "stable": self.stability.whole,
            "stable as packed": self.stability.as_packed,
            "insertable": self.disassembly.insertable,
            "from above": self.disassembly.insertable_from_above,
            "removable": self.disassembly.removable,
            "interlocked": len(self.disassembly.interlocked),
            "floating": len(self.floating),
            "filled": before,
            "filled, pushed": after,
        }


def pack_quality(
    box: Contents[PlacedItem],
    settings: PhysicsSettings | None = None,
    *,
    distance: float = DISTANCE,
    moves: int = MOVES,
) -> PackQuality:
    """Judges a box: see `stability`, `extraction`, `compact` and `drops`, which take so long.

    Raises ValueError where distance or moves are not possible.
    """
    volume = sum(placed.item.volume for placed in box.placed)
    return PackQuality(
        volume / float(np.prod(np.array(box.cells) * CELL)),
        stability(box, settings, distance),
        disassemble(box, moves),
        compact(box),
        floating(box),
    )


@dataclass(frozen=True)
class QualityScores:
    """A packed box, judged in short: those of its scores that tell most for the time they take.

    stable, insertable: shares of volume. floating: how many items hang by more than `FLOATS`.
    """

    stable: float
    insertable: float
    floating: int

    @classmethod
    def of(
        cls, box: Contents[PlacedItem], settings: PhysicsSettings | None = None
    ) -> QualityScores:
        """The same numbers as of `pack_quality`, without all else that it finds out."""
        volumes = [placed.item.volume for placed in box.placed]
        return cls(
            stable_share(settle(box, settings)),
            share(volumes, insertion_routes(box)),
            len(floating(box)),
        )


def floating(box: Contents[PlacedItem]) -> tuple[int, ...]:
    """Numbers of items that hang by more than `FLOATS`, all others as they are."""
    return tuple(np.flatnonzero(drops(box) > FLOATS).tolist())
