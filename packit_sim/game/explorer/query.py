"""Queries about one item: its feasible locations, and its blockers elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from packit_sim.box import Box
from packit_sim.core.caches import cached_property
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import CELL, STEP, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Blockers, Mask, first


@dataclass(frozen=True, eq=False)
class FitQuery:
    """An item in a rotation, and a box that may have space for it.

    Parameters
    ----------
    box : Box
        The box; it must not change while the query is used.
    """

    box: Box
    item: Item

    @cached_property
    def mask(self) -> Mask:
        """The exact mask of feasible locations, bool (nx, ny, nz)."""
        return self.box.feasible(self.item)

    @cached_property
    def first(self) -> Triple | None:
        """The bottom-left-back-fill location; None if the item fits nowhere."""
        return first(self.mask)

    @property
    def centers(self) -> npt.NDArray[np.float64]:
        """The item's centres (n, 3) at all feasible locations, in box units."""
        return (np.argwhere(self.mask) * STEP + np.array(self.item.cells) / 2) * CELL

    def blockers(self, location: Triple) -> Blockers:
        """Return the blockers of the item at a location; false if there are none."""
        return self.box.why_not(self.item, location)

    def summary(self) -> str:
        """Describe the whole box in a sentence."""
        count = int(np.count_nonzero(self.mask))
        if count == 0:
            return (
                f"It fits nowhere in this rotation: none of {self.mask.size:,} locations is free."
            )
        return f"It fits at {count:,} of {self.mask.size:,} locations in this rotation."

    def answer(self, location: Triple) -> str:
        """Describe one location in a sentence: the item fits, or its blockers."""
        found = self.blockers(location)
        if not found:
            return f"At {location} it fits."
        reasons = []
        if found.walls:
            reasons.append(f"it sticks out at the {_listed(found.walls)}")
        if found.items:
            reasons.append(f"{_listed(self._names(found.items))} {_is(found.items)} in its way")
        if found.above:
            names = _listed(self._names(found.above))
            reasons.append(f"{names} {_is(found.above)} above it, on its way down")
        return f"At {location} it does not fit: {', and '.join(reasons)}."

    def _names(self, numbers: tuple[int, ...]) -> list[str]:
        placed: tuple[PlacedItem, ...] = self.box.placed
        return [f"{n} ({placed[n].item.shape.id})" for n in numbers]


def _listed(names: list[str] | tuple[str, ...]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def _is(numbers: tuple[int, ...]) -> str:
    return "is" if len(numbers) == 1 else "are"
