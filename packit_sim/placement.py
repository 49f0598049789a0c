"""Where can an item go? The public face of the placement engine (DESIGN: Feasible).

`feasible` gives the exact mask over all grid nodes, `blbf` the bottom-left-back-fill location, and
`oracle` the same mask from the plain loop over every location: slow, obvious, and always equal.
"""

from packit_sim.engine.feasibility import (
    ORIGIN,
    WALLS,
    Blockers,
    Contents,
    Mask,
    blbf,
    blockers,
    checked_location,
    conflicts,
    feasible,
    feasible_in_any,
    first,
    fits,
    is_feasible,
    is_inside,
    is_valid,
    oracle,
)

__all__ = [
    "ORIGIN",
    "WALLS",
    "Blockers",
    "Contents",
    "Mask",
    "blbf",
    "blockers",
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
