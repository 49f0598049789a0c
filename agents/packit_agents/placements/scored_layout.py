"""Layouts: items of a task in a box, placed by a scorer, and the free space for the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from packit_agents.placements.free_space import FreeSpace
from packit_agents.placements.placement_features import Placements, choose, placements
from packit_sim.box import BaseBox
from packit_sim.core.debugging import is_checking
from packit_sim.core.sums import plain_sum
from packit_sim.geometry.shapes import Item
from packit_sim.placement import BoxState, PlacedItem

Scorer = Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]]
"""Scores placements by their features: the network, or a rule."""


class ScoredLayout:
    """Items in a box, placed one after the other where a scorer wants them.

    Parameters
    ----------
    items : sequence of Item
        The items of the task.
    box : BaseBox
        The box, which belongs to the layout from now on. What is in it stays.
    allowed : tuple of int
        The rotations that the items may have.
    buffer : int, optional
        How many of the items outside are visible, the first ones; None for all.

    Attributes
    ----------
    placed : list
        (number, placed item) of each item in the box, in the order of placing.
    """

    def __init__(
        self,
        items: Sequence[Item],
        box: BaseBox[Any],
        allowed: tuple[int, ...],
        buffer: int | None = None,
    ) -> None:
        self._items = items
        self._buffer = buffer
        self._box = box
        self._fixed = tuple(box.placed)
        self._empty = FreeSpace.empty(items, box.cells, allowed)
        self._space = self._empty.copy()
        self.placed: list[tuple[int, PlacedItem]] = []

    @property
    def visible(self) -> npt.NDArray[np.bool_]:
        """Bool (n items,), the items that are not in the box and have arrived."""
        outside = np.ones(len(self._items), dtype=bool)
        outside[[number for number, _ in self.placed]] = False
        if self._buffer is not None:
            outside[np.flatnonzero(outside)[self._buffer :]] = False
        return outside

    @property
    def volume(self) -> float:
        """The volume of the items in the box."""
        return plain_sum(self._items[number].volume for number, _ in self.placed)

    def restart(
        self, placed: Sequence[tuple[int, PlacedItem]], space: FreeSpace | None = None
    ) -> Self:
        """Take out all items, and put back some that were in it together, in their order.

        Parameters
        ----------
        placed : sequence of (number, placed item)
            The items to put back.
        space : FreeSpace, optional
            The free space with these items, if it is known (see `free_space`).

        Returns
        -------
        ScoredLayout
            This layout.
        """
        self.placed = list(placed)
        inside = *self._fixed, *(item for _, item in placed)
        self._box.restore(BoxState(self._box.cells, inside))
        self._space = (space or self._empty).copy()
        self._check()
        return self

    def free_space(self) -> FreeSpace:
        """Compute the free space of the visible items, for a restart from the present items."""
        for number in np.flatnonzero(self.visible).tolist():
            self._space.rows(number, self._box)
        return self._space.copy()

    def placements(self) -> Placements:
        """List the placements in corners of the visible items; some may be infeasible."""
        return placements(self._box, self._space, self.visible)

    def place(self, found: Placements, order: Iterable[int]) -> int | None:
        """Place an item so that the other large ones still fit (see `placement_features.choose`).

        Parameters
        ----------
        found : Placements
            The placements of this layout.
        order : iterable of int
            The numbers of the placements to consider, the best first.

        Returns
        -------
        int or None
            The number of the chosen one; None if the meshes exclude all of them.
        """
        chosen = choose(found, (n for n in order if found.is_feasible(n, self._box)))
        if chosen is not None:
            placed = found.placed(chosen)
            self._box.put(placed.item, placed.location)
            self.placed.append((int(found.items[chosen]), placed))
            if self._box.opens_locations:
                self._space = self._empty.copy()
            self._check()
        return chosen

    def fill(
        self,
        scorer: Scorer,
        rng: np.random.Generator,
        temperature: float = 0.0,
        min_volume: float = 0.0,
    ) -> Self:
        """Place items until none fits, each time at the best placement (see `place`).

        Parameters
        ----------
        scorer : callable
            Scores the placements.
        temperature : float
            Factor on the noise that is added to the scores: at 1, placements are drawn with the
            probabilities that the scores mean.
        min_volume : float
            A volume: once it can't be reached any more, no further item is placed.

        Returns
        -------
        ScoredLayout
            This layout.
        """
        while len(found := self.placements()) and self.volume + found.attainable >= min_volume:
            scores = scorer(found.features)
            if temperature:
                noise = rng.gumbel(size=len(scores)).astype(np.float32)
                scores = scores + np.float32(temperature) * noise
            self.place(found, np.argsort(-scores, kind="stable").tolist())
        return self

    def _check(self) -> None:
        if is_checking():
            assert self._box.placed == (*self._fixed, *(item for _, item in self.placed))
            numbers = [number for number, _ in self.placed]
            assert len(set(numbers)) == len(numbers)
