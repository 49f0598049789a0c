"""Recordings of episodes in Minari's format, for imitation learning.

Minari is installed by `pip install packit-sim[learn]`, and imported when it is first used.
"""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from packit_sim.core.errors import StateError
from packit_sim.core.files import claimed, lock_path
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.minari_format import Minari, RecordingError, readable
from packit_sim.game.envs.observations import Observation
from packit_sim.game.episodes.agents import GROUND_TRUTH, Agent
from packit_sim.game.episodes.episode import Stage

__all__ = [
    "Recorder",
    "RecordingError",
    "record",
    "stage_steps",
]

CUT_SHORT = "cut short"
"""The end of an episode that was stopped before it was over."""

BLOCK_BYTES = 64_000_000
"""Approximate size in bytes of the blocks of observations; it limits the memory for voxels."""


@dataclass
class _Played:
    """The played part of an episode; `options` is {"task": its number} if reset got that."""

    seed: int
    options: dict[str, int] | None
    task: int
    observations: list[Any]
    densities: list[float]
    actions: list[np.int64] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    terminations: list[bool] = field(default_factory=list)
    truncations: list[bool] = field(default_factory=list)
    end: str = CUT_SHORT


class Recorder(gym.Wrapper[Any, Any, Any, Any]):
    """A wrapper of a PackIt environment that records its episodes; `close()` writes them.

    Parameters
    ----------
    env : gym.Env
        The environment. A warning is given if its settings can't be written as JSON: then only
        Minari's `recover_environment` does not work.
    path : str | Path
        The folder of the recording, which must not exist.
    dataset_id : str
        "namespace/name-v0". `minari.load_dataset` finds the recording by it if the path is
        "<Minari's folder>/<dataset_id>/data".
    description : str
        A text for readers.
    algorithm : str
        The name of the agent, for readers.

    Raises
    ------
    RecordingError
        If the path exists.
    BusyError
        If another recorder writes to the path.
    MissingPackageError
        If the extra `learn` is not installed.

    Notes
    -----
    Each episode is stored exactly, with seed, observations, actions, rewards and info["density"].
    Its metadata contains "task" (the number), "end" and "return". An episode that is stopped by a
    reset or `close()` is truncated, and its end is "cut short". A reset without a seed draws one
    from the environment's generator, so that each episode can be replayed separately.

    The folder is written completely or not at all: not if nothing was played, or a `with` block
    ends with an exception. Until `close()` the data is in a hidden folder next to it, which is
    removed if the recorder is never closed.

    Boolean observations are MultiBinary in the recording's observation space: as Box it would list
    two bounds for each cell. Reading a step of voxels takes tens of megabytes of memory: record
    with observation="none", and give `stage_steps` an environment that observes voxels.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        path: str | Path,
        *,
        dataset_id: str = "packit/recording-v0",
        description: str = "",
        algorithm: str = "",
    ) -> None:
        super().__init__(env)
        self._minari = Minari()
        self.path = Path(path).absolute()
        if self.path.exists():
            raise RecordingError(f"{self.path} exists: choose another path for the recording")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._claim = ExitStack()
        self._claim.enter_context(claimed(lock_path(self.path), self.path))
        self._played: _Played | None = None
        self.count = 0
        self._staging: tempfile.TemporaryDirectory[str] | None = tempfile.TemporaryDirectory(
            prefix=f".{self.path.name}.", dir=self.path.parent
        )
        self._folder = Path(self._staging.name) / "new"
        self._storage = self._minari.storage.new(
            self._folder,
            observation_space=_stored(env.observation_space),
            action_space=env.action_space,
            env_spec=_spec(env),
            jpeg_encoding=False,
        )
        self._storage.update_metadata(
            {
                "dataset_id": dataset_id,
                "minari_version": self._minari.version,
                "description": description,
                "algorithm_name": algorithm,
                "requirements": [f"packit-sim=={version('packit-sim')}"],
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Parameters
        ----------
        seed : int | None
            The seed; by default one is drawn from the environment's generator.
        options : dict[str, Any] | None
            The options of `PackItEnv.reset`, with "task" as a number.

        Returns
        -------
        tuple[Any, dict[str, Any]]
            The observation and the info.

        Raises
        ------
        RecordingError
            If "task" is an object: it can't be recorded.
        """
        task = (options or {}).get("task")
        if isinstance(task, Task):
            raise RecordingError(
                "a task object can't be recorded: pass it to the environment as one of its tasks, "
                "and its number to reset()"
            )
        self._finish()
        if seed is None:
            seed = int(self.unwrapped.np_random.integers(2**31))
        observation, info = self.env.reset(seed=seed, options=options)
        self._played = _Played(
            seed,
            None if task is None else {"task": int(task)},
            info["task"],
            [observation],
            [info["density"]],
        )
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if self._played is None:
            raise StateError("no episode is being played: call reset()")
        observation, reward, terminated, truncated, info = self.env.step(action)
        played = self._played
        played.observations.append(observation)
        played.densities.append(info["density"])
        played.actions.append(np.int64(action))
        played.rewards.append(float(reward))
        played.terminations.append(terminated)
        played.truncations.append(truncated)
        if terminated or truncated:
            played.end = info["end"] or CUT_SHORT
            self._finish()
        return observation, float(reward), terminated, truncated, info

    def close(self) -> None:
        """Write the recording and close the environment."""
        staging, self._staging = self._staging, None
        try:
            if staging is not None:
                with self._claim, staging:
                    self._finish()
                    if self.count:
                        self._folder.rename(self.path)
        finally:
            super().close()

    def __exit__(self, *raised: Any) -> bool:
        if raised[0] is not None and self._staging is not None:
            with self._claim:
                self._staging.cleanup()
            self._staging = None
        return super().__exit__(*raised)

    def _finish(self) -> None:
        """Add the current episode to the recording if it has a step."""
        played, self._played = self._played, None
        if played is None or not played.actions:
            return
        if not played.terminations[-1]:
            played.truncations[-1] = True
        steps = len(played.actions)
        self._minari.allocate(self._folder, self.count, played.observations[0], steps + 1)
        block = max(1, BLOCK_BYTES // max(1, _bytes(played.observations[0])))
        for start in range(0, steps, block):
            observed = slice(start + (start > 0), start + block + 1)
            done = slice(start, start + block)
            buffer = self._minari.buffer(
                id=self.count,
                seed=None if start else played.seed,
                options=None if start else played.options,
                observations=_columns(played.observations[observed]),
                actions=played.actions[done],
                rewards=played.rewards[done],
                terminations=played.terminations[done],
                truncations=played.truncations[done],
                infos={"density": played.densities[observed]},
            )
            self._storage.update_episodes([buffer])
        metadata = {
            "total_steps": steps,
            "task": played.task,
            "end": played.end,
            "return": plain_sum(played.rewards),
        }
        self._storage.update_episode_metadata([metadata], [self.count])
        self.count += 1


def record(
    env: gym.Env[Any, Any],
    path: str | Path,
    agent: Agent = GROUND_TRUTH,
    *,
    episodes: int | None = None,
    seed: int = 0,
    description: str = "",
) -> Any:
    """Record an agent, and close the environment.

    Parameters
    ----------
    env : gym.Env
        The environment.
    path : str | Path
        The folder of the recording, which must not exist.
    agent : Agent
        The agent; by default it plays the solutions of the tasks.
    episodes : int | None
        The number of episodes; by default each task of the environment is played once.
    seed : int
        The seed of the environment and the agent.
    description : str
        A text for readers.

    Returns
    -------
    minari.MinariDataset
        The recording.

    Raises
    ------
    RecordingError
        If the path exists, or tasks are generated on the fly and `episodes` is None.
    MissingPackageError
        If the extra `learn` is not installed.
    """
    tasks: Sequence[Task] = env.get_wrapper_attr("tasks")
    if episodes is None and not tasks:
        raise RecordingError("pass `episodes`: the tasks are generated on the fly, without end")
    recorder = Recorder(env, path, description=description, algorithm=agent.name)
    with recorder:
        for number in range(len(tasks) if episodes is None else episodes):
            rng = np.random.default_rng((seed, number))
            recorder.reset(
                seed=None if number else seed,
                options={"task": number} if episodes is None else None,
            )
            over = False
            while not over:
                action = agent.act(env.get_wrapper_attr("episode"), rng)
                _, _, terminated, truncated, _ = recorder.step(action)
                over = terminated or truncated
    return Minari().opened(recorder.path)


def stage_steps(
    recording: Any, stage: Stage, env: gym.Env[Any, Any] | None = None
) -> Iterator[tuple[Observation, int]]:
    """Read the steps of one sub-task from a recording.

    Parameters
    ----------
    recording : str | Path | minari.MinariDataset
        The folder, or the dataset, which may be a selection of episodes.
    stage : Stage
        The sub-task.
    env : gym.Env | None
        An environment in which the episodes are replayed to get its observations instead of the
        recorded ones. It must have the same tasks and rules.

    Yields
    ------
    tuple[Observation, int]
        An observation, and the action that was taken. Invalid actions are left out.

    Raises
    ------
    RecordingError
        If the observations do not contain "stage" and "action_mask", or the replay gives another
        reward.
    """
    is_path = isinstance(recording, str | Path)
    dataset = Minari().opened(Path(recording)) if is_path else recording
    space = dataset.observation_space if env is None else env.observation_space
    if not (isinstance(space, spaces.Dict) and {"stage", "action_mask"} <= space.keys()):
        raise RecordingError("the observations do not contain both 'stage' and 'action_mask'")
    for episode in _episodes(dataset):
        steps = _rows(episode) if env is None else _replayed(dataset, episode, env)
        for observation, action in zip(steps, episode.actions.tolist(), strict=True):
            mask = observation["action_mask"]
            if observation["stage"] == stage and 0 <= action < len(mask) and mask[action]:
                yield observation, action


def _episodes(dataset: Any) -> Iterator[Any]:
    """Yield the episodes, each with as many integer actions and rewards as steps."""
    with readable("the recording"):
        for episode in dataset.iterate_episodes():
            count = len(episode)
            if episode.actions.shape != (count,) or episode.actions.dtype.kind not in "iu":
                raise RecordingError(
                    f"episode {episode.id} does not have one integer action per step"
                )
            if episode.rewards.shape != (count,):
                raise RecordingError(f"episode {episode.id} does not have one reward per step")
            yield episode


def _rows(episode: Any) -> Iterator[Observation]:
    with readable(f"episode {episode.id}"):
        stages, masks = episode.observations["stage"], episode.observations["action_mask"]
        if stages.shape != masks.shape[:1] or masks.ndim != 2:
            raise RecordingError(
                f"episode {episode.id} does not have one stage and one mask per step"
            )
        for step in range(len(episode)):
            yield {key: column[step] for key, column in episode.observations.items()}


def _replayed(dataset: Any, episode: Any, env: gym.Env[Any, Any]) -> Iterator[Observation]:
    """Yield the observation at each step of an episode, replayed in an environment."""
    with readable(f"episode {episode.id}"):
        (metadata,) = dataset.storage.get_episode_metadata([episode.id])
        seed, task = metadata["seed"], int(metadata["task"])
    observation, info = env.reset(seed=seed, options=metadata.get("options"))
    if info["task"] != task:  # tasks that are played in turn do not depend on the seed
        observation, info = env.reset(seed=seed, options={"task": task})
    for step, (action, recorded) in enumerate(
        zip(episode.actions.tolist(), episode.rewards.tolist(), strict=True)
    ):
        yield observation
        observation, reward, _, _, _ = env.step(action)
        if reward != recorded:
            raise RecordingError(
                f"episode {episode.id} does not replay: step {step} gives reward {reward}, not the "
                f"recorded {recorded}: use an environment with the same tasks and settings"
            )


def _stored(space: spaces.Space[Any]) -> spaces.Space[Any]:
    """Return the observation space of the recording."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({key: _stored(part) for key, part in space.items()})
    if isinstance(space, spaces.Box) and space.dtype == np.bool_:
        return spaces.MultiBinary(space.shape)
    return space


def _spec(env: gym.Env[Any, Any]) -> EnvSpec | None:
    """Return the spec that recreates the environment; warn and return None if it is not JSON."""
    bare = env.unwrapped.spec
    if bare is None:
        problem = "was not created by gymnasium.make"
    elif objects := [name for name, value in bare.kwargs.items() if not _is_json(value)]:
        problem = f"has settings that are objects: {', '.join(objects)}"
    else:
        spec = env.spec
        assert spec is not None
        lost = [
            w.name for w in spec.additional_wrappers if w.kwargs is None or not _is_json(w.kwargs)
        ]
        if not lost:
            return spec
        problem = f"has wrappers that do not record their settings: {', '.join(lost)}"
    warnings.warn(
        f"the environment can't be recreated from the recording, because it {problem}; everything "
        "else is recorded",
        stacklevel=3,
    )
    return None


def _is_json(value: Any) -> bool:
    try:
        json.dumps(value)
    except (TypeError, ValueError):
        return False
    return True


def _columns(rows: list[Any]) -> Any:
    """Collect observations as Minari expects them: a list for each key."""
    if isinstance(rows[0], dict):
        return {key: _columns([row[key] for row in rows]) for key in rows[0]}
    return rows


def _bytes(observation: Any) -> int:
    if isinstance(observation, dict):
        return sum(map(_bytes, observation.values()))
    return np.asarray(observation).nbytes
