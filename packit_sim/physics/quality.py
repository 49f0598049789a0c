"""The quality of a pack beyond its density: its stability, and whether it can be packed at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from packit_sim.core.sums import plain_sum
from packit_sim.geometry.items import Contents, PlacedItem
from packit_sim.geometry.lattice import CELL, MOVES, STEP
from packit_sim.physics.settings import DISTANCE, PhysicsSettings
from packit_sim.physics.settling import settle
from packit_sim.physics.stability import Stability, stability, stable_share
from packit_sim.placement import (
    Compacted,
    Disassembly,
    compact,
    disassemble,
    drops,
    insertion_routes,
    routed_share,
)

FLOATING_HEIGHT = STEP * CELL
"""Box units: an item with a larger gap below it floats. On the grid, gaps of up to a grid step
can't be avoided."""


@dataclass(frozen=True, eq=False)
class PackQuality:
    """The quality of a pack.

    Attributes
    ----------
    density : float
        The placed volume, relative to the box's volume.
    stability : Stability
        Movements of the items under gravity.
    disassembly : Disassembly
        The routes of the items into the box and out of it.
    compacted : Compacted
        The items, pushed together.
    floating : tuple of int
        Numbers of the items with a gap below them of more than `FLOATING_HEIGHT`.
    """

    density: float
    stability: Stability
    disassembly: Disassembly
    compacted: Compacted
    floating: tuple[int, ...]

    def row(self) -> dict[str, float]:
        """Return all scores by name: shares of volume, except for counts of items."""
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
    """Measure the quality of a pack.

    Parameters
    ----------
    box : Contents
        The box and the items in it.
    settings : PhysicsSettings, optional
        The simulated world.
    distance : float, default: 0.05
        Box units by which no point of a stable item moves.
    moves : int, default: 3
        Largest number of straight moves in a route.

    Returns
    -------
    PackQuality
        The scores.

    Raises
    ------
    ArgumentError
        If `distance` is not above 0, or `moves` is less than 1.
    PhysicsError
        If an item can't be decomposed into convex pieces.

    Examples
    --------
    >>> import trimesh
    >>> from packit_sim import Box, Item, Shape, pack_quality
    >>> from packit_sim import DecompositionSettings, PhysicsSettings
    >>> brick = Item(Shape.from_mesh(trimesh.creation.box((4, 2, 1)), "brick"), scale=0.5)
    >>> box = Box()
    >>> for location in ((0, 0, 0), (0, 9, 0), (0, 0, 12)):
    ...     _ = box.place(brick, location)
    >>> settings = PhysicsSettings(decomposition=DecompositionSettings(method="bisection"))
    >>> quality = pack_quality(box, settings)
    >>> quality.floating  # nothing is right below the third item
    (2,)
    >>> round(quality.density, 3), round(quality.disassembly.insertable, 3)
    (0.125, 1.0)
    >>> round(quality.stability.whole, 3)
    0.667
    """
    volume = plain_sum(placed.item.volume for placed in box.placed)
    return PackQuality(
        volume / float(np.prod(np.array(box.cells) * CELL)),
        stability(box, settings, distance),
        disassemble(box, moves),
        compact(box),
        floating(box),
    )


@dataclass(frozen=True)
class QualityScores:
    """The most informative scores of a pack for the time they take.

    Attributes
    ----------
    stable : float
        Share of the volume that is stable.
    insertable : float
        Share of the volume that can be inserted.
    floating : int
        Number of items with a gap below them of more than `FLOATING_HEIGHT`.
    """

    stable: float
    insertable: float
    floating: int

    @classmethod
    def of(
        cls, box: Contents[PlacedItem], settings: PhysicsSettings | None = None
    ) -> QualityScores:
        """Compute the same scores as `pack_quality`, without the others."""
        volumes = [placed.item.volume for placed in box.placed]
        return cls(
            stable_share(settle(box, settings)),
            routed_share(volumes, insertion_routes(box)),
            len(floating(box)),
        )


def floating(box: Contents[PlacedItem]) -> tuple[int, ...]:
    """Find the numbers of the items with a gap below them of more than `FLOATING_HEIGHT`."""
    return tuple(np.flatnonzero(drops(box) > FLOATING_HEIGHT).tolist())
