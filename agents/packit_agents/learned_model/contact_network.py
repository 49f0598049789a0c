"""The network that predicts what fits where voxels leave it open; it plays without torch."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from packit_agents.learned_model.contact_kernels import contact_features
from packit_agents.learned_model.learned_box import LearnedBox
from packit_agents.placements.network import PlacementNetwork
from packit_sim.box import Box
from packit_sim.core.assets import assets_folder
from packit_sim.geometry.items import BoxState, PlacedItem
from packit_sim.geometry.lattice import grid_nodes
from packit_sim.geometry.shapes import Item

_COUNTS = (
    *("shared", "words", "most", "pairs x", "pairs y", "pairs z", "cubes"),
    *("near inner", "near own inner", "near both", "bare", "own bare", "bare both"),
    *("between x", "between y", "between z"),
)


class ContactNetwork(PlacementNetwork):
    """A model of what fits: at open locations, the logarithm of the odds from the shared voxels.

    It is a function of `contact_features`, of the same form as a `PlacementNetwork`.
    """

    format = "packit-contacts"
    features = tuple(f"{level} {name}" for level in ("cells", "fine cells") for name in _COUNTS)

    def decide(
        self, box: Box, item: Item, locations: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.bool_]:
        """Predict whether an item is feasible at open locations (n, 3): bool (n,)."""
        return self(contact_features(box.arrays, item.voxels.arrays, locations)) > 0

    def probabilities(
        self, state: BoxState[PlacedItem], items: list[Item]
    ) -> npt.NDArray[np.float32]:
        """Predict the masks of items, such as one item in all rotations.

        Parameters
        ----------
        state : BoxState
            The state of the box, as `Box.snapshot` returns it.

        Returns
        -------
        ndarray
            float32 (items, nx, ny, nz), the probability that a location is feasible; 0 or 1 where
            voxels decide.
        """
        found = np.empty((len(items), *grid_nodes(state.cells)), dtype=np.float32)

        def keep(box: Box, item: Item, locations: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
            odds.append(
                (locations, self(contact_features(box.arrays, item.voxels.arrays, locations)))
            )
            return np.zeros(len(locations), dtype=bool)

        box = LearnedBox(keep, state.cells)
        box.restore(state)
        for n, item in enumerate(items):
            odds: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]] = []
            found[n] = box.feasible(item)
            for locations, logits in odds:
                found[n][tuple(locations.T)] = 1 / (1 + np.exp(-logits))
        return found


@cache
def bundled_network() -> ContactNetwork:
    """Read the bundled weights, once per process."""
    return ContactNetwork.read(assets_folder() / "weights" / "contacts.safetensors")
