"""The item that is being placed, and its feasible locations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim import placement
from packit_sim.box import BaseBox
from packit_sim.core.caches import cached_property
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask


class ChosenItem:
    """The item that is being placed, and its feasible locations.

    Results are computed when they are first needed, and kept. The box must not change meanwhile.

    Parameters
    ----------
    box : BaseBox
        The box to place it in.
    item : Item
        The item in the chosen rotation; in its canonical orientation if none is chosen yet.
    among : sequence of int, optional
        The rotations that `blbf` and `feasible` are over; by default the item's own.
    """

    def __init__(self, box: BaseBox[Any], item: Item, among: Sequence[int] | None = None) -> None:
        self._box = box
        self._among = among
        self._rotations: tuple[Triple, npt.NDArray[np.bool_]] | None = None
        self.item = item

    @cached_property
    def blbf(self) -> Triple | None:
        """The bottom-left-back-fill location, None if the item fits nowhere."""
        if self._among is None:
            return self._box.blbf(self.item)
        return placement.first(self.feasible)

    @cached_property
    def feasible(self) -> Mask:
        """The exact mask of feasible locations, bool (nx, ny, nz) over the grid nodes."""
        if self._among is None:
            return self._box.feasible(self.item)
        if len(self._among) == rotations.COUNT:
            return self._box.feasible_in_any(self.item)
        turned = map(self.item.turned, self._among)
        return np.logical_or.reduce([self._box.feasible(item) for item in turned])

    @cached_property
    def candidates(self) -> Mask:
        """A mask that contains all feasible locations, cheaper than `feasible`: see `Box`.

        It is for policies that look for one location: `is_feasible` decides whether it is feasible.
        """
        if self._among is not None or "feasible" in self.__dict__:
            return self.feasible
        return self._box.candidates(self.item)

    def is_feasible(self, location: Triple) -> bool:
        """Decide whether a location is feasible.

        Parameters
        ----------
        location : Triple
            The grid node (i, j, k).

        Returns
        -------
        bool
            The value of `feasible` there.
        """
        if self._among is not None or "feasible" in self.__dict__:
            return bool(self.feasible[location])
        return self._box.is_feasible(self.item, location)

    def rotations(self, location: Triple) -> npt.NDArray[np.bool_]:
        """Compute the rotations in which the item is feasible at a location.

        Parameters
        ----------
        location : Triple
            The grid node (i, j, k).

        Returns
        -------
        ndarray of bool, shape (24,)
            True for feasible rotations. It is cached until the next location; do not change it.
        """
        if self._rotations is None or self._rotations[0] != location:
            self._rotations = location, self._box.rotations_at(self.item, location)
        return self._rotations[1]
