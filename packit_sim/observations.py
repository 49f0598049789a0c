"""What an agent sees of an episode, as arrays: voxels at cells of 1/100 (paper, section 4.1)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from packit_sim.episode import Episode, Stage
from packit_sim.lattice import CELL, Triple
from packit_sim.voxels import centred

Observation = dict[str, Any]


class VoxelObserver:
    """Observes the episodes of tasks of up to `max_shapes` items in boxes of so many cells an axis.

    An observation is a dict:
        stage: int, 0 shape, 1 rotation, 2 location.
        box: bool (x, y, z) over the box's cells, the placed items' outer cells.
        shapes: bool (max_shapes, m, m, m), m the box's most cells an axis: each shape's outer cells
            in canonical orientation, centred; False where there is no shape.
        outside: bool (max_shapes,), which shapes are still outside.
        volumes: float64 (max_shapes,), each shape's volume in box units cubed, 0 for none.
        chosen: int, the chosen shape, or max_shapes before one is.
        item: bool (m, m, m), the chosen shape in the chosen rotation; False before.
        action_mask: int8 (actions,), 1 for a valid action.
    Its arrays are the receiver's own: Gymnasium's checker demands that no two observations share
    memory, though copying the shapes is most of what one costs.
    """

    def __init__(self, cells: Triple, max_shapes: int, actions: int) -> None:
        m = max(cells)
        self._item_shape = (m, m, m)
        self._max_shapes = max_shapes
        self.space = spaces.Dict(
            {
                "stage": spaces.Discrete(len(Stage)),
                "box": _bools(*cells),
                "shapes": _bools(max_shapes, m, m, m),
                "outside": _bools(max_shapes),
                "volumes": spaces.Box(0.0, math.prod(cells) * CELL**3, (max_shapes,), np.float64),
                "chosen": spaces.Discrete(max_shapes + 1),
                "item": _bools(m, m, m),
                "action_mask": spaces.MultiBinary(actions),
            }
        )
        self._shapes = np.zeros((max_shapes, *self._item_shape), dtype=bool)
        self._volumes = np.zeros(max_shapes)
        self._episode: Episode | None = None

    def observe(self, episode: Episode, action_mask: npt.NDArray[np.bool_]) -> Observation:
        """The observation of an episode as it stands."""
        if episode is not self._episode:
            self._episode = episode
            self._look_at_shapes(episode)
        outside = np.zeros(self._max_shapes, dtype=bool)
        outside[: len(episode.outside)] = episode.outside
        turned = None if episode.choice is None else episode.choice.item.outer
        return {
            "stage": int(episode.stage),
            "box": episode.box.outer,
            "shapes": self._shapes.copy(),
            "outside": outside,
            "volumes": self._volumes.copy(),
            "chosen": self._max_shapes if episode.shape is None else episode.shape,
            "item": np.zeros(self._item_shape, dtype=bool)
            if turned is None
            else centred(turned, self._item_shape),
            "action_mask": action_mask.astype(np.int8),
        }

    def _look_at_shapes(self, episode: Episode) -> None:
        self._shapes[:] = False
        self._volumes[:] = 0
        for n, item in enumerate(episode.task.items):
            self._shapes[n] = centred(item.outer, self._item_shape)
            self._volumes[n] = item.volume


def _bools(*shape: int) -> spaces.Box:
    return spaces.Box(0, 1, shape, np.bool_)  # type: ignore[arg-type]
