"""The Gymnasium environment `PackIt-v0` (paper, section 4).

An action is a number of one Discrete space whatever the stage: the index of a shape, a rotation, or
the C-order index of a location. `action_mask` in the observation marks the valid ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from packit_sim import rotations
from packit_sim.episode import Episode
from packit_sim.lattice import Triple, grid_nodes
from packit_sim.library import ShapeLibrary
from packit_sim.observations import Observation, VoxelObserver
from packit_sim.packs import STARTER_PACKS, Task, load_tasks
from packit_sim.scene import Scene

MAX_SHAPES = 50
"""Room for the shapes of a task in actions and observations: the paper's pool."""


class PackItEnv(gym.Env[Observation, np.int64]):
    """Packs the shapes of a task into its box, one choice a step.

    tasks: the name or path of a dataset (see `packs.load_tasks`), or tasks. library: name, path or
    open library, of the dataset's shapes. max_shapes: the most items that a task may have.
    render_mode: "rgb_array" or None.

    Observations are `VoxelObserver`'s. The reward is the placed volume over the volume of the
    task's items. info tells "task" (its number), "density" of the box, and, when the episode is
    over, "end": why.
    Raises ValueError where a setting is out of range or the tasks don't go together.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012
    action_space: spaces.Discrete

    def __init__(
        self,
        tasks: str | Path | Sequence[Task] = STARTER_PACKS,
        library: str | Path | ShapeLibrary = "everyday",
        max_shapes: int = MAX_SHAPES,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(
                f"render mode {render_mode!r} is not known: choose 'rgb_array' or None"
            )
        if isinstance(tasks, str | Path):
            opened = library if isinstance(library, ShapeLibrary) else ShapeLibrary.open(library)
            tasks = load_tasks(tasks, opened)
        self.tasks = tuple(tasks)
        self.cells = _common_cells(self.tasks, max_shapes)
        self.render_mode = render_mode
        actions = max(max_shapes, rotations.COUNT, math.prod(grid_nodes(self.cells)))
        self._observer = VoxelObserver(self.cells, max_shapes, actions)
        self.action_space = spaces.Discrete(actions)
        self.observation_space = self._observer.space
        self._episode: Episode | None = None
        self._task = 0
        self._scene: Scene | None = None

    @property
    def episode(self) -> Episode:
        """The episode being played. Raises RuntimeError before the first reset."""
        if self._episode is None:
            raise RuntimeError("there is no episode yet: call reset() first")
        return self._episode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts a task: a uniformly drawn one, or number `options["task"]`."""
        super().reset(seed=seed)
        number = (options or {}).get("task", int(self.np_random.integers(len(self.tasks))))
        if number not in range(len(self.tasks)):
            raise ValueError(f"there is no task {number!r}: choose 0 to {len(self.tasks) - 1}")
        self._task = int(number)
        self._episode = Episode(self.tasks[self._task])
        return self._observe(), self._info()

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Plays one choice; an episode is terminated as DESIGN says, and never truncated."""
        reward = self.episode.step(int(action))
        return self._observe(), reward, self.episode.end is not None, False, self._info()

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Bool (actions,): the valid actions, none when the episode is over."""
        mask = np.zeros(int(self.action_space.n), dtype=bool)
        if self.episode.end is None:
            valid = self.episode.action_mask()
            mask[: len(valid)] = valid
        return mask

    def render(self) -> npt.NDArray[np.uint8] | None:
        """The box as a picture (512, 512, 3), where the render mode is "rgb_array"."""
        if self.render_mode is None:
            return None
        if self._scene is None:
            self._scene = Scene(self.episode.box)
        self._scene.update(self.episode.box)
        return self._scene.snapshot().image

    def close(self) -> None:
        if self._scene is not None:
            self._scene.close()
            self._scene = None

    def _observe(self) -> Observation:
        return self._observer.observe(self.episode, self.action_masks())

    def _info(self) -> dict[str, Any]:
        episode = self.episode
        info: dict[str, Any] = {"task": self._task, "density": episode.box.density}
        if episode.end is not None:
            info["end"] = str(episode.end)
        return info


def _common_cells(tasks: Sequence[Task], max_shapes: int) -> Triple:
    """The box of all tasks. Raises ValueError where they differ or one has too many items."""
    boxes = {task.cells for task in tasks}
    if len(boxes) != 1:
        raise ValueError(f"the tasks of an environment must share one box, not {sorted(boxes)}")
    most = max(len(task.items) for task in tasks)
    if most > max_shapes:
        raise ValueError(f"a task has {most} items: max_shapes is only {max_shapes}")
    return boxes.pop()
