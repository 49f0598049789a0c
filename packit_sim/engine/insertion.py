"""The kinematic rule: locations that an item can reach from above, moving straight down.

PackIt's authors suggest it (paper, section 4). An item is *clear* at a location when it can be
lifted from there out of the box's open top: nothing that is placed stands above any part of it. As
for feasibility (DESIGN: Feasible) that is said by fine cells and by the collision meshes, of each
placed item:
    no inner fine cell of the one stands in or above an outer fine cell of the other, and
    no point of the placed item's collision mesh is above a point of the item's.
The second is exact for the whole of the motion, not for steps of it. Cheap filters first: columns
of fine cells say yes, or no, to most locations; the meshes decide the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache
from packit_sim.engine.feasibility import Mask
from packit_sim.engine.insertion_kernels import NONE, column_ends, required_heights
from packit_sim.engine.items import PlacedItem
from packit_sim.engine.screening import Locations
from packit_sim.engine.sweeping import plainly_rises, surface
from packit_sim.engine.sweeping_kernels import rises
from packit_sim.geometry.lattice import CELL, FINE_PER_CELL, STEP
from packit_sim.geometry.shapes import Item

COLUMNS_BUDGET = 256 * 2**20
"""Bytes in the process's cache of items' columns."""

_FINE_PER_STEP = STEP * FINE_PER_CELL

Heights = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Columns:
    """What an item has in each column of fine cells: int32 (x, y) over its cell box, in fine cells.

    low, high: the bottom of the lowest outer one, and the top of the highest. inner_low,
    inner_high: the same of inner ones. `NONE` and `-NONE` where there is none.
    """

    low: Heights
    high: Heights
    inner_low: Heights
    inner_high: Heights


@bounded_cache(
    "columns",
    COLUMNS_BUDGET,
    "bytes",
    size=lambda columns: 4 * columns.low.nbytes,
    key=lambda item: item.key,
)
def columns(item: Item) -> Columns:
    """The columns of an item."""
    voxels = item.voxels
    return Columns(*column_ends(voxels.outer_words), *column_ends(voxels.inner_words))


def clear(placed: Sequence[PlacedItem], item: Item, mask: Mask) -> Mask:
    """The locations of a mask (see `placement.feasible`) at which the item is clear."""
    found = mask.copy()
    if not placed or not mask.any():
        return found
    own = columns(item)
    no, yes = required_heights(own.low, own.inner_low, *_tops(placed), mask.any(axis=2))
    levels = np.arange(mask.shape[2]) * _FINE_PER_STEP
    found &= levels >= no[..., None]
    undecided = np.argwhere(found & (levels < yes[..., None]))
    for other in placed:
        if len(undecided) == 0:
            break
        offsets = _offsets(item, undecided, other)
        below = rises(surface(item), surface(other.item), offsets) < np.inf
        found[tuple(undecided[below].T)] = False
        undecided = undecided[~below]
    return found


def is_clear(placed: Sequence[PlacedItem], candidate: PlacedItem) -> bool:
    """Whether a feasible item is clear at its location: as `clear`, for one location."""
    mask = np.zeros(np.array(candidate.location) + 1, dtype=bool)
    mask[candidate.location] = True
    return bool(clear(placed, candidate.item, mask)[candidate.location])


def above(placed: Sequence[PlacedItem], candidate: PlacedItem) -> tuple[int, ...]:
    """The numbers of the placed items that an item, feasible at its location, is not clear of."""
    return tuple(n for n, other in enumerate(placed) if not is_clear([other], candidate))


def oracle(placed: Sequence[PlacedItem], candidate: PlacedItem) -> bool:
    """Whether an item is clear: plainly, by all its fine cells and all pairs of triangles."""
    ours = candidate.item.voxels
    for other in placed:
        theirs = other.item.voxels
        apart = _FINE_PER_STEP * np.subtract(other.location, candidate.location)
        for mine, its in (
            (ours.outer_fine, theirs.inner_fine),
            (ours.inner_fine, theirs.outer_fine),
        ):
            in_or_above = np.logical_or.accumulate(mine, axis=2)
            cells = np.argwhere(its) + apart
            cells = cells[(cells >= 0).all(axis=1) & (cells[:, :2] < mine.shape[:2]).all(axis=1)]
            x, y, z = np.minimum(cells, np.array(mine.shape) - 1).T
            if in_or_above[x, y, z].any():
                return False
        offset = _offsets(candidate.item, np.array([candidate.location]), other)[0]
        if plainly_rises(surface(candidate.item), surface(other.item), offset) < np.inf:
            return False
    return True


def _offsets(item: Item, locations: Locations, other: PlacedItem) -> npt.NDArray[np.float64]:
    """(n, 3) from the item's centre at each location to the other's, by whole half cells.

    Thus the answer is a matter of the two items alone, wherever in the box they are.
    """
    twice_centers = 2 * STEP * locations + np.array(item.cells)
    return (np.add(other.start, other.stop) - twice_centers) * (CELL / 2)


def _tops(placed: Sequence[PlacedItem]) -> tuple[Heights, Heights]:
    """The top of the highest outer, and inner, fine cell of a box's columns, as far as it has."""
    reach = np.max([other.stop for other in placed], axis=0) * FINE_PER_CELL
    tops = np.full((2, *reach[:2]), -NONE, dtype=np.int32)
    for other in placed:
        theirs = columns(other.item)
        x, y, z = (n * FINE_PER_CELL for n in other.start)
        width, depth = theirs.high.shape
        here = tops[:, x : x + width, y : y + depth]
        np.maximum(here, np.stack([theirs.high, theirs.inner_high]) + np.int32(z), out=here)
    return tops[0], tops[1]
