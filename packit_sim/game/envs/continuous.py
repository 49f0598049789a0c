"""The environment `PackItContinuous-v0`: any position, any rotation, decided exactly."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from packit_sim.box import BaseBox
from packit_sim.core.checks import one_of
from packit_sim.core.errors import ArgumentError, StateError
from packit_sim.game.datasets.builtin import STARTER_PACKS
from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.env import MAX_SHAPES, check_size, wanted_task
from packit_sim.game.envs.observations import OBSERVERS, Observation
from packit_sim.game.envs.pictures import Pictured
from packit_sim.game.envs.specs import WritableSpec
from packit_sim.game.envs.task_source import GENERATED, Order, TaskMaker, TaskSource
from packit_sim.game.episodes.continuous import ContinuousEpisode
from packit_sim.game.episodes.episode import Stage
from packit_sim.game.episodes.policies import Policy
from packit_sim.game.episodes.policy_registry import load_policy
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.lattice import CELL, box_cells
from packit_sim.geometry.motions import Motion
from packit_sim.libraries.library import ShapeLibrary

if TYPE_CHECKING:  # loaded when needed
    from packit_sim.scene import Look

_OBSERVATIONS = ("features", "heightmap", "voxels", "none")

_NOT_OBSERVED = ("stage", "action_mask")
"""Fields about discrete choices."""

_SHORTEST = 1e-6
"""Length of a quaternion below which its direction means nothing."""


class PackItContinuousEnv(Pictured, WritableSpec, gym.Env[Observation, Any]):
    """Place the items of a task one by one, each at any position and in any rotation.

    An action is the position of the centre of the item's bounding box in its canonical rotation, x,
    y, z in box units, and a rotation as a quaternion w, x, y, z of any length. Nothing is on the
    grid: an item is placed if and only if its mesh is free there (see `placement.is_valid`). An
    item that is not stays outside, and the next one has its turn.

    Parameters
    ----------
    tasks : str, Path, sequence of Task, or callable
        As for `PackItEnv`; so are library, split, order, observation, max_shapes, render_mode and
        look.
    cells : tuple of int, optional
        Cells of the box along x, y and z; by default those of the tasks.
    shape : Policy or str
        The policy, or its name, that says whose turn it is.

    Attributes
    ----------
    cells : tuple of int
        Cells of the box along x, y and z.

    Raises
    ------
    ArgumentError
        If a setting is out of range or the tasks do not go together.
    TypeError
        If there is no setting of such a name.

    Notes
    -----
    The observation is that of `PackItEnv` without "stage" and "action_mask"; "chosen" is the item
    whose turn it is, and "item" its cells in the canonical rotation. `info` has "task", "placed"
    (whether the last action placed its item), "density", "placed_volume" and "end".

    Examples
    --------
    >>> import gymnasium
    >>> import packit_sim
    >>> env = gymnasium.make("PackItContinuous-v0", observation="none")
    >>> observation, info = env.reset(seed=0)
    >>> on_the_floor = [0.5, 0.5, env.unwrapped.episode.item.extents[2] / 2, 1, 0, 0, 0]
    >>> observation, reward, over, truncated, info = env.step(on_the_floor)
    >>> info["placed"], reward > 0
    (True, True)
    """

    action_space: spaces.Box

    def __init__(
        self,
        tasks: str | Path | Sequence[Task] | TaskMaker = STARTER_PACKS,
        library: str | Path | Mapping[str, Any] | ShapeLibrary | None = None,
        *,
        split: str | None = None,
        order: Order = "random",
        cells: Sequence[int] | None = None,
        shape: Policy | str = "largest-first",
        observation: str = "features",
        max_shapes: int = MAX_SHAPES,
        render_mode: str | None = None,
        look: Look | None = None,
    ) -> None:
        Pictured.__init__(self, render_mode, look)
        one_of("observation", observation, _OBSERVATIONS)
        box = None if cells is None else box_cells(cells)
        self._source = TaskSource(tasks, library, split, order, box)
        self.cells = box or self._source.cells
        self._max_shapes = max_shapes
        self._policy = load_policy(Stage.SHAPE, shape) if isinstance(shape, str) else shape
        for task in self._source.tasks:
            self._check(task)
        self._observer = OBSERVERS[observation](self.cells, max_shapes, max_shapes, ())
        fields = self._observer.space.spaces
        self._observed = tuple(name for name in fields if name not in _NOT_OBSERVED)
        self.observation_space = spaces.Dict({name: fields[name] for name in self._observed})
        low = np.array([0, 0, 0, -1, -1, -1, -1], dtype=np.float32)
        high = np.array([*(count * CELL for count in self.cells), 1, 1, 1, 1], dtype=np.float32)
        self.action_space = spaces.Box(low, high, dtype=np.float32)
        self._episode: ContinuousEpisode | None = None
        self._number = GENERATED
        self._episodes = 0

    @property
    def episode(self) -> ContinuousEpisode:
        """The episode being played. Raises StateError before the first reset."""
        if self._episode is None:
            raise StateError("there is no episode yet: call reset() first")
        return self._episode

    @property
    def _box(self) -> BaseBox[Any]:
        return self.episode.box

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start the next task; the options are those of `PackItEnv`."""
        wanted = wanted_task(options)
        named = None if wanted is None else self._source.named(wanted)
        super().reset(seed=seed)
        task, number = named or self._source.draw(self._number, self._episodes, self.np_random)
        self._check(task)
        self._number = number
        self._episodes += 1
        self._episode = ContinuousEpisode(task, self.cells)
        self._choose_next()
        self._show()
        return self._observe(False)

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Place the item whose turn it is, or leave it outside if it is not free there.

        Parameters
        ----------
        action : array_like
            Position and quaternion, seven finite numbers.

        Returns
        -------
        observation : dict
            See the class.
        reward : float
            The volume that was placed, as a share of the task's.
        terminated : bool
            Whether all items have had their turn.
        truncated : bool
            Always False.
        info : dict
            See the class.

        Raises
        ------
        StateError
            If called after termination.
        ArgumentError
            If the action is not seven finite numbers. The environment is unchanged.
        """
        episode = self.episode
        if episode.end is not None:
            raise StateError(f"the episode is over: {episode.end}: call reset()")
        reward = episode.step(self._posed(action))
        self._choose_next()
        self._show()
        observation, info = self._observe(reward > 0)
        return observation, reward, episode.end is not None, False, info

    def _choose_next(self) -> None:
        if self.episode.end is None:
            choice = self._policy(self.episode, self.np_random)  # type: ignore[arg-type]
            self.episode.choose(choice)

    def _posed(self, action: npt.ArrayLike) -> PosedItem | None:
        """Return the item at an action's pose; None if its quaternion is 0."""
        try:
            numbers = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != (7,) or not np.isfinite(numbers).all():
            raise ArgumentError(
                f"action {action!r:.80} is not possible: it must be x, y, z and a quaternion "
                "w, x, y, z, all finite"
            )
        position, (w, x, y, z) = numbers[:3], numbers[3:].tolist()
        length = math.hypot(w, x, y, z)
        if length < _SHORTEST:
            return None
        wxyz = w / length, x / length, y / length, z / length
        return PosedItem.at(self.episode.item, Motion.from_wxyz(wxyz, position))

    def _observe(self, placed: bool) -> tuple[Observation, dict[str, Any]]:
        episode = self.episode
        mask = np.zeros(self._max_shapes, dtype=bool)
        observed = self._observer.observe(episode, mask)  # type: ignore[arg-type] # all it reads
        density = episode.box.density
        info = {
            "task": self._number,
            "placed": placed,
            "density": density,
            "placed_volume": density * episode.box.volume,
            "end": str(episode.end or ""),
        }
        return {name: observed[name] for name in self._observed}, info

    def _check(self, task: Task) -> None:
        """Raise ArgumentError if a task does not fit this environment."""
        check_size(task, self.cells, self._max_shapes)
