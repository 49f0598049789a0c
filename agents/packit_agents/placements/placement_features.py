"""Placement features: a row of numbers for each placement, which a network compares."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_agents.placements.free_kernels import corners, count_free
from packit_agents.placements.free_space import FreeSpace, LoneItem
from packit_agents.placements.measure_kernels import MEASURES, measure, neighbours, sum_filled
from packit_sim.box import BaseBox
from packit_sim.core.caches import cached_property
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.lattice import Triple
from packit_sim.placement import PlacedItem

MAX_ITEMS = 6
"""Items whose placements are compared: the largest that fit."""

MAX_EXAMINED = 40
"""Feasible placements from which one is chosen after which the most volume still fits."""

PLACEMENT_FEATURES = (
    *(f"contact {way}{axis}" for axis in "xyz" for way in "-+"),
    "contact",
    *(f"extent {axis}" for axis in "xyz"),
    *(f"location {axis}" for axis in "xyz"),
    "top",
    "filled within",
    "filled around",
    *(f"free {way}{axis}" for axis in "xyz" for way in "-+"),
    "distance x",
    "distance y",
)

ITEM_FEATURES = (
    "log volume",
    "volume to largest",
    "volume to all outside",
    "log free locations",
    "share of free locations in this rotation",
    "share of rotations with free locations",
    "compactness",
)

STATE_FEATURES = (
    "density",
    "volume outside",
    "items outside",
    "volume outside that fits",
    "height",
)

FEATURES = PLACEMENT_FEATURES + ITEM_FEATURES + STATE_FEATURES
assert len(PLACEMENT_FEATURES) == MEASURES


@dataclass(frozen=True, eq=False)
class Placements:
    """Placements of items outside a box, with their features.

    Attributes
    ----------
    items : ndarray
        int64 (n,), the item.
    corners : ndarray
        int32 (n, 4), its rotation (an index of `TurnedItem.items`) and its location.
    features : ndarray
        float32 (n, features), see `FEATURES`.
    attainable : float
        Volume of the items outside, without those that are known to fit nowhere.
    space : FreeSpace
        The free space of the box.
    cells : tuple of int
        The cells of the box along x, y and z.
    kinematic : bool
        Whether items must come from above.
    outside : dict of int to int
        The number of equal items outside, for each item that is compared.
    """

    items: npt.NDArray[np.int64]
    corners: npt.NDArray[np.int32]
    features: npt.NDArray[np.float32]
    attainable: float
    space: FreeSpace
    cells: Triple
    kinematic: bool
    outside: dict[int, int]

    def __len__(self) -> int:
        return len(self.items)

    @cached_property
    def rotations(self) -> npt.NDArray[np.int64]:
        """The rotation of each, 0 to 23: int64 (n,)."""
        found = np.empty(len(self), dtype=np.int64)
        for item in self.outside:
            own = self.items == item
            turned = [turned.rotation for turned in self.space.items[item].items]
            found[own] = np.array(turned)[self.corners[own, 0]]
        return found

    def placed(self, number: int) -> PlacedItem:
        """Return the item of a placement, in its rotation and at its location."""
        rotation, i, j, k = self.corners[number].tolist()
        return PlacedItem(self.space.items[self.items[number]].items[rotation], (i, j, k))

    def is_feasible(self, number: int, box: BaseBox[Any]) -> bool:
        """Return whether the meshes allow a placement, which is removed from the space if not."""
        placed = self.placed(number)
        if box.is_feasible(placed.item, placed.location):
            return True
        rotation = int(self.corners[number, 0])
        self.space.remove(int(self.items[number]), rotation, placed.location)
        return False

    def lost(self, number: int) -> float:
        """Compute the volume of the items compared that would fit nowhere after a placement."""
        other = LoneItem(self.placed(number), self.cells, self.kinematic)
        total = 0.0
        for item, count in self.outside.items():
            left = count - int(item == self.items[number])
            if left and not self.space.fits_after(item, other):
                total += left * self.space.items[item].items[0].volume
        return total


def placements(box: BaseBox[Any], space: FreeSpace, outside: npt.NDArray[np.bool_]) -> Placements:
    """List the placements in corners of the largest items outside that fit, with their features.

    An item is in a corner where it can't move down by one grid step, nor along x, nor along y, at
    least one way each. In a kinematic box, the space below items counts as filled.

    Parameters
    ----------
    outside : ndarray
        Bool (n items,), the items to place. Of equal items the first counts, and of those that
        fit the `MAX_ITEMS` largest.

    Returns
    -------
    Placements
        The placements.
    """
    nz, volume = box.nodes[2], box.volume
    arrays = box.arrays
    closed = space.shadow(box) if box.kinematic else arrays
    near, sums = neighbours(arrays, nz), sum_filled(closed, nz)
    fitting = [n for n in np.flatnonzero(outside).tolist() if space.items[n].items]
    volumes = {n: space.items[n].items[0].volume for n in fitting}
    total, largest = plain_sum(volumes.values()), max(volumes.values(), default=0.0)
    equal = Counter(id(space.items[n]) for n in fitting)
    known: set[int] = set()
    compared: dict[int, int] = {}
    items: list[npt.NDArray[np.int64]] = []
    found, rows = [], []
    misfit = 0.0
    for n in sorted(fitting, key=lambda n: -volumes[n]):
        turned = space.items[n]
        if id(turned) in known:
            continue
        if len(items) == MAX_ITEMS:
            break
        known.add(id(turned))
        own_rows = space.rows(n, box)
        counts = count_free(own_rows)
        free = int(counts.sum())
        if free == 0:
            misfit += volumes[n]
            continue
        compared[n] = equal[id(turned)]
        own = corners(own_rows, turned.arrays[0])
        measured = measure(arrays, sums, near, turned.arrays, own)
        more = np.empty((len(own), len(ITEM_FEATURES)), dtype=np.float32)
        v = volumes[n]
        more[:, 0] = np.log(v / volume) / 4
        more[:, 1] = v / largest
        more[:, 2] = v / total
        more[:, 3] = np.log1p(free) / 10
        more[:, 4] = counts[own[:, 0]] / free
        more[:, 5] = np.count_nonzero(counts) / len(counts)
        more[:, 6] = v / volume / measured[:, 7:10].prod(axis=1)
        items.append(np.full(len(own), n))
        found.append(own)
        rows.append(np.concatenate([measured, more], axis=1))
    if not items:
        return Placements(
            np.empty(0, np.int64),
            np.empty((0, 4), np.int32),
            np.empty((0, len(FEATURES)), np.float32),
            0.0,
            space,
            box.cells,
            box.kinematic,
            compared,
        )
    features = np.concatenate(rows)
    filled = np.flatnonzero(np.diff(sums[-1, -1]))
    state = np.array(
        [
            box.density,
            total / volume,
            len(fitting) / 20,
            1 - misfit / total,
            (filled[-1] + 1) / nz if len(filled) else 0,
        ],
        dtype=np.float32,
    )
    features = np.concatenate(
        [features, np.broadcast_to(state, (len(features), len(state)))], axis=1
    )
    return Placements(
        np.concatenate(items),
        np.concatenate(found),
        features,
        total - misfit,
        space,
        box.cells,
        box.kinematic,
        compared,
    )


def choose(found: Placements, feasible: Iterable[int]) -> int | None:
    """Choose the first placement after which all items that are compared still fit somewhere.

    Parameters
    ----------
    feasible : iterable of int
        The numbers of feasible placements, the best first.

    Returns
    -------
    int or None
        The placement. If none of the first `MAX_EXAMINED` keeps all these items, it is the one
        that loses the least volume; None if no placement is feasible.
    """
    chosen, least = None, np.inf
    for number in itertools.islice(feasible, MAX_EXAMINED):
        lost = found.lost(number)
        if lost < least:
            chosen, least = number, lost
        if lost == 0:
            break
    return chosen
