"""The kinematic rule: locations that an item can reach from above, moving straight down.

PackIt's authors suggest it (paper, section 4). An item is *clear* at a location if it can be lifted
from there out of the box's open top: no placed item is above any part of it. As for feasibility
(docs/concepts/exactness.md), fine cells and collision meshes define this, for each placed item:

- no inner fine cell of the placed item is at or above an outer fine cell of the item, no outer one
  at or above an inner one, and
- no point of the placed item's collision mesh is above a point of the item's.

The second condition is exact for the whole motion; there are no time steps. Cheap filters come
first: columns of fine cells decide most locations, the meshes the others. Placed items may be on
the grid or off it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from packit_sim.core.caches import bounded_cache
from packit_sim.engine.feasibility import Mask
from packit_sim.engine.insertion_kernels import NONE, column_ends, required_heights
from packit_sim.engine.screening import Locations
from packit_sim.engine.sweeping import (
    AxisNumber,
    least_rise_oracle,
    posed_surface,
    surface,
    way_between,
)
from packit_sim.engine.sweeping_kernels import least_rise, rises
from packit_sim.geometry.deviation import Surface
from packit_sim.geometry.items import ItemInBox, PlacedItem, triangles
from packit_sim.geometry.lattice import CELL, FINE_PER_CELL, STEP
from packit_sim.geometry.shapes import Item
from packit_sim.geometry.voxelization import lattice_cells

COLUMNS_BUDGET = 48 * 2**20
"""Bytes in the process's cache of items' columns."""

OFF_GRID_COLUMNS_BUDGET = 16 * 2**20
"""Bytes in the process's cache of the columns of items off the grid."""

_FINE_PER_STEP = STEP * FINE_PER_CELL

Heights = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Columns:
    """The range of an item's fine cells in each column of its cell box.

    Attributes
    ----------
    low : Heights
        (x, y) int32, the bottom of the lowest outer fine cell in each column, in fine cells; `NONE`
        if there is none.
    high : Heights
        The top of the highest outer fine cell; `-NONE` if there is none.
    inner_low, inner_high : Heights
        The same for inner fine cells.
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
    """Look up the columns of an item."""
    voxels = item.voxels
    return Columns(*column_ends(voxels.outer_words), *column_ends(voxels.inner_words))


def insertable_mask(placed: Sequence[ItemInBox], item: Item, mask: Mask) -> Mask:
    """Restrict a mask of feasible locations to those at which the item is clear.

    Parameters
    ----------
    placed : sequence of ItemInBox
        The items already in the box.
    item : Item
        The item to place, in its rotation.
    mask : Mask
        Bool (nx, ny, nz) over the grid nodes, see `feasibility.feasible`.

    Returns
    -------
    Mask
        A new mask of the same shape.
    """
    found = mask.copy()
    if not placed or not mask.any():
        return found
    own = columns(item)
    no, yes = required_heights(own.low, own.inner_low, *_tops(tuple(placed)), mask.any(axis=2))
    levels = np.arange(mask.shape[2]) * _FINE_PER_STEP
    found &= levels >= no[..., None]
    undecided = np.argwhere(found & (levels < yes[..., None]))
    for other in placed:
        if len(undecided) == 0:
            break
        offsets = _offsets(item, undecided, other)
        below = rises(surface(item), _surface(other), offsets) < np.inf
        found[tuple(undecided[below].T)] = False
        undecided = undecided[~below]
    return found


def is_insertable(placed: Sequence[ItemInBox], candidate: ItemInBox) -> bool:
    """Decide whether an item is clear where it is.

    Parameters
    ----------
    placed : sequence of ItemInBox
        The items already in the box.
    candidate : ItemInBox
        On the grid an item that is feasible there. Off the grid any one: the meshes alone decide,
        also whether it crosses another item.

    Returns
    -------
    bool
        Whether it can be lifted straight up from there without meeting an item.
    """
    (left, back, bottom), (right, front, _) = _span(candidate)
    over = []
    for other in placed:
        (low_x, low_y, _), (high_x, high_y, top) = _span(other)
        if top > bottom and low_x < right and low_y < front and high_x > left and high_y > back:
            over.append(other)
    if not isinstance(candidate, PlacedItem):
        own = posed_surface(candidate)
        offsets = (other.center - candidate.center for other in over)
        return all(
            least_rise(own, _surface(other), offset, 0.0) == np.inf
            for other, offset in zip(over, offsets, strict=True)
        )
    if not over:
        return True
    mask = np.zeros(np.array(candidate.location) + 1, dtype=bool)
    mask[candidate.location] = True
    return bool(insertable_mask(over, candidate.item, mask)[candidate.location])


def free_way(
    candidate: ItemInBox, other: ItemInBox, axis: AxisNumber = 2, forward: bool = False
) -> float:
    """Compute how far an item can move straight, by default down, until it meets another one.

    Parameters
    ----------
    candidate : ItemInBox
        The item that moves.
    axis : {0, 1, 2}, default: 2
        The axis of the motion.
    forward : bool
        Whether it moves towards larger coordinates.

    Returns
    -------
    float
        Distance in box units; inf if they never meet. As in `sweeping.free_distance`, what crosses
        the item at the start is ignored.
    """
    if isinstance(candidate, PlacedItem):
        offset = _offsets(candidate.item, np.array([candidate.location]), other)[0]
    else:
        offset = other.center - candidate.center
    return way_between(_surface(candidate, axis), _surface(other, axis), offset, axis, forward)


def blockers_above(placed: Sequence[ItemInBox], candidate: PlacedItem) -> tuple[int, ...]:
    """Find the numbers of the placed items that are above an item at a feasible location."""
    return tuple(n for n, other in enumerate(placed) if not is_insertable([other], candidate))


def is_insertable_oracle(placed: Sequence[PlacedItem], candidate: PlacedItem) -> bool:
    """Decide whether an item is clear, by a loop over all fine cells and pairs of triangles."""
    own = candidate.item.voxels
    for other in placed:
        theirs = other.item.voxels
        apart = _FINE_PER_STEP * np.subtract(other.location, candidate.location)
        for mine, its in (
            (own.outer_fine, theirs.inner_fine),
            (own.inner_fine, theirs.outer_fine),
        ):
            in_or_above = np.logical_or.accumulate(mine, axis=2)
            cells = np.argwhere(its) + apart
            cells = cells[(cells >= 0).all(axis=1) & (cells[:, :2] < mine.shape[:2]).all(axis=1)]
            x, y, z = np.minimum(cells, np.array(mine.shape) - 1).T
            if in_or_above[x, y, z].any():
                return False
        offset = _offsets(candidate.item, np.array([candidate.location]), other)[0]
        if least_rise_oracle(surface(candidate.item), surface(other.item), offset) < np.inf:
            return False
    return True


def _offsets(item: Item, locations: Locations, other: ItemInBox) -> npt.NDArray[np.float64]:
    """Compute the offsets (n, 3) from the item's centre at each location to the other's.

    On the grid they are multiples of half a cell, so that the answer does not depend on where in
    the box the two items are.
    """
    twice_centers = 2 * STEP * locations + np.array(item.cells)
    if not isinstance(other, PlacedItem):
        return np.asarray(other.center - twice_centers * (CELL / 2))
    return np.asarray((np.add(other.start, other.stop) - twice_centers) * (CELL / 2))


def _surface(other: ItemInBox, axis: AxisNumber = 2) -> Surface:
    if isinstance(other, PlacedItem):
        return surface(other.item, axis)
    return posed_surface(other, axis)


def _span(other: ItemInBox) -> tuple[Sequence[float], Sequence[float]]:
    """Return the first and the last corner of an item, in cells."""
    if isinstance(other, PlacedItem):
        return other.start, other.stop
    low, high = (other.bounds / CELL).tolist()
    return low, high


@lru_cache(maxsize=8)  # many items are tried in one box
def _tops(placed: tuple[ItemInBox, ...]) -> tuple[Heights, Heights]:
    """Compute the tops of the highest outer and inner fine cells of placed items by column."""
    ends = [_column_tops(other) for other in placed]
    reach = np.max([np.add(start, high.shape) for start, _, high, _ in ends], axis=0)
    tops = np.full((2, *np.maximum(reach, 0)), -NONE, dtype=np.int32)
    for start, bottom, high, inner_high in ends:
        cut = np.maximum(np.negative(start), 0)  # items off the grid may protrude from the box
        x, y = np.maximum(start, 0)
        heights = np.stack([high, inner_high])[:, cut[0] :, cut[1] :] + np.int32(bottom)
        here = tops[:, x : x + heights.shape[1], y : y + heights.shape[2]]
        np.maximum(here, heights, out=here)
    return tops[0], tops[1]


def _column_tops(other: ItemInBox) -> tuple[tuple[int, int], int, Heights, Heights]:
    """Find the first column of an item, its bottom, and the tops of its outer and inner cells."""
    if isinstance(other, PlacedItem):
        theirs = columns(other.item)
        x, y, z = (n * FINE_PER_CELL for n in other.start)
        return (x, y), z, theirs.high, theirs.inner_high
    return _off_grid_tops(other)


@bounded_cache(
    "columns off the grid",
    OFF_GRID_COLUMNS_BUDGET,
    "bytes",
    size=lambda tops: 2 * tops[2].nbytes,
    key=lambda posed: (posed.item.key, posed.matrix.tobytes()),
)
def _off_grid_tops(other: ItemInBox) -> tuple[tuple[int, int], int, Heights, Heights]:
    start, touched, reached = lattice_cells(triangles(other))
    x, y, z = (start * FINE_PER_CELL).tolist()
    (_, high), (_, inner_high) = column_ends(~reached), column_ends(~(touched | reached))
    return (x, y), z, high, inner_high
