"""The public face of the placement engine; nothing outside `engine` imports its insides.

- *Where does an item fit in a box?* `feasible` computes the exact mask over all grid nodes, `blbf`
  the bottom-left-back-fill location, and `oracle` the same mask by a plain loop over all
  locations: slow, obvious, and always equal. `Occupancy` is the state that they read.
- *Does it rest on something?* `support` is the share of its base that does.
- *Can it be put in, or taken out?* `insertable_mask` for straight moves down, `disassemble` and
  `insertion_routes` for several moves on the grid, `free_way`, `compact` and `drops` off it.
- *Meshes off the grid*: `LooseMesh` for collisions and distances, `winding_number` and
  `PartArrays` for containment, `least_rise` for the free way along an axis.
- *For kernels* of other packages: the arrays of a box and the functions that read them.
"""

from packit_sim.engine.collision_meshes import LooseMesh, collision_mesh, triangles_cross
from packit_sim.engine.compaction import Compacted, compact, drops
from packit_sim.engine.containment import PartArrays
from packit_sim.engine.containment_kernels import holds, winding_number
from packit_sim.engine.disassembly import (
    Disassembly,
    disassemble,
    insertion_routes,
    routed_share,
)
from packit_sim.engine.feasibility import (
    WALLS,
    Blockers,
    Decide,
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
from packit_sim.engine.insertion import (
    blockers_above,
    free_way,
    insertable_mask,
    is_insertable,
    is_insertable_oracle,
)
from packit_sim.engine.nofit import MEETINGS_BEFORE_TABLE, NoFit, no_fit_tables
from packit_sim.engine.occupancy import Occupancy
from packit_sim.engine.occupancy_kernels import BoxArrays
from packit_sim.engine.oracle import conflicts, is_valid, oracle
from packit_sim.engine.screening import location_counts
from packit_sim.engine.screening_kernels import (
    BLOCKED,
    brick_conflicts,
    brick_offsets,
    brick_state,
    state_at,
)
from packit_sim.engine.support import support, support_oracle, supported_mask
from packit_sim.engine.sweeping import AxisNumber, cyclic, reordered
from packit_sim.engine.sweeping_kernels import least_rise
from packit_sim.geometry.items import BoxState, Contents, ItemInBox, PlacedItem, PosedItem
from packit_sim.geometry.lattice import ORIGIN

__all__ = [
    "BLOCKED",
    "MEETINGS_BEFORE_TABLE",
    "ORIGIN",
    "WALLS",
    "AxisNumber",
    "Blockers",
    "BoxArrays",
    "BoxState",
    "Compacted",
    "Contents",
    "Decide",
    "Disassembly",
    "ItemInBox",
    "LooseMesh",
    "Mask",
    "NoFit",
    "Occupancy",
    "PartArrays",
    "PlacedItem",
    "PosedItem",
    "blbf",
    "blockers",
    "blockers_above",
    "brick_conflicts",
    "brick_offsets",
    "brick_state",
    "candidates",
    "checked_location",
    "collision_mesh",
    "compact",
    "conflicts",
    "cyclic",
    "disassemble",
    "drops",
    "feasible",
    "feasible_in_any",
    "first",
    "fits",
    "free_way",
    "holds",
    "insertable_mask",
    "insertion_routes",
    "is_feasible",
    "is_insertable",
    "is_insertable_oracle",
    "is_inside",
    "is_valid",
    "least_rise",
    "location_counts",
    "no_fit_tables",
    "oracle",
    "reordered",
    "routed_share",
    "state_at",
    "support",
    "support_oracle",
    "supported_mask",
    "triangles_cross",
    "winding_number",
]
