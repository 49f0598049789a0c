"""People's own parts, packed into boxes at their real sizes.

`packit_sim.pack` packs them. The names below check any packing off the grid: `removable` and
`packing_order` find straight moves in and out, `stacking` what rests on what, `stage_motions` what
gravity moves; `violations` and `drop_violations` apply `Requirements`, and `write_instructions`
writes pages for the person who packs.
"""

from packit_sim.parts.handling.dropping import DroppedPart, Reduced, drop_violations
from packit_sim.parts.handling.packing_stages import StageMotion, stage_motions
from packit_sim.parts.handling.removal import Removal, Route, StuckPart, removable
from packit_sim.parts.handling.requirements import (
    Requirements,
    Violation,
    packing_order,
    violations,
)
from packit_sim.parts.handling.supports import Stacking, lowered, stacking
from packit_sim.parts.results.instructions import write_instructions

__all__ = [
    "DroppedPart",
    "Reduced",
    "Removal",
    "Requirements",
    "Route",
    "Stacking",
    "StageMotion",
    "StuckPart",
    "Violation",
    "drop_violations",
    "lowered",
    "packing_order",
    "removable",
    "stacking",
    "stage_motions",
    "violations",
    "write_instructions",
]
