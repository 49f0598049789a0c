"""A box in which a model decides what fits, instead of meshes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from packit_sim import placement
from packit_sim.box import Box
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import BOX_CELLS, ORIGIN, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask

Model = Callable[[Box, Item, npt.NDArray[np.int64]], npt.NDArray[np.bool_]]
"""Predicts whether an item is feasible at n locations (n, 3) that cells leave open: bool (n,)."""


class LearnedBox(Box):
    """A box whose meshes are never compared.

    Its state is the voxels of its items: placing one adds its voxels. Where they decide what is
    feasible, the answer is exact; at the locations that they leave open, a model predicts it.

    Parameters
    ----------
    model : Model
        The model.
    """

    def __init__(self, model: Model, cells: Sequence[int] = BOX_CELLS) -> None:
        super().__init__(cells)
        self._model = model

    def feasible(self, item: Item) -> Mask:
        return placement.feasible(self._occupancy, item, self._decide)

    def blbf(self, item: Item, start: Triple = ORIGIN, layers: int | None = None) -> Triple | None:
        return placement.blbf(self._occupancy, item, start, layers, self._decide)

    def feasible_in_any(self, item: Item) -> Mask:
        return np.logical_or.reduce(self.feasible_rotations(item))

    def _is_feasible(self, candidate: PlacedItem) -> bool:
        return placement.is_feasible(self._occupancy, candidate, self._decide)

    def _decide(self, item: Item, locations: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        return self._model(self, item, locations)
