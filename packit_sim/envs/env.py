"""The Gymnasium environments `PackIt-v0`, `PackItEasy-v0` and `PackItPhysics-v0`: one class.

An action is a number of one Discrete space whatever the stage: the index of a shape, a rotation, or
the C-order index of a location. `action_mask` in the observation marks the valid ones.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from packit_sim.box import Box
from packit_sim.core.counters import counters
from packit_sim.core.errors import ArgumentError, StateError
from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.datasets.packs import STARTER_PACKS, Task, load_tasks
from packit_sim.engine.base_box import BaseBox
from packit_sim.engine.feasibility import Contents
from packit_sim.envs.observations import OBSERVERS, Observation
from packit_sim.game.agents import Policy, load_policy
from packit_sim.game.episode import EASY_ORDER, ORDER, Episode, Stage, State
from packit_sim.generation.task_sampler import TaskSampler
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import BOX_CELLS, Triple, box_cells, grid_nodes
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.settings import PhysicsSettings

if TYPE_CHECKING:  # loaded when needed: whoever only plays needs none of them
    from packit_sim.render.layouts import Layout
    from packit_sim.scene import Look, Scene
    from packit_sim.viewer.viewer import Viewer

FRESH = "fresh"
"""The name of tasks that are made on the fly."""

MAX_SHAPES = 50
"""Room for the shapes of a task in actions and observations: the paper's pool."""

_log = logging.getLogger(__name__)

TaskMaker = Callable[[np.random.Generator], Task]


@dataclass(frozen=True)
class EnvState:
    """Where an environment stands: a value, which can be pickled.

    task: its number, or the task itself where it was made on the fly. random: the state of the
    environment's generator.
    """

    task: int | Task
    episode: State
    random: dict[str, Any]


class PackItEnv(gym.Env[Observation, np.int64]):
    """Packs the shapes of a task into its box, one choice a step.

    tasks: the name or path of a dataset (see `packs.dataset_file`); tasks; a function that makes
    one with a random generator; or "fresh": made on the fly (see `sampler.TaskSampler`). library:
    name, path or open library, of the shapes of a dataset or of fresh tasks. split: of the dataset,
    or of the library for fresh tasks. order: "random" draws a task at each reset, "cycle" takes
    them in turn, whatever the seed. cells: the box's, an axis; by default those of the tasks. easy:
    PackIt-Easy's order of sub-tasks. kinematic: whether an item can stand only where it comes
    straight down from the open top (see `lifting`). physics: whether all that is placed settles
    after each item (see `physics.box`), by the usual settings or these. shape, rotation, location:
    a policy or its name, where that sub-task is not the agent's; then it is no step, and the action
    space holds what the others need. observation: "voxels", "features", "prospects" or "none" (see
    `observations`).
    max_shapes: the most items that a task may have.
    render_mode: "rgb_array", for `render()`, or "human", for a page that shows the box as it fills.
    look: of what `render()` gives (see `looks`).

    The reward is the placed volume over the volume of the task's items; with physics it is the
    change of what is inside and stable, which may be less than 0, and "density" and "placed_volume"
    are of that. info tells "task" (its
    number, -1 for one made on the fly), "action_mask", "density" of the box, "placed_volume",
    "fcl_calls" since the last reset, and, when the episode is over, "end": why. Raises ValueError
    where a setting is out of range or the tasks don't go together.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 2}  # noqa: RUF012
    action_space: spaces.Discrete

    def __init__(
        self,
        tasks: str | Path | Sequence[Task] | TaskMaker = STARTER_PACKS,
        library: str | Path | ShapeLibrary = "everyday",
        *,
        split: str | None = None,
        order: Literal["random", "cycle"] = "random",
        cells: Sequence[int] | None = None,
        easy: bool = False,
        kinematic: bool = False,
        physics: bool | PhysicsSettings = False,
        shape: Policy | str | None = None,
        rotation: Policy | str | None = None,
        location: Policy | str | None = None,
        observation: str = "voxels",
        max_shapes: int = MAX_SHAPES,
        render_mode: str | None = None,
        look: Look | None = None,
    ) -> None:
        _one_of("render mode", render_mode, (None, *self.metadata["render_modes"]))
        _one_of("order", order, ("random", "cycle"))
        _one_of("observation", observation, tuple(OBSERVERS))
        if kinematic and physics:
            raise ArgumentError("a box is either kinematic or has physics, not both")
        self._cells = None if cells is None else box_cells(cells)
        self.tasks, self.maker = _source(tasks, library, split, self._cells)
        self.cells = self._cells or _common_cells(self.tasks)
        self.easy = easy
        self.kinematic = kinematic
        self.physics = PhysicsSettings() if physics is True else physics or None
        self.render_mode = render_mode
        self.look = look
        self._max_shapes = max_shapes
        self._fixed = {
            stage: load_policy(stage, policy) if isinstance(policy, str) else policy
            for stage, policy in zip(Stage, (shape, rotation, location), strict=True)
        }
        sizes = (max_shapes, rotations.COUNT, math.prod(grid_nodes(self.cells)))
        free = [stage for stage in Stage if not self._fixed[stage]]
        if not free:
            raise ArgumentError("shape, rotation and location all have policies: no step is left")
        for task in self.tasks:
            self._check(task)
        self._order = order
        in_turn = EASY_ORDER if easy else ORDER
        last = max(in_turn.index(stage) for stage in free)
        actions = max(sizes[stage] for stage in free)
        self._observer = OBSERVERS[observation](
            self.cells, max_shapes, actions, in_turn[1 : last + 1]
        )
        self.action_space = spaces.Discrete(actions)
        self.observation_space = self._observer.space
        self._episode: Episode | None = None
        self._number = -1
        self._over = False
        self._fcl_calls = 0
        self._scene: Scene | None = None
        self._viewer: Viewer | None = None

    @property
    def episode(self) -> Episode:
        """The episode being played. Raises RuntimeError before the first reset."""
        if self._episode is None:
            raise StateError("there is no episode yet: call reset() first")
        return self._episode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts the next task, or number `options["task"]`, or that task itself.

        With a fixed shape policy the episode may be over before the first choice: then no action is
        valid, and the first step says so.
        """
        super().reset(seed=seed)
        wanted = (options or {}).get("task")
        if isinstance(wanted, Task):
            task, self._number = wanted, -1
        elif self.maker is not None and wanted is None:
            task, self._number = self.maker(self.np_random), -1
        else:
            self._number = self._next() if wanted is None else wanted
            if self._number not in range(len(self.tasks)):
                choices = f"choose 0 to {len(self.tasks) - 1}" if self.tasks else "all are made"
                raise ArgumentError(f"there is no task {self._number!r}: {choices}")
            self._number = int(self._number)
            task = self.tasks[self._number]
        self._check(task)
        self._episode = self._begun(task)
        self._over = False
        self._fcl_calls = counters().fcl_calls
        self._play_fixed()
        self._show()
        return self._observe(), self._info()

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Plays one choice, and what is fixed after it.

        An episode is terminated as DESIGN says, and never truncated. Raises RuntimeError where that
        was told already.
        """
        if self.episode.end is not None and self._over:
            raise StateError(f"the episode is over: {self.episode.end}: call reset()")
        reward = 0.0
        if self.episode.end is None:
            reward = self.episode.step(int(action)) + self._play_fixed()
        self._over = self.episode.end is not None
        self._show()
        return self._observe(), reward, self._over, False, self._info()

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Bool (actions,): the valid actions, none when the episode is over."""
        mask = np.zeros(int(self.action_space.n), dtype=bool)
        if self.episode.end is None:
            valid = self.episode.action_mask()
            mask[: len(valid)] = valid
        return mask

    def get_state(self) -> EnvState:
        """Where the environment stands, for `set_state`: cheap, exact, and it can be pickled."""
        task = self._number if self._number >= 0 else self.episode.task
        return EnvState(task, self.episode.state(), dict(self.np_random.bit_generator.state))

    def set_state(self, state: EnvState) -> tuple[Observation, dict[str, Any]]:
        """Goes back, or on, to a state of an environment with the same settings."""
        task = self.tasks[state.task] if isinstance(state.task, int) else state.task
        if self._episode is None or self._episode.task is not task:
            self._episode = self._begun(task)
        self._episode.restore(state.episode)
        self._number = state.task if isinstance(state.task, int) else -1
        self._over = False
        self.np_random.bit_generator.state = state.random
        return self._observe(), self._info()

    def render(self) -> npt.NDArray[np.uint8] | None:
        """The box as a picture (512, 512, 3), where the render mode is "rgb_array"."""
        if self.render_mode != "rgb_array":
            return None
        box, layout = _shown(self.episode.box)
        if self._scene is None:
            from packit_sim.scene import Scene

            self._scene = Scene(box)
        self._scene.update(box)
        return self._scene.snapshot(look=self.look, layout=layout).image

    def close(self) -> None:
        if self._scene is not None:
            self._scene.close()
            self._scene = None
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def _begun(self, task: Task) -> Episode:
        cells = self._cells or task.cells
        box = None
        if self.physics:
            from packit_sim.physics.settling_box import SettlingBox

            box = SettlingBox(cells, self.physics)
        return Episode(task, easy=self.easy, kinematic=self.kinematic, cells=cells, box=box)

    def _show(self) -> None:
        """Brings the page up to date, where the render mode is "human"."""
        if self.render_mode != "human":
            return
        if self._viewer is None:
            from packit_sim.viewer.viewer import Viewer

            self._viewer = Viewer(self.episode.box)
            _log.warning("the box is shown at %s", self._viewer.address)
        self._viewer.update(self.episode.box)

    def _next(self) -> int:
        if self._order == "cycle":
            return (self._number + 1) % len(self.tasks)
        return int(self.np_random.integers(len(self.tasks)))

    def _play_fixed(self) -> float:
        """Plays the sub-tasks that have a policy, up to the next that has none."""
        reward = 0.0
        while self.episode.end is None:
            policy = self._fixed[self.episode.stage]
            if policy is None:
                break
            reward += self.episode.step(policy(self.episode, self.np_random))
        return reward

    def _observe(self) -> Observation:
        return self._observer.observe(self.episode, self.action_masks())

    def _info(self) -> dict[str, Any]:
        episode = self.episode
        density = episode.box.density
        info: dict[str, Any] = {
            "task": self._number,
            "action_mask": self.action_masks(),
            "density": density,
            "placed_volume": density * float(episode.box.size.prod()),
            "fcl_calls": counters().fcl_calls - self._fcl_calls,
        }
        if episode.end is not None:
            info["end"] = str(episode.end)
        return info

    def _check(self, task: Task) -> None:
        """Raises ValueError where a task does not go with this environment."""
        if self._cells is None and task.cells != self.cells:
            raise ArgumentError(
                f"a task's box has {task.cells} cells, not {self.cells}: give `cells` to say which"
            )
        if len(task.items) > self._max_shapes:
            raise ArgumentError(
                f"a task has {len(task.items)} items: max_shapes is only {self._max_shapes}"
            )
        for item in task.items:
            if max(item.cells) > max(self.cells):
                raise ArgumentError(
                    f"{item.shape.id!r} (scale {item.scale:g}) of a task needs {item.cells} cells: "
                    f"it goes into no box of {self.cells}"
                )


def _shown(box: BaseBox) -> tuple[Contents, Layout | None]:
    """A box for a picture, and where its items are shown, if not in their places."""
    if isinstance(box, Box):
        return box, None
    from packit_sim.render.layouts import Layout, unplaced

    items = [posed.item for posed in box.placed]
    return unplaced(items, box.cells), Layout.packed(box.placed, box.size)


def _source(
    tasks: str | Path | Sequence[Task] | TaskMaker,
    library: str | Path | ShapeLibrary,
    split: str | None,
    cells: Triple | None,
) -> tuple[tuple[Task, ...], TaskMaker | None]:
    """The tasks, or what makes them."""
    if isinstance(tasks, str | Path):
        opened = library if isinstance(library, ShapeLibrary) else ShapeLibrary.open(library)
        if tasks != FRESH:
            return load_tasks(tasks, opened, split), None
        shapes = opened.split(split) if split else opened
        return (), TaskSampler(shapes, EvolutionSettings(cells=cells or BOX_CELLS))
    if split is not None:
        raise ArgumentError(f"split {split!r} is of a dataset or a library: tasks have none")
    if callable(tasks):
        return (), tasks
    if not tasks:
        raise ArgumentError("an environment needs a task, or a function that makes them")
    return tuple(tasks), None


def _common_cells(tasks: Sequence[Task]) -> Triple:
    """The box of all tasks, the usual one if they are yet to be made.

    Raises ValueError where they differ.
    """
    boxes = {task.cells for task in tasks} or {BOX_CELLS}
    if len(boxes) != 1:
        raise ArgumentError(
            f"the tasks of an environment must share one box, not {sorted(boxes)}: "
            "give `cells` to say which"
        )
    return boxes.pop()


def _one_of(setting: str, value: object, valid: tuple[object, ...]) -> None:
    if value not in valid:
        choices = ", ".join(map(repr, valid))
        raise ArgumentError(f"{setting} {value!r} is not known: choose from {choices}")
