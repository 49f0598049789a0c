"""Observations of an episode as arrays (paper, sections 4.1 and 4.2)."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from packit_sim.box import BaseBox
from packit_sim.core.sums import plain_sum
from packit_sim.game.envs.features import CubeMeans, Means
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.geometry import rotations
from packit_sim.geometry.items import ItemInBox
from packit_sim.geometry.lattice import CELL, STEP, Triple, grid_nodes
from packit_sim.geometry.voxels import centred

Observation = dict[str, Any]

BOX_CUBES = 10
"""Cubes along each axis of the box whose mean occupancy is a feature (the released settings)."""

SHAPE_CUBES = 8
"""Cubes along each axis of a shape."""

PLACEMENT_FEATURES = 8
"""Numbers that describe how a shape would be placed if it was the next."""

_FIELDS = {Stage.ROTATION: "rotations", Stage.LOCATION: "locations"}


class Observer:
    """Observes episodes as dicts of numbers and masks.

    Parameters
    ----------
    cells : Triple
        Cells of the box along each axis.
    max_shapes : int
        The largest number of items of a task.
    stages : Sequence[Stage]
        The stages, of rotation and location, to observe: those that the agent plays, or
        must know the result of.

    Attributes
    ----------
    space : spaces.Dict
        The observation space.
    cells, max_shapes, stages : Triple, int, Sequence[Stage]
        The arguments.

    Notes
    -----
    An observation contains:

    - stage: int, 0 shape, 1 rotation, 2 location.
    - chosen: int, the chosen shape; max_shapes if there is none yet.
    - outside: bool (max_shapes,), which shapes are still outside; in the online game the visible
      ones. All fields about a shape that has not arrived yet are 0.
    - rotations: bool (24,), if observed. At that stage the rotations that the chosen shape can
      have, afterwards the chosen one, before none.
    - locations: bool (x, y, z) over the grid nodes, if observed: the same for feasible locations.
    - volumes: float64 (max_shapes,), the volume of each shape in box units cubed, 0 for none.
    - action_mask: int8 (actions,), 1 for a valid action.

    The arrays of an observation share no memory with those of the previous one, as Gymnasium's
    environment checker requires.
    """

    def __init__(
        self, cells: Triple, max_shapes: int, actions: int, stages: Sequence[Stage]
    ) -> None:
        self.cells = cells
        self.max_shapes = max_shapes
        self.stages = stages
        self._volumes = np.zeros(max_shapes)
        self._episode: Episode | None = None
        self.space = spaces.Dict(
            {
                "stage": spaces.Discrete(len(Stage)),
                "chosen": spaces.Discrete(max_shapes + 1),
                "outside": _bools(max_shapes),
                "volumes": spaces.Box(0.0, (max(cells) * CELL) ** 3, (max_shapes,), np.float64),
                "action_mask": spaces.MultiBinary(actions),
                **{_FIELDS[stage]: _bools(*self._choices(stage)) for stage in stages},
            }
        )

    def observe(self, episode: Episode, action_mask: npt.NDArray[np.bool_]) -> Observation:
        """Observe the current state of an episode.

        Parameters
        ----------
        action_mask : ndarray of bool, shape (actions,)
            The valid actions.

        Returns
        -------
        Observation
            An element of `space`.
        """
        if episode is not self._episode:
            self._episode = episode
            self._volumes = np.zeros(self.max_shapes)
            self._volumes[: len(episode.task.items)] = [i.volume for i in episode.task.items]
            self._begin(episode)
        outside = np.zeros(self.max_shapes, dtype=bool)
        outside[: len(episode.outside)] = episode.visible
        return {
            "stage": int(episode.stage),
            "chosen": self.max_shapes if episode.shape is None else episode.shape,
            "outside": outside,
            "volumes": _arrived(episode, self._volumes),
            "action_mask": action_mask.astype(np.int8),
            **{_FIELDS[stage]: self._possible(episode, stage) for stage in self.stages},
        }

    def _choices(self, stage: Stage) -> tuple[int, ...]:
        return (rotations.COUNT,) if stage is Stage.ROTATION else grid_nodes(self.cells)

    def _possible(self, episode: Episode, stage: Stage) -> npt.NDArray[np.bool_]:
        """Mark the valid choices if a stage is the current one, else the choice that was made."""
        shape = self._choices(stage)
        if episode.end is None and episode.stage is stage:
            return episode.action_mask().reshape(shape)
        possible = np.zeros(shape, dtype=bool)
        chosen = episode.rotation if stage is Stage.ROTATION else episode.location
        if chosen is not None:
            possible[chosen] = True
        return possible

    def _begin(self, episode: Episode) -> None:
        """Compute the fields that depend only on the shapes of a new episode."""


class VoxelObserver(Observer):
    """Adds voxels, with cells of 1/100 box unit, to the observations of `Observer`.

    Notes
    -----
    An observation contains in addition, with m the largest number of cells along an axis:

    - box: bool (x, y, z) over the cells of the box, the outer cells of placed items.
    - shapes: bool (max_shapes, m, m, m), the outer cells of each shape in canonical orientation,
      centred; False for no shape. Read-only, and the same array in every second observation of an
      episode; in the online game a new one, while shapes are still to arrive.
    - item: bool (m, m, m), the chosen shape in the chosen rotation, centred; False before that.

    Each step allocates box and item, 2 MB for a box of 100 cells along each axis, and the mask.

    Code that copies observations needs far more memory: with 50 shapes in such a box an observation
    is 52 MB, and 208 MB as float32, which is how stable-baselines3 keeps rollouts. A rollout of 64
    steps takes 13 GB, and so does a replay buffer of 128 steps, which holds two observations a
    step. Observe features (0.1 MB) for such algorithms.
    """

    def __init__(
        self, cells: Triple, max_shapes: int, actions: int, stages: Sequence[Stage]
    ) -> None:
        super().__init__(cells, max_shapes, actions, stages)
        m = max(cells)
        self._item_shape = (m, m, m)
        self._shapes: list[npt.NDArray[np.bool_]] = []
        self.space = spaces.Dict(
            {
                **self.space.spaces,
                "box": _bools(*cells),
                "shapes": _bools(max_shapes, m, m, m),
                "item": _bools(m, m, m),
            }
        )

    def observe(self, episode: Episode, action_mask: npt.NDArray[np.bool_]) -> Observation:
        base = super().observe(episode, action_mask)
        self._shapes.reverse()
        item = np.zeros(self._item_shape, dtype=bool)
        if episode.chosen_item is not None and episode.rotation is not None:
            item = centred(episode.chosen_item.item.outer, self._item_shape)
        shapes = self._shapes[0]
        if episode.arrived < len(episode.outside):
            shapes = _arrived(episode, shapes)
            shapes.setflags(write=False)
        return {**base, "box": episode.box.outer, "shapes": shapes, "item": item}

    def _begin(self, episode: Episode) -> None:
        shapes = np.zeros((self.max_shapes, *self._item_shape), dtype=bool)
        for n, item in enumerate(episode.task.items):
            shapes[n] = centred(item.outer, self._item_shape)
        self._shapes = [shapes, shapes.copy()]
        for copy in self._shapes:
            copy.setflags(write=False)


class FeatureObserver(Observer):
    """Adds PackNN's features, mean occupancies of small cubes, to the observations of `Observer`.

    Notes
    -----
    An observation contains in addition (paper, section 4.2):

    - box: float32 (10, 10, 10), the shares of outer cells in cubes of the box.
    - shapes: float32 (max_shapes, 8, 8, 8), the same for each shape, as in `VoxelObserver`.
    - extents: float32 (max_shapes, 3), of each shape in canonical orientation, in box units.
    - item: float32 (8, 8, 8), for the chosen shape in the chosen rotation; 0 before that.
    """

    def __init__(
        self, cells: Triple, max_shapes: int, actions: int, stages: Sequence[Stage]
    ) -> None:
        super().__init__(cells, max_shapes, actions, stages)
        m = max(cells)
        self._item_means = CubeMeans((m, m, m), SHAPE_CUBES)
        self._box_means = CubeMeans(cells, BOX_CUBES)
        x, y, z = grid_nodes(cells)
        self._words = np.zeros((z, x, y), dtype=np.uint64).transpose(1, 2, 0)  # as those of boxes
        self._counts = np.zeros([BOX_CUBES] * 3, dtype=np.int32)
        self._all_bricks = np.zeros(3, dtype=np.int64), np.array((x, y, z)) - 1
        self._placed: tuple[ItemInBox, ...] = ()
        self._shapes = np.zeros((max_shapes, *[SHAPE_CUBES] * 3), dtype=np.float32)
        self._extents = np.zeros((max_shapes, 3), dtype=np.float32)
        self.space = spaces.Dict(
            {
                **self.space.spaces,
                "box": spaces.Box(0, 1, self._counts.shape, np.float32),
                "shapes": spaces.Box(0, 1, self._shapes.shape, np.float32),
                "extents": spaces.Box(0, max(cells) * CELL, self._extents.shape, np.float32),
                "item": spaces.Box(0, 1, self._shapes.shape[1:], np.float32),
            }
        )

    def observe(self, episode: Episode, action_mask: npt.NDArray[np.bool_]) -> Observation:
        base = super().observe(episode, action_mask)
        item = np.zeros(self._shapes.shape[1:], dtype=np.float32)
        if episode.chosen_item is not None and episode.rotation is not None:
            item = self._item_means.of_item(episode.chosen_item.item).copy()
        return {
            **base,
            "box": self._means_of(episode.box),
            "shapes": _arrived(episode, self._shapes),
            "extents": _arrived(episode, self._extents),
            "item": item,
        }

    def _means_of(self, box: BaseBox[Any]) -> Means:
        """Compute the means of a box, where items were only added from the bricks around these."""
        placed, known = box.placed, len(self._placed)
        changed = self._all_bricks
        if placed and known <= len(placed) and all(map(operator.is_, self._placed, placed)):
            spans = box.spans[max(known - 1, 0) :]
            changed = spans[:, :3].min(axis=0), spans[:, 3:].max(axis=0)
        self._placed = placed
        return self._box_means.of_box(box.outer_words, self._words, self._counts, changed)

    def _begin(self, episode: Episode) -> None:
        self._shapes[:] = 0
        self._extents[:] = 0
        for n, item in enumerate(episode.task.items):
            self._shapes[n] = self._item_means.of_item(item)
            self._extents[n] = item.extents


class PlacementFeatureObserver(FeatureObserver):
    """Adds placement features to the observations of `FeatureObserver`.

    Notes
    -----
    An observation contains in addition:

    - placement_features: float32 (max_shapes, 8), how `Episode.heuristic_placement` would place
      each shape that is outside: 1 if it fits, else 0; the min corner (x, y, z) and the extents
      (x, y, z) as shares of the box's extents; the volume as a share of the box's volume.

    If a shape does not fit, the corner is 0 and the extents are those of the aligned rotation. All
    are 0 for a shape that is not outside.
    """

    def __init__(
        self, cells: Triple, max_shapes: int, actions: int, stages: Sequence[Stage]
    ) -> None:
        super().__init__(cells, max_shapes, actions, stages)
        self._size = np.array(cells) * CELL
        limit = np.full((max_shapes, PLACEMENT_FEATURES), np.inf, dtype=np.float32)
        self.space = spaces.Dict(
            {**self.space.spaces, "placement_features": spaces.Box(np.zeros_like(limit), limit)}
        )

    def observe(self, episode: Episode, action_mask: npt.NDArray[np.bool_]) -> Observation:
        base = super().observe(episode, action_mask)
        features = np.zeros((self.max_shapes, PLACEMENT_FEATURES), dtype=np.float32)
        for n in np.flatnonzero(episode.visible).tolist():
            item, found = episode.task.items[n], episode.heuristic_placement(n)
            turned = found.item if found else episode.rules.by_alignment(item)[0]
            features[n, 4:7] = turned.extents / self._size
            features[n, 7] = item.volume / self._size.prod()
            if found is not None:
                features[n, 0] = 1
                features[n, 1:4] = np.array(found.location) * STEP * CELL / self._size
        return {**base, "placement_features": features}


class HeightmapObserver(Observer):
    """Adds heightmaps, as papers on online packing use them, to the observations of `Observer`.

    Notes
    -----
    An observation contains in addition, with m the largest number of cells along an axis, and all
    heights those of outer cells, in box units:

    - heightmap: float32 (x, y) over the cells of the box: the top of the highest filled cell of
      each column, 0 if it is empty.
    - shapes: float32 (max_shapes, 2, m, m), the bottom of the lowest cell and the top of the
      highest of each column of a shape in canonical orientation, above its own lowest cell; 0 for
      columns without cells. The corner of its cell box is at [0, 0].
    - item: float32 (2, m, m), the same for the chosen shape in the chosen rotation; 0 before that.

    With 50 shapes in a box of 100 cells along each axis an observation is 4 MB.
    """

    def __init__(
        self, cells: Triple, max_shapes: int, actions: int, stages: Sequence[Stage]
    ) -> None:
        super().__init__(cells, max_shapes, actions, stages)
        m = max(cells)
        self._shapes = np.zeros((max_shapes, 2, m, m), dtype=np.float32)
        high = np.float32(m * CELL)
        self.space = spaces.Dict(
            {
                **self.space.spaces,
                "heightmap": spaces.Box(0, high, cells[:2], np.float32),
                "shapes": spaces.Box(0, high, self._shapes.shape, np.float32),
                "item": spaces.Box(0, high, (2, m, m), np.float32),
            }
        )

    def observe(self, episode: Episode, action_mask: npt.NDArray[np.bool_]) -> Observation:
        base = super().observe(episode, action_mask)
        item = np.zeros(self._shapes.shape[1:], dtype=np.float32)
        if episode.chosen_item is not None and episode.rotation is not None:
            _write_heights(item, episode.chosen_item.item.outer)
        heights = np.zeros((2, *self.cells[:2]), dtype=np.float32)
        _write_heights(heights, episode.box.outer)
        return {
            **base,
            "heightmap": heights[1],
            "shapes": _arrived(episode, self._shapes),
            "item": item,
        }

    def _begin(self, episode: Episode) -> None:
        self._shapes[:] = 0
        for heights, item in zip(self._shapes, episode.task.items, strict=False):
            _write_heights(heights, item.outer)


OBSERVERS: dict[str, Callable[[Triple, int, int, Sequence[Stage]], Observer]] = {
    "features": FeatureObserver,
    "heightmap": HeightmapObserver,
    "placement-features": PlacementFeatureObserver,
    "voxels": VoxelObserver,
    "none": Observer,
}
"""The choices of the environment's setting `observation`."""


def with_values(space: spaces.Dict, max_shapes: int) -> spaces.Dict:
    """Add the field "values" to an observation space, for rules that count values."""
    shares = spaces.Box(0.0, 1.0, (max_shapes,), np.float64)
    return spaces.Dict({**space.spaces, "values": shares})


def value_shares(episode: Episode, max_shapes: int) -> npt.NDArray[np.float64]:
    """Compute the field "values": each arrived shape's share of the value of all, 0 for none."""
    shares = np.zeros(max_shapes)
    values = episode.task.values
    shares[: len(values)] = np.array(values) / plain_sum(values)
    return _arrived(episode, shares)


def _arrived(episode: Episode, rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Copy an array of a row for each shape, with 0 for those that have not arrived."""
    copy = rows.copy()
    copy[episode.arrived :] = 0
    return copy


def _write_heights(heights: npt.NDArray[np.float32], cells: npt.NDArray[np.bool_]) -> None:
    """Write the bottom and the top of each column of cells [x, y, z] to an array of zeros."""
    x, y, z = cells.shape
    filled = cells.any(axis=2)
    heights[0, :x, :y][filled] = cells.argmax(axis=2)[filled] * CELL
    heights[1, :x, :y][filled] = (z - cells[:, :, ::-1].argmax(axis=2)[filled]) * CELL


def _bools(*shape: int) -> spaces.Box:
    return spaces.Box(0, 1, shape, np.bool_)  # type: ignore[arg-type]
