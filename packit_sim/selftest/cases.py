"""Cases of `packit selftest`: a box with items, and an item to place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.box import Box
from packit_sim.core.caches import cached_property
from packit_sim.geometry.items import BoxState, PlacedItem
from packit_sim.geometry.lattice import BOX_CELLS, CELL, STEP, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask, fits, oracle
from packit_sim.selftest.kinds import KINDS, Rng

EASY_SHARE = 0.25
"""Share of the cases in which all 24 rotations are compared."""

KINEMATIC_SHARE = 0.25
"""Share of the cases in which also the kinematic rule is compared."""


@dataclass(frozen=True, eq=False)
class Case:
    """A box with items, and an item to place: all that an answer depends on.

    Attributes
    ----------
    cells : Triple
        The cells of the box along x, y and z.
    placed : tuple of PlacedItem
        The items in the box, in the order of placing.
    item : Item
        The item to place.
    seed : tuple of int
        The seed from which the checks draw locations and orders.
    easy : bool
        Whether the item is compared in all 24 rotations, as for PackIt-Easy.
    kinematic : bool
        Whether items must come straight down.
    """

    cells: Triple
    placed: tuple[PlacedItem, ...]
    item: Item
    seed: tuple[int, ...] = (0,)
    easy: bool = False
    kinematic: bool = False

    @cached_property
    def truth(self) -> Mask:
        """The oracle's mask, without the kinematic rule."""
        return oracle(BoxState(self.cells, self.placed), self.item)

    def box(self, *, kinematic: bool = False) -> Box:
        """Create the box with its items."""
        box = Box(self.cells, kinematic=kinematic)
        box.restore(BoxState(self.cells, self.placed))
        return box

    def rng(self, name: str) -> Rng:
        """Create the random generator of a check."""
        return np.random.default_rng((*self.seed, *name.encode()))

    def border(self, count: int, rng: Rng) -> list[Triple]:
        """Draw locations inside the box, next to one with another answer if possible."""
        inside = self.truth[tuple(map(slice, locations_inside(self.cells, self.item)))]
        if inside.size == 0:
            return []
        near: npt.NDArray[np.bool_] = np.zeros(inside.shape, dtype=bool)
        for axis in range(3):
            changes = np.diff(inside, axis=axis)
            first, second = [slice(None)] * 3, [slice(None)] * 3
            first[axis], second[axis] = slice(None, -1), slice(1, None)
            near[tuple(first)] |= changes
            near[tuple(second)] |= changes
        return _drawn(near if near.any() else np.ones_like(near), count, rng)

    def near(self, count: int, rng: Rng) -> list[Triple]:
        """Draw locations at which bounding boxes overlap, some feasible and some not."""
        inside = locations_inside(self.cells, self.item)
        corner = np.moveaxis(np.indices(inside), 0, -1) * (STEP * CELL)
        center = corner + np.array(self.item.cells) * (CELL / 2)
        near: npt.NDArray[np.bool_] = np.zeros(inside, dtype=bool)
        for other in self.placed:
            reach = (self.item.extents + other.item.extents) / 2
            near |= (np.abs(center - other.center) < reach).all(axis=-1)
        truth = self.truth[tuple(map(slice, inside))]
        return _drawn(near & truth, count, rng) + _drawn(near & ~truth, count, rng)


def _drawn(mask: Mask, count: int, rng: Rng) -> list[Triple]:
    locations = np.argwhere(mask)
    drawn = rng.choice(locations, min(count, len(locations)), replace=False).tolist()
    return [(i, j, k) for i, j, k in drawn]


def locations_inside(cells: Triple, item: Item) -> Triple:
    """Count the locations along x, y and z at which an item is inside a box."""
    x, y, z = (max(0, (c - own) // STEP + 1) for c, own in zip(cells, item.cells, strict=True))
    return x, y, z


def kind_of(number: int) -> str:
    """Return the kind of a case: they take turns."""
    return tuple(KINDS)[number % len(KINDS)]


def draw_case(seed: int, number: int) -> Case:
    """Draw a case at random.

    Parameters
    ----------
    seed : int
        The seed of the run.
    number : int
        The number of the case in the run.

    Returns
    -------
    Case
        The case.
    """
    rng = np.random.default_rng((seed, number))
    cells: Triple = BOX_CELLS
    if rng.random() < 0.5:
        x, y, z = (STEP * rng.integers(8, 41, size=3)).tolist()
        cells = x, y, z
    items = KINDS[kind_of(number)](rng)
    item = next((item for item in reversed(items) if fits(cells, item)), items[-1])
    others = [other for other in items if other is not item]
    easy, kinematic = rng.random() < EASY_SHARE, rng.random() < KINEMATIC_SHARE
    return Case(cells, _filled(cells, others, rng), item, (seed, number), easy, kinematic)


def _filled(cells: Triple, items: list[Item], rng: Rng) -> tuple[PlacedItem, ...]:
    """Place what fits, each at its BLBF location or at one by chance in a corner of the box."""
    box = Box(cells)
    reach = int(rng.integers(3, max(box.nodes) + 1))
    for item in items:
        location = box.blbf(item)
        if location is None:
            continue
        if rng.random() < 0.6:
            locations = np.argwhere(box.feasible(item)[:reach, :reach, :reach])
            location = rng.choice(locations) if len(locations) else location
        box.place(item, location)
    return box.placed
