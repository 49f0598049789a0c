"""The public interface of the placement engine: where an item fits in a box.

`feasible` computes the exact mask over all grid nodes, `blbf` the bottom-left-back-fill location,
and `oracle` the same mask by a plain loop over all locations: slow, obvious, and always equal.
"""

from packit_sim.engine.feasibility import (
    WALLS,
    Blockers,
    Mask,
    blbf,
    blockers,
    candidates,
    checked_location,
    feasible,
    feasible_in_any,
    first,
    fits,
    is_feasible,
    is_inside,
)
from packit_sim.engine.oracle import conflicts, is_valid, oracle
from packit_sim.geometry.items import BoxState, Contents, ItemInBox, PlacedItem, PosedItem
from packit_sim.geometry.lattice import ORIGIN

__all__ = [
    "ORIGIN",
    "WALLS",
    "Blockers",
    "BoxState",
    "Contents",
    "ItemInBox",
    "Mask",
    "PlacedItem",
    "PosedItem",
    "blbf",
    "blockers",
    "candidates",
    "checked_location",
    "conflicts",
    "feasible",
    "feasible_in_any",
    "first",
    "fits",
    "is_feasible",
    "is_inside",
    "is_valid",
    "oracle",
]
