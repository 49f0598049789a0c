"""The Gymnasium environments `PackIt-v0`, Easy, Physics and Robot: one class.

At every stage, an action is a number of the same Discrete space: the index of a shape, a rotation,
or the C-order index of a location. `action_mask` in the observation marks the valid ones.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from packit_sim.box import BaseBox
from packit_sim.core.checks import check_keywords, one_of
from packit_sim.core.counters import ComparisonCounter, counted_by
from packit_sim.core.errors import ArgumentError, StateError
from packit_sim.core.plain_text import plain_logger
from packit_sim.game.datasets.builtin import STARTER_PACKS
from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.observations import OBSERVERS, Observation, value_shares, with_values
from packit_sim.game.envs.pictures import Pictured
from packit_sim.game.envs.specs import WritableSpec
from packit_sim.game.envs.task_source import GENERATED, Order, TaskMaker, TaskSource
from packit_sim.game.episodes.episode import (
    Episode,
    EpisodeState,
    Stage,
    check_task,
    ordered,
    stages,
)
from packit_sim.game.episodes.policies import Policy
from packit_sim.game.episodes.policy_registry import load_policy
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import Triple, grid_nodes
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import PACKIT, RULES, Rules

if TYPE_CHECKING:  # loaded when needed: playing alone needs none of them
    from packit_sim.scene import Look

MAX_SHAPES = 50
"""Maximum number of shapes of a task by default: the paper's pool."""

_log = plain_logger(__name__)


@dataclass(frozen=True)
class EnvState:
    """The whole state of an environment: a value, which can be pickled.

    Attributes
    ----------
    task : int or Task
        The number of the task, or the task itself if it was made on the fly.
    random : dict
        The state of the environment's random generator.
    episodes : int
        The number of episodes that were started, with this one.
    terminated : bool
        Whether a step has returned that the episode is over.
    policies : tuple of str
        The players of shapes, rotations and locations: the type of a policy and the digest of its
        weights, if it has any, or "the agent".
    """

    task: int | Task
    episode: EpisodeState
    random: dict[str, Any]
    episodes: int
    terminated: bool
    policies: tuple[str, ...]


class PackItEnv(Pictured, WritableSpec, gym.Env[Observation, np.int64]):
    """Pack the shapes of a task into its box, one choice a step.

    Parameters
    ----------
    tasks : str, Path, sequence of Task, or callable
        The name or path of a dataset (see `dataset_file`); tasks; a function that makes one with a
        random generator, and with the number of this environment's episode, from 0, if it has a
        parameter `episode`; or "fresh": made on the fly (see `TaskSampler`).
    library : str, Path, mapping or ShapeLibrary, optional
        Name, path, record (see `ShapeLibrary.to_json`) or open library of the shapes. By default
        the one that a dataset records, or "everyday" for fresh tasks.
    split : str, optional
        Split of the dataset, or of the library for fresh tasks.
    order : str, sequence of float, or callable
        "random" draws a task at each reset, "cycle" takes them in turn, independent of the seed. A
        weight for each task draws in proportion. A function, which is called like one that makes
        tasks, returns the number of the next task: a curriculum.
    rules : Rules or mapping
        The rules to play by, or the same in JSON's types; by default those of the paper.
    shape : Policy or str, optional
        A policy for shapes or its name, if shapes are not the agent's choice: then they are not a
        step, and the action space has only the actions of the other sub-tasks.
    rotation : Policy or str, optional
        The same for rotations.
    location : Policy or str, optional
        The same for locations.
    observation : str
        "features", "heightmap", "placement-features", "voxels" or "none" (see `observations`).
        Voxels take 50 MB for each observation that is stored, heightmaps 4 MB, features 0.1 MB.
    max_shapes : int
        The most items that a task may have.
    render_mode : str, optional
        "rgb_array" for `render()`, or "human" for a page that shows the box as it fills.
    look : Look, optional
        The look of the pictures of `render()` (see `looks`).
    **changes : Any
        Fields of `rules` by their names, such as `easy=True`; `physics=True` stands for the
        default world.

    Attributes
    ----------
    rules : Rules
        The rules that are played.
    cells : tuple of int
        Cells of the box along x, y and z, with several boxes those of all of them.
    plays : tuple of Stage
        The sub-tasks in which the agent chooses.
    observer : Observer
        The object that observes episodes.

    Raises
    ------
    ArgumentError
        If a setting is out of range or the tasks do not go together.
    TypeError
        If there is no setting of such a name.

    Notes
    -----
    The reward is the placed volume over the volume of the task's items; with physics it is the
    change of the volume that is inside and stable, which may be negative, and "density" and
    "placed_volume" are about that volume. `Rules(values=True)` counts values instead of volumes,
    and adds "values" to the observation. `info` has "task" (its number, -1 for one made on the
    fly), "action_mask" (int8, as `action_space.sample` takes it), "density" of the box,
    "placed_volume", "mesh_comparisons" that this environment made since its last reset, and "end":
    why the episode is over, "" before that. With a robot also "outcome": what became of the last
    item that was tried, "placed", "no grasp", "no path" or "lost"; "" before the first.

    Examples
    --------
    >>> import gymnasium
    >>> import packit_sim
    >>> env = gymnasium.make("PackIt-v0", rotation="aligned", location="blbf")
    >>> observation, info = env.reset(seed=0)
    >>> total, over = 0.0, False
    >>> while not over:  # always the first shape that is left
    ...     action = int(info["action_mask"].argmax())
    ...     observation, reward, over, truncated, info = env.step(action)
    ...     total += reward
    >>> round(total, 3), info["end"]
    (0.534, 'no room')
    """

    action_space: spaces.Discrete

    def __init__(
        self,
        tasks: str | Path | Sequence[Task] | TaskMaker = STARTER_PACKS,
        library: str | Path | Mapping[str, Any] | ShapeLibrary | None = None,
        *,
        split: str | None = None,
        order: Order = "random",
        rules: Rules | Mapping[str, Any] = PACKIT,
        shape: Policy | str | None = None,
        rotation: Policy | str | None = None,
        location: Policy | str | None = None,
        observation: str = "features",
        max_shapes: int = MAX_SHAPES,
        render_mode: str | None = None,
        look: Look | None = None,
        **changes: Any,
    ) -> None:
        check_keywords("PackItEnv.__init__", changes, _SETTINGS)
        Pictured.__init__(self, render_mode, look)
        one_of("observation", observation, tuple(OBSERVERS))
        rules = Rules.from_json(rules) if isinstance(rules, Mapping) else rules
        self.rules = rules.changed(**changes)
        self._source = TaskSource(tasks, library, split, order, self.rules.cells)
        self._own_cells = self.rules.cells or self._source.cells
        self.cells = self.rules.grid(self._own_cells)
        self._max_shapes = max_shapes
        self._fixed = {
            stage: load_policy(stage, policy) if isinstance(policy, str) else policy
            for stage, policy in zip(Stage, (shape, rotation, location), strict=True)
        }
        self._policies = tuple(map(_description, self._fixed.values()))
        sizes = (max_shapes, rotations.COUNT, math.prod(grid_nodes(self.cells)))
        self.plays = tuple(stage for stage in Stage if not self._fixed[stage])
        if not self.plays:
            raise ArgumentError("shape, rotation and location all have policies: no step is left")
        for task in self.tasks:
            self._check(task)
        in_turn = stages(self.rules)
        last = max(in_turn.index(stage) for stage in self.plays)
        actions = max(sizes[stage] for stage in self.plays)
        self.observer = OBSERVERS[observation](
            self.cells, max_shapes, actions, in_turn[1 : last + 1]
        )
        self.action_space = spaces.Discrete(actions)
        self.observation_space = self.observer.space
        if self.rules.values:
            self.observation_space = with_values(self.observer.space, max_shapes)
        self._episode: Episode | None = None
        self._number = GENERATED
        self._episodes = 0
        self._terminated = False
        self._comparisons = ComparisonCounter()

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks; empty if they are generated on the fly."""
        return self._source.tasks

    @property
    def maker(self) -> TaskMaker | None:
        """The function that generates tasks, if they are generated on the fly."""
        return self._source.maker

    @property
    def episode(self) -> Episode:
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
        """Start the next task.

        Parameters
        ----------
        seed : int, optional
            Seed of the environment's random generator.
        options : dict, optional
            "task" may be the number of a task, or a task itself.

        Returns
        -------
        observation : dict
            See `observations`.
        info : dict
            See the class.

        Raises
        ------
        ArgumentError
            If there is no such task or option, or the task does not go with this environment.

        Notes
        -----
        With a fixed shape policy the episode may be over before the first choice: then no action is
        valid, and the first step returns that it is terminated.
        """
        wanted = wanted_task(options)
        named = None if wanted is None else self._named_task(wanted)
        super().reset(seed=seed)
        task, number = named or self._source.draw(self._number, self._episodes, self.np_random)
        self._check(task)
        self._number = number
        self._episodes += 1
        self._episode = Episode(task, self.rules)
        self._terminated = False
        self._comparisons = ComparisonCounter()
        with counted_by(self._comparisons):
            self._play_fixed()
            self._show()
            return self._observe()

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Play one choice, and those of fixed policies after it.

        Parameters
        ----------
        action : int
            An action of this stage; one that is not valid ends the episode.

        Returns
        -------
        observation : dict
            See `observations`.
        reward : float
            The volume, or the value, that was placed, as a share of the task's.
        terminated : bool
            Whether the episode is over.
        truncated : bool
            Always False.
        info : dict
            See the class.

        Raises
        ------
        StateError
            If called after termination.
        ArgumentError
            If the action is not an integer. The environment is unchanged.
        """
        if self._terminated:
            raise StateError(f"the episode is over: {self.episode.end}: call reset()")
        reward = 0.0
        with counted_by(self._comparisons):
            if self.episode.end is None:
                reward = self.episode.step(action) + self._play_fixed()
            self._terminated = self.episode.end is not None
            self._show()
            observation, info = self._observe()
        return observation, reward, self._terminated, False, info

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return the valid actions, bool (actions,); none when the episode is over."""
        mask = np.zeros(int(self.action_space.n), dtype=bool)
        if self.episode.end is None:
            valid = self.episode.action_mask()
            mask[: len(valid)] = valid
        return mask

    def get_state(self) -> EnvState:
        """Save the state of the environment, for `set_state`: cheap, exact, and picklable."""
        task = self._number if self._number != GENERATED else self.episode.task
        random = dict(self.np_random.bit_generator.state)
        facts = self._episodes, self._terminated, self._policies
        return EnvState(task, self.episode.state(), random, *facts)

    def set_state(self, state: EnvState) -> tuple[Observation, dict[str, Any]]:
        """Return to a state of an environment with the same settings.

        Parameters
        ----------
        state : EnvState
            The value that `get_state` returned.

        Returns
        -------
        observation : dict
            The observation in that state.
        info : dict
            The same for `info`.

        Raises
        ------
        ArgumentError
            If it is a state of another task, of other rules or of other policies. The environment
            is unchanged.
        """
        if not isinstance(state, EnvState):
            raise ArgumentError(f"{state!r:.80} is not a state: give what get_state() returned")
        for stage, theirs, ours in zip(Stage, state.policies, self._policies, strict=True):
            if theirs != ours:
                raise ArgumentError(
                    f"a state in which {theirs} plays {stage.name.lower()}s can't be restored "
                    f"where {ours} does"
                )
        task, number = self._named_task(state.task)
        episode = self._episode
        if episode is None or episode.task is not ordered(task, self.rules):
            episode = Episode(task, self.rules)
        episode.restore(state.episode)
        self._episode, self._number = episode, number
        self._episodes, self._terminated = state.episodes, state.terminated
        self.np_random.bit_generator.state = state.random
        with counted_by(self._comparisons):
            return self._observe()

    def _play_fixed(self) -> float:
        """Play the sub-tasks that have a policy, up to the next that has none."""
        reward = 0.0
        while self.episode.end is None:
            policy = self._fixed[self.episode.stage]
            if policy is None:
                break
            reward += self.episode.step(policy(self.episode, self.np_random))
        return reward

    def _observe(self) -> tuple[Observation, dict[str, Any]]:
        """Return the observation and `info` of the episode's state."""
        episode = self.episode
        action_mask = self.action_masks()
        observation = self.observer.observe(episode, action_mask)
        if self.rules.values:
            observation["values"] = value_shares(episode, self._max_shapes)
        density = episode.box.density
        info = {
            "task": self._number,
            "action_mask": action_mask.astype(np.int8),
            "density": density,
            "placed_volume": density * episode.box.volume,
            "mesh_comparisons": self._comparisons.mesh_comparisons,
            "end": str(episode.end or ""),
        }
        if self.rules.robot is not None:
            tried = episode.box.placed
            info["outcome"] = str(tried[-1].outcome) if tried else ""
        return observation, info

    def _named_task(self, wanted: Task | int) -> tuple[Task, int]:
        """Return a task and its number, or raise ArgumentError if it is invalid here."""
        task, number = self._source.named(wanted)
        self._check(task)
        return task, number

    def _check(self, task: Task) -> None:
        """Raise ArgumentError if a task does not fit this environment."""
        if self.rules.cells is None and task.cells != self._own_cells:
            raise ArgumentError(
                f"a task's box has {task.cells} cells, not {self._own_cells}: give `cells` to say "
                "which"
            )
        check_size(task, self._own_cells, self._max_shapes)
        check_task(task, self.rules)


def check_size(task: Task, cells: Triple, max_shapes: int) -> None:
    """Raise ArgumentError if a task has too many items, or one that no box of the cells holds."""
    if len(task.items) > max_shapes:
        raise ArgumentError(f"a task has {len(task.items)} items: max_shapes is only {max_shapes}")
    for item in task.items:
        if max(item.cells) > max(cells):
            raise ArgumentError(
                f"{item.shape.id!r} (scale {item.scale:g}) of a task needs {item.cells} cells: "
                f"it fits into no box of {cells}"
            )


_SETTINGS = (*[n for n in inspect.signature(PackItEnv).parameters if n != "changes"], *RULES)


def wanted_task(options: object) -> Any:
    """Return the option "task" of `reset`, None if it is not given."""
    if options is None:
        return None
    if not isinstance(options, Mapping):
        raise ArgumentError(f"options {options!r:.80} are not possible: give a dict, or None")
    for name in options:
        if name != "task":
            raise ArgumentError(f"there is no option {name!r:.80}: choose from task")
    return options.get("task")


def _description(policy: Policy | None) -> str:
    """Describe the player of a sub-task for states, equally in each process."""
    if policy is None:
        return "the agent"
    kind = policy if hasattr(policy, "__qualname__") else type(policy)
    weights = getattr(policy, "weights_digest", None)
    return kind.__qualname__ + (f" with the weights {weights}" if weights else "")
