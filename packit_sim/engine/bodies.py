"""Where an item can stand among bodies that lie anywhere, in any turn, exactly.

The candidate stands on the grid as ever; what is in the box came to rest off it. Feasible means the
same (DESIGN: Feasible), with the cells of the box's own lattice that a body's mesh touches and
encloses where it lies, and with its collision mesh there. Cells first, then FCL for what they leave
open; `oracle` is the slow and obvious statement of the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import cached_property
from packit_sim.core.counters import count
from packit_sim.engine import feasibility, screening
from packit_sim.engine.collision import meets, meets_memo
from packit_sim.engine.feasibility import ORIGIN, Mask
from packit_sim.engine.occupancy import Occupancy, PlacedItem
from packit_sim.engine.screening_kernels import FREE, OPEN
from packit_sim.geometry.lattice import FINE_PER_CELL, Triple, grid_nodes
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxelization import lattice_cells
from packit_sim.geometry.voxels import Voxels, unpack


@dataclass(frozen=True, eq=False)
class PosedItem:
    """An item that lies somewhere in a box, or beside it.

    pose: (4, 4) shape-to-box matrix, of a turn, the item's scale and a shift. The item's own
    rotation is that in which it was placed.
    """

    item: Item
    pose: npt.NDArray[np.float64]

    @classmethod
    def of(cls, placed: PlacedItem) -> PosedItem:
        """An item where it was placed."""
        return cls(placed.item, placed.pose)

    @property
    def center(self) -> npt.NDArray[np.float64]:
        """(3,) where the centre of its shape's bounding box is, in box units."""
        return np.asarray(self.pose[:3, 3])

    @cached_property
    def vertices(self) -> npt.NDArray[np.float64]:
        """(n, 3) of its mesh, in box units."""
        return np.asarray(self.item.shape.mesh.vertices @ self.pose[:3, :3].T + self.center)

    @property
    def triangles(self) -> npt.NDArray[np.float64]:
        """(n, 3, 3) corners of its mesh, in box units."""
        return self.vertices[self.item.shape.mesh.faces]

    @cached_property
    def whole_cells(
        self,
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """What the oracle looks at: from which of the box's fine cells (3,) on, outer and inner."""
        start, touched, reached = lattice_cells(self.triangles)
        return start * FINE_PER_CELL, unpack(~reached), unpack(~(touched | reached))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PosedItem):
            return NotImplemented
        return self.item == other.item and np.array_equal(self.pose, other.pose)

    def __hash__(self) -> int:
        return hash((self.item, self.pose.tobytes()))


@dataclass(frozen=True, eq=False)
class Filled:
    """What a body fills of a box: voxels from a grid node, `location`, on."""

    body: PosedItem
    location: Triple
    voxels: Voxels


Bodies = Occupancy[Filled]
"""The cells of a box that bodies fill."""


def filled(cells: Triple, bodies: Iterable[PosedItem]) -> Bodies:
    """The cells that bodies fill of a box of so many; those wholly outside are left out.

    Raises ValueError where one is too large to voxelise (see `voxelization.fine_cells`).
    """
    occupancy: Bodies = Occupancy(cells)
    for body in bodies:
        location, voxels = Voxels.in_box(body.triangles, cells)
        if len(voxels.bricks):
            occupancy.add(Filled(body, location, voxels))
    return occupancy


def feasible(occupancy: Bodies, item: Item) -> Mask:
    """The exact mask: bool over the grid's nodes, True where the item is feasible."""
    mask = np.zeros(grid_nodes(occupancy.cells), dtype=bool)
    if not feasibility.fits(occupancy.cells, item):
        return mask
    states = screening.screen(occupancy, item)
    x, y, z = states.shape
    mask[:x, :y, :z] = states == FREE
    undecided = np.argwhere(states == OPEN)
    mask[tuple(undecided.T)] = ~_meets_any(occupancy, item, undecided)
    count("masks", states.size, len(undecided))
    return mask


def blbf(occupancy: Bodies, item: Item, start: Triple = ORIGIN) -> Triple | None:
    """The bottom-left-back-fill location: the feasible one that is least in (z, x, y), or None.

    start: where to begin, in that order.
    """
    if not feasibility.fits(occupancy.cells, item):
        return None
    placed = occupancy.placed
    undecided = 0
    for location, partners, looked_at in screening.unblocked(occupancy, item, start):
        undecided += len(partners) > 0
        candidate = PlacedItem(item, location)
        if not any(meets_memo(candidate, placed[n].body) for n in partners.tolist()):
            count("searches", looked_at, undecided)
            return location
    count("searches", math.prod(screening.locations(occupancy.cells, item)), undecided)
    return None


def is_feasible(occupancy: Bodies, candidate: PlacedItem) -> bool:
    """Whether one item is feasible at one location: the mask's value there."""
    if not feasibility.is_inside(occupancy.cells, candidate):
        return False
    state = screening.screen_at(occupancy, candidate)
    count("checks", 1, state == OPEN)
    at = np.array([candidate.location])
    return state == FREE or (state == OPEN and not _meets_any(occupancy, candidate.item, at)[0])


def oracle(cells: Triple, bodies: Sequence[PosedItem], item: Item) -> Mask:
    """The mask by the plain loop over all locations and all bodies: slow, and always right."""
    mask = np.zeros(grid_nodes(cells), dtype=bool)
    for i, j, k in np.ndindex(mask.shape):
        candidate = PlacedItem(item, (i, j, k))
        mask[i, j, k] = feasibility.is_inside(cells, candidate) and not any(
            conflicts(candidate, body) for body in bodies
        )
    return mask


def conflicts(candidate: PlacedItem, body: PosedItem) -> bool:
    """Whether an item can't stand where it does for a body, by the oracle's definition.

    As `placement.conflicts`, by whole arrays of fine cells and by FCL.
    """
    start, outer, inner = body.whole_cells
    own = np.array(candidate.start) * FINE_PER_CELL
    low = np.maximum(own, start)
    high = np.minimum(np.array(candidate.stop) * FINE_PER_CELL, start + outer.shape)
    if (low >= high).any():
        return False
    ours, theirs = (tuple(map(slice, low - at, high - at)) for at in (own, start))
    own_outer, own_inner = feasibility.whole_cells(candidate.item)
    return bool(
        (own_inner[ours] & outer[theirs]).any()
        or (own_outer[ours] & inner[theirs]).any()
        or meets(candidate, body)
    )


def _meets_any(
    occupancy: Bodies, item: Item, locations: npt.NDArray[np.int64]
) -> npt.NDArray[np.bool_]:
    """Whether a body's mesh crosses the item's at each of some locations (n, 3), by FCL.

    Asked only where the cells of the two leave it open; no location may be blocked by them.
    """
    crossing = np.zeros(len(locations), dtype=bool)
    if len(locations) == 0:
        return crossing
    placed = occupancy.placed
    for n, m in screening.open_pairs(occupancy, item, locations).tolist():
        if not crossing[n]:
            i, j, k = locations[n].tolist()
            crossing[n] = meets_memo(PlacedItem(item, (i, j, k)), placed[m].body)
    return crossing
